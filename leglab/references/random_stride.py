"""Walking without two equal strides: length and duration of the steps vary at random."""

import numpy as np
from pydantic import Field

from leglab.base.settings import Configuration
from leglab.references.base import Joint, Motion, Samples, register_reference
from leglab.references.blending import fade_in, product
from leglab.references.walking_stride import gait_series

# Range [Hz] and number of the random frequencies of the variations, which are slower than strides.
_SLOWEST, _FASTEST, _COUNT = 0.03, 0.4, 6


class RandomStride(Configuration):
    """Settings of `random_stride`.

    Attributes:
        seed: Of the variations; same seed, same motion.
        period: Mean duration of a stride [s].
        amplitude: Largest factor on the deviation from each joint's mean angle.
        amplitude_variation: Largest share by which a joint's deviation shrinks.
        period_variation: Largest relative deviation of the stride rate.
        knee_bend: Extra knee flexion throughout [rad], as for `walking_stride`.
        fade_in: Time in which the motion grows from the rest pose [s].
    """

    seed: int = Field(default=0, ge=0)
    period: float = Field(default=1.2, gt=0)
    amplitude: float = Field(default=1.0, ge=0, le=2)
    amplitude_variation: float = Field(default=0.5, ge=0, le=1)
    period_variation: float = Field(default=0.2, ge=0, lt=1)
    knee_bend: float = Field(default=0.08, ge=0, le=1)
    fade_in: float = Field(default=1.0, gt=0)


@register_reference(
    "random_stride", summary="strides of which no two are equal", configuration=RandomStride
)
def random_stride(joints: tuple[Joint, ...], config: RandomStride) -> tuple[Motion, float]:
    """Makes the motion a_i(t) D_i(phi(t)) about each joint's mean angle.

    D_i is the deviation of the regular stride, phi its phase with phi' = (1 + v w_0(t))/T, and
    a_i = 1 - s (1 - w_i(t))/2 in [1 - s, 1]. Each w is a smooth sum of sines with random
    frequencies, phases and weights. The weights add up to one, so that |w| <= 1.
    """
    mean, cosine, sine = gait_series(joints, config.amplitude, config.knee_bend, "random_stride")
    random = np.random.default_rng(config.seed)
    count = len(joints) + 1  # column 0 varies the stride rate
    wander_rate = 2 * np.pi * random.uniform(_SLOWEST, _FASTEST, (_COUNT, count))
    angle_0 = random.uniform(0, 2 * np.pi, (_COUNT, count))
    weight = random.uniform(0.5, 1.0, (_COUNT, count))
    weight /= weight.sum(axis=0)
    order = np.arange(1, len(cosine) + 1)
    turn = 2 * np.pi / config.period
    first = slice(0, 1)

    def wander(times: np.ndarray, part: slice) -> Samples:
        rate = wander_rate[:, part]
        angle = rate * times[:, None, None] + angle_0[:, part]
        sin, cos = np.sin(angle), np.cos(angle)
        return Samples(
            np.sum(weight[:, part] * sin, axis=1),
            np.sum(weight[:, part] * rate * cos, axis=1),
            -np.sum(weight[:, part] * rate**2 * sin, axis=1),
        )

    def path(times: np.ndarray) -> np.ndarray:
        """Returns the integral from time 0 of w_0, which varies the stride rate."""
        rate = wander_rate[:, first]
        angle = rate * times[:, None, None] + angle_0[:, first]
        return np.sum(weight[:, first] / rate * (np.cos(angle_0[:, first]) - np.cos(angle)), axis=1)

    def stride(times: np.ndarray) -> Samples:
        rate = wander(times, first)
        phase = turn * (times[:, None] + config.period_variation * path(times))
        speed = turn * (1 + config.period_variation * rate.position)
        change = turn * config.period_variation * rate.velocity
        cos, sin = np.cos(order * phase), np.sin(order * phase)
        slope = (cos * order) @ sine - (sin * order) @ cosine
        curvature = -(cos * order**2) @ cosine - (sin * order**2) @ sine
        deviation = Samples(
            cos @ cosine + sin @ sine, slope * speed, curvature * speed**2 + slope * change
        )
        own = wander(times, slice(1, None))
        share = config.amplitude_variation / 2
        scale = Samples(
            1 - share * (1 - own.position), share * own.velocity, share * own.acceleration
        )
        motion = product(scale, deviation)
        return motion._replace(position=mean + motion.position)

    return fade_in(stride, joints, config.fade_in), config.period
