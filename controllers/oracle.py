"""Feed-forward identified offline on the changed machine: the bound for the learned structure."""

import math

import numpy as np

from leglab.base.errors import LeglabError
from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller
from leglab.control.feedforward.offline import BenchRun
from leglab.controllers.bsnn_arx import AdaptiveConfiguration, AdaptiveController
from leglab.identification import Rls

# Prior variance of the parameters, so wide that the recording alone decides.
_PRIOR = 1e3


@register_controller(
    "oracle",
    summary="the map of bsnn_arx identified offline on the machine before and after its change",
    configuration=AdaptiveConfiguration,
)
class Oracle(AdaptiveController):
    """As `bsnn_arx`, but it does not learn: least squares over recordings of both machines.

    It knows when the machine changes, and it has been on the changed machine before: nothing that
    adapts can be expected to do better with the same map.
    """

    name = "oracle"

    def __init__(self, setup: ControllerSetup, config: AdaptiveConfiguration) -> None:
        config = config.model_copy(update={"supervised": False})
        super().__init__(setup, config)
        if setup.foreknowledge.bench_runs is None:
            raise LeglabError(f"controller {self.name!r} needs recordings of the changed machine")
        runs = setup.foreknowledge.bench_runs()
        self._maps = [self._identify(setup, config, run) for run in runs]
        self._change = setup.foreknowledge.last_change

    def _stop_time(self, setup: ControllerSetup, config: AdaptiveConfiguration) -> float:
        return 0.0

    def _identify(
        self, setup: ControllerSetup, config: AdaptiveConfiguration, run: BenchRun
    ) -> np.ndarray:
        learning = self._adaptation(setup, config, Rls(initial_gain=_PRIOR), math.inf, False)
        return run.identify(learning)

    def reset(self, measurement: Measurement) -> None:
        """Starts a run with the map of the machine before its change."""
        super().reset(measurement)
        self.adaptation.learner.parameters = self._maps[0]
        self._changed = False

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Valve commands, (joints,)."""
        if not self._changed and measurement.time >= self._change:
            self.adaptation.learner.parameters = self._maps[1]
            self._changed = True
        return super().command(measurement, reference)
