"""Walking: the joint angles of an adult's stride, repeated."""

import numpy as np
from pydantic import Field

from leglab.base.settings import Configuration
from leglab.references.base import (
    BEND_SHARE,
    Joint,
    Motion,
    Samples,
    moving_joints,
    register_reference,
)
from leglab.references.blending import fade_in
from leglab.references.gait import GAIT


class WalkingStride(Configuration):
    """Settings of `walking_stride`.

    Attributes:
        period: Duration of a stride, two steps [s].
        amplitude: Factor on the deviation from each joint's mean angle.
        knee_bend: Extra knee flexion throughout [rad]; people straighten the knee to 0.04 rad, a
            machine keeps away from its end stop.
        phase: Share of the stride at which time 0 falls; 0 is heel contact.
        fade_in: Time in which the motion grows from the rest pose [s].
    """

    period: float = Field(default=1.2, gt=0)
    amplitude: float = Field(default=1.0, ge=0, le=2)
    knee_bend: float = Field(default=0.08, ge=0, le=1)
    phase: float = Field(default=0.0, ge=0, le=1)
    fade_in: float = Field(default=1.0, gt=0)


def gait_series(
    joints: tuple[Joint, ...], amplitude: float, knee_bend: float, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the Fourier series of a stride, for joints in any order.

    Args:
        joints: The joints; joints that are not of a leg get zeros.
        amplitude: Factor on the deviation from each joint's mean angle.
        knee_bend: Extra knee flexion throughout [rad].
        name: Name of the reference, for messages.

    Returns:
        Mean displacement from the rest pose [rad], (joints,), and the amplitudes of cosines and
        sines [rad], each (harmonics, joints).

    Raises:
        LeglabError: None of the joints is of a leg.
    """
    harmonics = max(len(series.cosine) for series in GAIT.values())
    mean = np.zeros(len(joints))
    cosine, sine = np.zeros((2, harmonics, len(joints)))
    for i in moving_joints(joints, tuple(GAIT), name):
        series = GAIT[joints[i].name]
        mean[i] = np.radians(series.mean) + knee_bend * BEND_SHARE.get(joints[i].name, 0.0)
        mean[i] -= joints[i].rest
        scale = np.radians(amplitude)
        cosine[: len(series.cosine), i] = scale * np.array(series.cosine)
        sine[: len(series.sine), i] = scale * np.array(series.sine)
    return mean, cosine, sine


@register_reference(
    "walking_stride", summary="an adult's stride, repeated", configuration=WalkingStride
)
def walking_stride(joints: tuple[Joint, ...], config: WalkingStride) -> tuple[Motion, float]:
    """Makes the motion; joints that are not of a leg stay at rest."""
    mean, cosine, sine = gait_series(joints, config.amplitude, config.knee_bend, "walking_stride")
    rate = 2 * np.pi / config.period * np.arange(1, len(cosine) + 1)
    start = config.phase * config.period

    def stride(times: np.ndarray) -> Samples:
        angle = np.outer(times + start, rate)
        cos, sin = np.cos(angle), np.sin(angle)
        return Samples(
            mean + cos @ cosine + sin @ sine,
            (cos * rate) @ sine - (sin * rate) @ cosine,
            -(cos * rate**2) @ cosine - (sin * rate**2) @ sine,
        )

    return fade_in(stride, joints, config.fade_in), config.period
