"""Feed-forward identified offline on the changed machine: a bound for online learning."""

import numpy as np

from leglab.base.errors import ModelError
from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller
from leglab.controllers.bsnn_arx import AdaptiveConfiguration, AdaptiveController
from leglab.identification import Rls

# Prior variance of the parameters, so large that the recordings alone determine the parameters.
_PRIOR = 1e3


@register_controller(
    "oracle",
    summary="is bsnn_arx with a map identified beforehand on the changed machine, which no real "
    "controller can have: a bound",
    configuration=AdaptiveConfiguration,
)
class Oracle(AdaptiveController):
    """`bsnn_arx` without learning online: maps fitted to recordings before and after the change.

    It knows when the machine changes and has a recording of the changed machine. Therefore no
    controller that has to learn a map of this structure online can be expected to track better.
    """

    name = "oracle"
    freeze = None  # type: ignore[assignment]  # it does not adapt, so nothing can be frozen

    def __init__(self, setup: ControllerSetup, config: AdaptiveConfiguration) -> None:
        config = config.model_copy(update={"supervised": False, "stop_time": 0.0})
        super().__init__(setup, config)
        if setup.foreknowledge.bench_runs is None:
            raise ModelError(f"controller {self.name!r} needs recordings of the changed machine")
        learns = config.model_copy(update={"stop_time": None})
        self._maps = [
            run.identify(self._adaptation(setup, learns, Rls(initial_gain=_PRIOR)))
            for run in setup.foreknowledge.bench_runs()
        ]
        self._change = setup.foreknowledge.last_change

    def reset(self, measurement: Measurement) -> None:
        """Starts a run with the map of the machine before its changes."""
        super().reset(measurement)
        self.adaptation.learner.parameters = self._maps[0]
        self._changed = False

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Computes the valve commands, (joints,)."""
        if not self._changed and measurement.time >= self._change:
            self.adaptation.learner.parameters = self._maps[1]
            self._changed = True
        return super().command(measurement, reference)
