"""Gains of native valves and amplifiers, and gains and dead bands that differ by command sign."""

import mujoco
import numpy as np

from leglab.diagnosis.effects.base import EffectParameter, Values, register_effect
from leglab.diagnosis.effects.command import (
    CommandDeadband,
    CommandEffect,
    command_size,
    natives,
    position_servos,
)
from leglab.diagnosis.effects.joints import SizedRow
from leglab.diagnosis.plant.model import Change, Machine
from leglab.diagnosis.plant.paths import COMMAND_PATH

_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
_GAINS = ("gain_positive", "gain_negative")


def _by_speed(machine: Machine) -> tuple[str, ...]:
    """Returns the native actuators whose command is a speed, so that a gain scales no force."""
    return natives(machine, lambda a: a.dyntype[0] == _INTEGRATOR or a.biasprm[2] != 0.0)


def _gain(name: str) -> EffectParameter:
    return EffectParameter(
        name, "1", nominal=1.0, lower=0.05, upper=5.0, trials=(0.5, 0.9, 1.1, 1.5)
    )


class _Gain(CommandEffect):
    """Base of effects that scale the command after the dead band."""

    order = 1  # after dead bands, which refer to the command before this gain
    excitation = "commands of different size"
    source = "gains of valves: within 10 % (type 30 data sheets), and of their amplifiers"

    def write(self, change: Change, element: str, values: Values) -> None:
        """Writes both gains into the actuator's command path, and narrows `ctrlrange` accordingly.

        MuJoCo clips commands before the path, whereas replays clip commands after the path.
        """
        super().write(change, element, values)
        model = change.machine.base.model.actuator(element)

        def edit(spec: mujoco.MjSpec) -> None:
            actuator, config = spec.actuator(element), _path_of(spec, element)
            ends = []
            for side, end in zip(("negative", "positive"), model.ctrlrange, strict=True):
                both = (config.get(name, 0.0) for name in ("dead_band", f"dead_band_{side}"))
                band, gain = sum(map(float, both)), values[f"gain_{side}"]
                ends.append(end / gain + np.copysign(band, end))
            actuator.ctrlrange = np.clip(ends, *actuator.ctrlrange)

        if model.ctrllimited[0] and max(values.values()) > 1.0:
            change.edit((self.name, element, "ctrlrange", *values.values()), edit)


def _path_of(spec: mujoco.MjSpec, actuator: str) -> dict[str, str]:
    """Returns the parameters of an actuator's command path."""
    paths = (dict(p.config) for p in spec.plugins if p.plugin_name == COMMAND_PATH)
    return next((config for config in paths if config.get("actuator") == actuator), {})


@register_effect
class CommandGain(_Gain):
    """A valve passes more or less flow, or an amplifier demands more or less speed."""

    name = "command_gain"
    physics = "gain u, of the speed that is asked for; of a motor this is the gain of its force"
    rows = (_gain("gain"),)

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the native actuators whose command is a speed."""
        servos = position_servos(machine)
        return tuple(name for name in _by_speed(machine) if name not in servos)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Applies one gain to measured commands of either sign."""
        super().apply(change, element, dict.fromkeys(_GAINS, values["gain"]))

    def write(self, change: Change, element: str, values: Values) -> None:
        """Writes the gain for both signs."""
        super().write(change, element, dict.fromkeys(_GAINS, values["gain"]))


@register_effect
class CommandGainAsymmetry(_Gain):
    """A valve or amplifier responds more strongly to commands of one sign than of the other."""

    name = "command_gain_asymmetry"
    physics = "g_1 u for positive and g_2 u for negative commands"
    contains = ("actuator_gain",)
    by_direction = (_GAINS,)
    rows = tuple(_gain(name) for name in _GAINS)

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the native actuators whose command is a force."""
        speeds = (*_by_speed(machine), *position_servos(machine))
        return tuple(name for name in machine.native_actuators() if name not in speeds)


@register_effect
class SpeedGainAsymmetry(CommandGainAsymmetry):
    """One side of a valve passes more flow than the other."""

    contains = ("command_gain",)

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the native actuators whose command is a speed."""
        return CommandGain().elements(machine)


@register_effect
class CommandDeadbandAsymmetry(CommandEffect):
    """A valve's edges overlap more on one side, or its null has moved within its overlap."""

    name = "command_deadband_asymmetry"
    physics = "u - d_1 beyond d_1 > 0, u + d_2 beyond -d_2 < 0, nothing between"
    source = "overlapped spools: null shift within 2 % (type 30 data sheets)"
    excitation = "commands through zero"
    contains = ("command_deadband",)
    by_direction = (("dead_band_positive", "dead_band_negative"),)
    rows = tuple(
        SizedRow(name, "ctrl", (0.01, 0.05, 0.2), upper=0.5, size=command_size)
        for name in by_direction[0]
    )

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the native actuators except position servos."""
        return CommandDeadband().elements(machine)
