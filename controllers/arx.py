"""Linear adaptive feed-forward added to PD: a baseline that shows the gain by the splines."""

from pydantic import Field

from leglab.control import register_controller
from leglab.controllers.bsnn_arx import AdaptiveConfiguration, AdaptiveController


class ArxConfiguration(AdaptiveConfiguration):
    """Settings of `arx`: those of `bsnn_arx`, without splines.

    Attributes:
        velocity_splines: None.
        position_splines: None.
        settle_time: As `bsnn_arx`; what a linear map leaves out it makes good by following within
            the stride, which a slow map takes away.
    """

    velocity_splines: int = Field(default=0, ge=0, le=0)
    position_splines: int = Field(default=0, ge=0, le=0)
    settle_time: float = Field(default=0.0, ge=0)


@register_controller(
    "arx",
    summary="is bsnn_arx with a map that is linear in the motion, without splines",
    configuration=ArxConfiguration,
)
class Arx(AdaptiveController):
    """`bsnn_arx` with a map that is linear in the motion."""

    name = "arx"
