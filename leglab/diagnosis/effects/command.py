"""What a command meets on its way to a native actuator: dead band, play, lag, bias."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import mujoco
import numpy as np

from leglab.diagnosis import paths
from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import Effect, EffectParameter, register
from leglab.diagnosis.model import Change, Machine
from leglab.diagnosis.paths import COMMAND_PATH, late


def write_command_path(spec: mujoco.MjSpec, actuator: str, values: Mapping[str, float]) -> None:
    """Sets parameters of an actuator's `leglab.command_path`; inserts one if there is none."""
    for plugin in spec.plugins:
        if plugin.plugin_name == COMMAND_PATH and plugin.config.get("actuator") == actuator:
            plugin.config = {**plugin.config, **{k: repr(float(v)) for k, v in values.items()}}
            return
    joints.insert(spec, COMMAND_PATH, f"{actuator}_path", {"actuator": actuator, **values})


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


def command_scale(machine: Machine, actuator: str) -> float:
    """Size of commands that matters: half the range, 1 where there is none."""
    model = machine.base.model
    i = model.actuator(actuator).id
    if not model.actuator_ctrllimited[i]:
        return 1.0
    return 0.5 * float(np.ptp(model.actuator_ctrlrange[i]))


class CommandEffect(Effect):
    """Base of effects that one parameter of `leglab.command_path` describes.

    Attributes:
        parameter: Of the plugin.
        unit: Its unit.
        shares: Trials, times the command scale or as they are.
        scaled: Whether trials and bounds count in command scales.
        largest: Upper bound, likewise.
        two_sided: Whether negative values make sense.
    """

    group = "valve and command"
    parameter: ClassVar[str]
    unit: ClassVar[str] = "ctrl"
    shares: ClassVar[tuple[float, ...]]
    scaled: ClassVar[bool] = True
    largest: ClassVar[float] = 0.5
    two_sided: ClassVar[bool] = False

    @abstractmethod
    def path(self, samples: np.ndarray, value: float, period: float) -> np.ndarray:
        """What arrives of commands (n,), which are held over the period [s]."""

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Native actuators."""
        return machine.native_actuators()

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The one parameter."""
        size = command_scale(machine, element) if self.scaled else 1.0
        return (
            EffectParameter(
                name=self.parameter,
                unit=self.unit,
                nominal=0.0,
                lower=-self.largest * size if self.two_sided else 0.0,
                upper=self.largest * size,
                trials=tuple(share * size for share in self.shares),
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Passes the measured command through."""
        value = values[self.parameter]
        if value:
            change.command(element, lambda samples, period: self.path(samples, value, period))

    def write(
        self, spec: mujoco.MjSpec, machine: Machine, element: str, values: Mapping[str, float]
    ) -> None:
        """Writes the parameter into the actuator's command path."""
        del machine
        if values[self.parameter]:
            write_command_path(spec, element, {self.parameter: values[self.parameter]})


@register
class CommandDeadband(CommandEffect):
    """Small commands do nothing."""

    name = "command_deadband"
    physics = (
        "u - d sgn(u) beyond |u| = d, nothing below: stage without bias current, PWM dead time."
    )
    source = "Tao and Kokotovic 1996"
    excitation = "commands through zero"
    parameter = "dead_band"
    shares = (0.01, 0.05, 0.2)

    def path(self, samples: np.ndarray, value: float, period: float) -> np.ndarray:
        """Takes the band off."""
        del period
        return paths.dead_band(samples, value)


@register
class CommandHysteresis(CommandEffect):
    """The command drags behind by a play."""

    name = "command_hysteresis"
    physics = "play of full width h between command and what arrives"
    source = "Krasnosel'skii and Pokrovskii 1989"
    excitation = "commands that reverse"
    parameter = "hysteresis"
    shares = (0.02, 0.1, 0.3)
    largest = 1.0

    def path(self, samples: np.ndarray, value: float, period: float) -> np.ndarray:
        """Drags along."""
        del period
        return paths.play(samples, value)


@register
class CommandBandwidth(CommandEffect):
    """A slow amplifier or current loop."""

    name = "command_bandwidth"
    physics = "first-order lag of time constant T; bandwidth 1/(2 pi T)"
    source = "current loops of drives: 100 to 1000 Hz"
    excitation = "commands that change within the time constant"
    parameter = "time_constant"
    unit = "s"
    shares = (0.003, 0.015, 0.06)
    scaled = False

    def path(self, samples: np.ndarray, value: float, period: float) -> np.ndarray:
        """Mean over each period of the exact response to held commands."""
        return paths.lagged(samples, value, period)


@register
class CommandBias(CommandEffect):
    """A constant is added to the command."""

    name = "command_bias"
    physics = "u + bias; of a stateless actuator with fixed gain this is a force offset, named so"
    source = "offsets of analogue command inputs: within 1 % of full scale"
    excitation = "motion under different loads"
    parameter = "bias"
    shares = (-0.1, -0.02, 0.02, 0.1)
    two_sided = True

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Native actuators whose bias is not a constant force."""
        model = machine.base.model
        return tuple(
            name
            for name in machine.native_actuators()
            if model.actuator_dyntype[model.actuator(name).id]
            == int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
            or model.actuator_gaintype[model.actuator(name).id] == int(mujoco.mjtGain.mjGAIN_AFFINE)
        )

    def path(self, samples: np.ndarray, value: float, period: float) -> np.ndarray:
        """Adds the bias."""
        del period
        return samples + value
