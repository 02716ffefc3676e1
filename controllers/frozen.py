"""Adaptive feed-forward that stops adapting before the machine changes, for comparison."""

from leglab.control import ControllerSetup, register_controller
from leglab.controllers.bsnn_arx import AdaptiveConfiguration, AdaptiveController


@register_controller(
    "frozen",
    summary="is bsnn_arx that stops learning just before the machine changes",
    configuration=AdaptiveConfiguration,
)
class Frozen(AdaptiveController):
    """`bsnn_arx` whose `stop_time` defaults to the first change of the scenario."""

    name = "frozen"

    def __init__(self, setup: ControllerSetup, config: AdaptiveConfiguration) -> None:
        if config.stop_time is None:
            first = setup.foreknowledge.first_change
            config = config.model_copy(update={"stop_time": first})
        super().__init__(setup, config)
