"""Multisine: a periodic motion of any machine's joints, scaled by their ranges and speed limits."""

import math

import numpy as np
from pydantic import Field

from leglab.base.settings import Configuration
from leglab.references.base import Joint, Motion, Samples, register_reference, rest_pose, selected
from leglab.references.blending import fade_in, scaled

# Number of samples per period from which peak position, speed and acceleration are computed.
_DENSE = 1024
# Amplitude of a joint that has neither a range nor a speed limit [rad or m].
_FREE_AMPLITUDE = 0.2


class Multisine(Configuration):
    """Settings of `multisine`.

    Attributes:
        period: After which the motion repeats [s].
        harmonics: Sines with multiples of the frequency 1/period; amplitudes fall with the number.
        amplitude: Largest deviation from the middle of the motion, as a share of half the range.
        speed: Largest speed, as a share of the joint's limit.
        phase: Share of the period at which time 0 falls.
        motion: Number of the motion: phases of the sines are drawn with it.
        fade_in: Time in which the motion grows from the rest pose [s].
        joints: Joints that move; None stands for all.
    """

    period: float = Field(default=3.0, gt=0)
    harmonics: int = Field(default=4, ge=1, le=50)
    amplitude: float = Field(default=0.4, gt=0, le=1)
    speed: float = Field(default=0.25, gt=0, le=1)
    phase: float = Field(default=0.0, ge=0, le=1)
    motion: int = Field(default=0, ge=0)
    fade_in: float = Field(default=1.0, gt=0)
    joints: tuple[str, ...] | None = None


@register_reference(
    "multisine",
    summary="sines of several frequencies within the range of any joint",
    configuration=Multisine,
)
def multisine(joints: tuple[Joint, ...], config: Multisine) -> tuple[Motion, float]:
    """Makes the motion m + A sum_k cos(2 pi k t/T + phi_k)/k, scaled so that its peak is A.

    The middle m is the position nearest to rest that keeps the motion in range. A is the least of
    three amplitudes: `amplitude` times half the range; the one with peak speed `speed` v, where v
    is the speed limit; the one with peak acceleration `speed` v^2/range, v being reached in range.
    """
    order = np.arange(1, config.harmonics + 1)
    rate = 2 * np.pi * order / config.period
    random = np.random.default_rng(config.motion)
    angle = random.uniform(0, 2 * np.pi, (len(joints), config.harmonics)).T
    start = config.phase * config.period

    def unit(times: np.ndarray) -> Samples:
        turn = times[:, None, None] * rate[:, None] + angle
        cos, sin = np.cos(turn), np.sin(turn)
        weight = (1.0 / order)[:, None]
        return Samples(
            np.sum(weight * cos, axis=1),
            -np.sum(weight * rate[:, None] * sin, axis=1),
            -np.sum(weight * rate[:, None] ** 2 * cos, axis=1),
        )

    peaks = [np.abs(part).max(axis=0) for part in unit(np.linspace(0, config.period, _DENSE))]
    moves = selected(joints, config.joints, "multisine")
    rest, middle = rest_pose(joints), rest_pose(joints)
    scale = np.zeros(len(joints))
    for i, joint in enumerate(joints):
        position, speed, acceleration = (float(peak[i]) for peak in peaks)
        width, fastest = joint.upper - joint.lower, config.speed * joint.velocity_limit
        reach = config.amplitude * width / 2 if math.isfinite(width) else math.inf
        found = min(reach / position, fastest / speed)
        if math.isfinite(width):
            found = min(found, fastest * joint.velocity_limit / width / acceleration)
        scale[i] = moves[i] * (found if math.isfinite(found) else _FREE_AMPLITUDE / position)
        # Margin: the true peak between two samples is less than a ten-thousandth higher.
        room = 1.001 * scale[i] * position
        if math.isfinite(width):
            middle[i] = min(max(joint.rest, joint.lower + room), joint.upper - room)

    def displacement(times: np.ndarray) -> Samples:
        return scaled(middle - rest, scale, unit(times + start))

    return fade_in(displacement, joints, config.fade_in), config.period
