"""Squat: hip, knee and ankle flex together, the foot stays flat."""

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


class Squat(Configuration):
    """Settings of `squat`.

    Attributes:
        depth: Knee flexion at the lowest point, from the rest pose [rad].
        period: Time for down and up [s].
        fade_in: Time in which the motion grows from the rest pose [s].
    """

    depth: float = Field(default=0.8, gt=0)
    period: float = Field(default=3.0, gt=0)
    fade_in: float = Field(default=1.0, gt=0)


@register_reference("squat", summary="down and up, the foot flat", configuration=Squat)
def squat(joints: tuple[Joint, ...], config: Squat) -> tuple[Motion, float]:
    """Makes the motion depth (1 - cos(2 pi t/period))/2; other joints stay at rest."""
    moving_joints(joints, tuple(BEND_SHARE), "squat")
    half = config.depth / 2 * np.array([BEND_SHARE.get(joint.name, 0.0) for joint in joints])
    rate = 2 * np.pi / config.period

    def bend(times: np.ndarray) -> Samples:
        angle = rate * times[:, None]
        cos, sin = np.cos(angle), np.sin(angle)
        return Samples(half * (1 - cos), half * rate * sin, half * rate**2 * cos)

    return fade_in(bend, joints, config.fade_in), config.period
