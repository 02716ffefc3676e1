"""Sine sweep: a sine whose frequency grows exponentially, about the rest pose."""

import numpy as np
from pydantic import Field, model_validator

from leglab.base.settings import Configuration
from leglab.references.base import Joint, Motion, Samples, register_reference, rest_pose, selected
from leglab.references.blending import product, scaled, smooth_step


class SineSweep(Configuration):
    """Settings of `sine_sweep`.

    Attributes:
        amplitude: Amplitude about the rest position [rad].
        start_frequency: Frequency at time 0 [Hz].
        end_frequency: Frequency at the end [Hz].
        duration: Length of the sweep [s]; then the joints stay at rest.
        fade: Time in which the amplitude grows at the start and shrinks at the end [s].
        joints: Joints that move; None stands for all.
    """

    amplitude: float = Field(default=0.1, gt=0)
    start_frequency: float = Field(default=0.2, gt=0)
    end_frequency: float = Field(default=5.0, gt=0)
    duration: float = Field(default=20.0, gt=0)
    fade: float = Field(default=1.0, gt=0)
    joints: tuple[str, ...] | None = None

    @model_validator(mode="after")
    def _check(self) -> "SineSweep":
        if self.end_frequency == self.start_frequency:
            raise ValueError(
                f"end_frequency {self.end_frequency:g} Hz must differ from start_frequency"
            )
        if 2 * self.fade > self.duration:
            raise ValueError(
                f"fade {self.fade:g} s must not exceed half of the duration {self.duration:g} s"
            )
        return self


@register_reference(
    "sine_sweep", summary="a sine of growing frequency about the rest pose", configuration=SineSweep
)
def sine_sweep(joints: tuple[Joint, ...], config: SineSweep) -> tuple[Motion, float]:
    """Makes the motion sin(phi), phi = 2 pi f_0 T/ln(k) (k^(t/T) - 1), k = f_1/f_0.

    The exponential sweep of Farina 2000, AES 108th Convention, paper 5093.
    """
    amplitude = config.amplitude * selected(joints, config.joints, "sine_sweep")
    rest = rest_pose(joints)
    growth = np.log(config.end_frequency / config.start_frequency) / config.duration
    first_rate = 2 * np.pi * config.start_frequency

    def sweep(times: np.ndarray) -> Samples:
        inside = np.clip(times, 0.0, config.duration)[:, None]
        rate = first_rate * np.exp(growth * inside)
        phase = first_rate * np.expm1(growth * inside) / growth
        cos, sin = np.cos(phase), np.sin(phase)
        wave = Samples(sin, rate * cos, growth * rate * cos - rate**2 * sin)
        rise = smooth_step(times, 0.0, config.fade)
        fall = smooth_step(times, config.duration - config.fade, config.fade)
        # Rise and fall do not overlap, so that rise - fall equals the product rise (1 - fall).
        envelope = Samples(*(a - b for a, b in zip(rise, fall, strict=True)))
        return scaled(rest, amplitude, product(envelope, wave))

    return sweep, 1 / min(config.start_frequency, config.end_frequency)
