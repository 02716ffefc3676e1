"""Faults between the measured command and the actuator, for any actuator."""

from collections.abc import Mapping

import mujoco
import numpy as np

from leglab.diagnosis.change import Change
from leglab.diagnosis.effects.base import Effect, EffectParameter, register
from leglab.diagnosis.effects.command_path import write_command_path
from leglab.diagnosis.machine import Machine
from leglab.diagnosis.paths import late

# A command path keeps at least this much history.
_SHORTEST_HISTORY = 0.05  # s


@register
class CommandDelay(Effect):
    """The command arrives late."""

    name = "command_delay"
    group = "valve and command"
    physics = "u_actuator(t) = u(t - delay)"
    source = "fieldbus and controller cycles: 1 to 40 ms"
    excitation = "commands that change faster than the delay lasts"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """All actuators."""
        return machine.actuators

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The delay."""
        del machine, element
        return (
            EffectParameter(
                name="delay",
                unit="s",
                nominal=0.0,
                lower=0.0,
                upper=0.06,
                trials=(0.001, 0.004, 0.012, 0.03),
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Shifts the measured command."""
        delay = values["delay"]
        if delay:
            change.command(element, late(delay))

    def write(
        self, spec: mujoco.MjSpec, machine: Machine, element: str, values: Mapping[str, float]
    ) -> None:
        """Writes the delay of a native actuator's command path, or MuJoCo's own for a valve."""
        delay = values["delay"]
        if delay == 0.0:
            return
        if element in machine.native_actuators():
            longest = max(delay, _SHORTEST_HISTORY)
            write_command_path(spec, element, {"delay": delay, "max_delay": longest})
            return
        actuator = spec.actuator(element)
        delay += float(actuator.delay)  # of the model as it was
        actuator.delay = delay
        actuator.nsample = int(np.ceil(delay / spec.option.timestep)) + 2
        actuator.interp = 1  # linear: a delay need not be a multiple of the time step
