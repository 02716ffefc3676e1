"""Step: up and down again, abruptly or along a quintic."""

import numpy as np
from pydantic import Field, model_validator

from leglab.base.settings import Configuration
from leglab.references.base import Joint, Motion, Samples, register_reference, rest_pose, selected
from leglab.references.blending import smooth_step


class Step(Configuration):
    """Settings of `step`.

    Attributes:
        amplitude: Height above the rest position [rad]; negative steps go down.
        start: Time of the first step [s].
        hold: Time from one step to the next, back to rest [s].
        rise_time: Time a step takes [s]; 0 gives a true step, whose derivatives are taken as 0.
        joints: Joints that move; None stands for all.
    """

    amplitude: float = 0.2
    start: float = Field(default=1.0, ge=0)
    hold: float = Field(default=1.0, gt=0)
    rise_time: float = Field(default=0.1, ge=0)
    joints: tuple[str, ...] | None = None

    @model_validator(mode="after")
    def _check(self) -> "Step":
        if self.rise_time > self.hold:
            raise ValueError(f"rise_time {self.rise_time:g} s must not exceed hold {self.hold:g} s")
        return self


@register_reference("step", summary="from rest to a step and back", configuration=Step)
def step(joints: tuple[Joint, ...], config: Step) -> tuple[Motion, float]:
    """Makes the motion: steps up and down in turn, each held for `hold`."""
    amplitude = config.amplitude * selected(joints, config.joints, "step")
    rest = rest_pose(joints)

    def steps(times: np.ndarray) -> Samples:
        count = np.floor((times - config.start) / config.hold)
        rise = smooth_step(times - config.start - count * config.hold, 0.0, config.rise_time)
        down = (count % 2 == 1)[:, None]
        sign = np.where(down, -1.0, 1.0) * (count >= 0)[:, None]
        return Samples(
            rest + amplitude * (sign * rise.position + (down & (count >= 0)[:, None])),
            amplitude * sign * rise.velocity,
            amplitude * sign * rise.acceleration,
        )

    return steps, 2 * config.hold
