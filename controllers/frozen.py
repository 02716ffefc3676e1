"""The adaptive feed-forward with its adaptation stopped: what adapting on would have gained."""

from leglab.control import ControllerSetup, register_controller
from leglab.controllers.bsnn_arx import AdaptiveConfiguration, AdaptiveController


@register_controller(
    "frozen",
    summary="bsnn_arx, adapting no more from just before the machine changes",
    configuration=AdaptiveConfiguration,
)
class Frozen(AdaptiveController):
    """As `bsnn_arx`; `stop_time` defaults to the first change of the scenario."""

    name = "frozen"

    def _stop_time(self, setup: ControllerSetup, config: AdaptiveConfiguration) -> float:
        if config.stop_time is not None:
            return config.stop_time
        return setup.foreknowledge.first_change
