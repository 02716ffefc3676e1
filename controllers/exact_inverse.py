"""Valve commands computed beforehand for the true machine: a lower bound of the tracking error."""

import numpy as np

from leglab.base.errors import ModelError
from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller
from leglab.control.feedforward.motion import ReferenceMotion
from leglab.controllers.pd import Pd, PdConfiguration


@register_controller(
    "exact_inverse",
    summary="adds to pd the commands found beforehand on the very machine, which no real "
    "controller can have: a bound",
    configuration=PdConfiguration,
)
class ExactInverse:
    """u = c + PD, with commands c computed by iterated simulation of the run and its changes.

    With exact sensors the machine would follow its reference as closely as its valves permit. The
    remaining tracking error is due to valve limits and to noise, resolution and latency of the
    sensors, so it is a lower bound for all controllers with this feedback. PD compares measurements
    with an equally delayed reference.

    Attributes:
        commands: Valve commands by control period, (periods, joints); None before the first run.
    """

    def __init__(self, setup: ControllerSetup, config: PdConfiguration) -> None:
        self._pd = Pd(setup, config)
        machine, period = setup.machine, setup.control_period
        self._motion = ReferenceMotion(
            len(setup.joints),
            period,
            lead=period,
            position_delay=machine.latency,
            velocity_delay=machine.latency + machine.velocity_delay,
        )
        self._find = setup.foreknowledge.exact_commands
        self.commands: np.ndarray | None = None
        self._feedforward = np.zeros(len(setup.joints))

    def reset(self, measurement: Measurement) -> None:
        """Starts a run with the first command.

        Raises:
            LeglabError: The setup has no machine for which commands can be computed.
        """
        if self.commands is None:
            if self._find is None:
                raise ModelError("controller 'exact_inverse' needs the machine of the run")
            self.commands = self._find()
        self._pd.reset(measurement)
        self._motion.clear()
        self._row = 0

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Computes the valve commands, (joints,)."""
        assert self.commands is not None
        self._feedforward = self.commands[min(self._row, len(self.commands) - 1)]
        self._row += 1
        _, seen = self._motion.take(reference)
        return self._feedforward + self._pd.correct(measurement, seen)

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Returns feed-forward and feedback parts of the command, each (joints,)."""
        return {"feedforward": self._feedforward, **self._pd.diagnostics()}
