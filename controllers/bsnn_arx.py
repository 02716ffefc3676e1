"""The standard adaptive feed-forward, added to PD: a learned inverse (motion to valve command)."""

import numpy as np

from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller
from leglab.control.feedforward.adaptive import AdaptiveFeedforward, LearningConfiguration
from leglab.control.feedforward.inverse_map import InverseMap
from leglab.control.feedforward.valve_table import ValveTable
from leglab.controllers.pd import Pd, PdConfiguration
from leglab.identification import Rls


class AdaptiveConfiguration(LearningConfiguration, PdConfiguration):
    """Settings of every controller that learns the inverse map: of learning, and those of `pd`."""


@register_controller(
    "bsnn_arx",
    summary="adds to pd the valve command that the wanted motion needs, by a map that it learns "
    "while the machine moves",
    configuration=AdaptiveConfiguration,
)
class AdaptiveController:
    """u = map(r, r', r'', r''') + PD; PD compares measurements with an equally delayed reference.

    The map starts as the nominal valve map and learns from commands that were sent and the motion
    that followed them. See `leglab.control.feedforward`.
    """

    name = "bsnn_arx"
    valve_states = False  # passed to `AdaptiveFeedforward`

    def __init__(self, setup: ControllerSetup, config: AdaptiveConfiguration) -> None:
        self._feedback = Pd(setup, config)
        self.adaptation = self._adaptation(setup, config, config.rls)

    def _adaptation(
        self, setup: ControllerSetup, config: AdaptiveConfiguration, rls: Rls
    ) -> AdaptiveFeedforward:
        maps = setup.machine.valve_maps
        latency = setup.machine.latency
        inverse_map = InverseMap(
            len(setup.joints),
            rls,
            velocity_splines=config.velocity_splines,
            position_splines=config.position_splines,
            least_memory=config.least_memory,
        )
        return AdaptiveFeedforward(
            inverse_map,
            ValveTable.of(maps, np.asarray(setup.machine.direction)),
            self._feedback.position_gain,
            self._feedback.velocity_gain,
            config,
            valve_states=self.valve_states,
            control_period=setup.control_period,
            latency=latency,
            velocity_delay=latency + setup.machine.velocity_delay,
        )

    def reset(self, measurement: Measurement) -> None:
        """Starts a run with the nominal map."""
        self.adaptation.reset()

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Computes the valve commands, (joints,)."""
        self.look(measurement.time)
        return self.adaptation.step(measurement, reference)

    def look(self, time: float) -> None:
        """Hook for subclasses that is called before each control period, at a time [s]."""

    def sent(self, command: np.ndarray) -> None:
        """Records the commands that were sent in place of the result of `command`, (joints,)."""
        self.adaptation.sent(command)

    def freeze(self) -> None:
        """Stops adapting until the next `reset`."""
        self.adaptation.freeze()

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Returns feed-forward, feedback, model error, and 1 for joints with the nominal map."""
        return self.adaptation.report
