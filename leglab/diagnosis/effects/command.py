"""Gain of native actuators, and effects on the command path of any actuator."""

from collections.abc import Callable
from functools import partial
from typing import Any

import mujoco
import numpy as np

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import EffectParameter, TableEffect, Values, register_effect
from leglab.diagnosis.effects.joints import SizedRow
from leglab.diagnosis.plant.model import Change, Machine
from leglab.diagnosis.plant.paths import COMMAND_PATH, command_path
from leglab.machine.parameters import plugin_tables

_FIXED, _AFFINE = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE)
_NO_BIAS, _AFFINE_BIAS = int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)
_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
# Least duration of the history of commands that a command path keeps.
_SHORTEST_HISTORY = 0.05  # s
_SERVO_BAND = "servo_dead_band"
# Typical command of a servo, as a share of the travel: the smallest trial, 2 %, is 4 mrad.
_SERVO_SHARE = 0.2


def write_command_path(
    spec: mujoco.MjSpec, machine: Machine, actuator: str, values: Values
) -> None:
    """Combines values with an actuator's `leglab.command_path`, which is inserted if missing.

    For paths in series, delays, offsets, dead bands, plays and (nearly) lags add; gains multiply.
    """
    path = next(
        (
            plugin
            for plugin in spec.plugins
            if plugin.plugin_name == COMMAND_PATH and plugin.config.get("actuator") == actuator
        ),
        None,
    )
    old = {"actuator": actuator} if path is None else dict(path.config)
    new = {
        name: float(old.get(name, 1.0)) * value
        if name.startswith("gain")
        else float(old.get(name, 0.0)) + value
        for name, value in values.items()
    }
    if "delay" in new:
        longest = float(old.get("max_delay", _SHORTEST_HISTORY))
        new["max_delay"] = max(longest, new["delay"])
    if path is None:
        joints.insert(spec, COMMAND_PATH, machine.free_name(f"{actuator}_path"), {**old, **new})
    else:
        path.config = {**old, **{name: repr(value) for name, value in new.items()}}


def natives(machine: Machine, wanted: Callable[[Any], bool]) -> tuple[str, ...]:
    """Returns the native actuators that satisfy `wanted`, a test of MuJoCo's view of them."""
    model = machine.base.model
    return tuple(name for name in machine.native_actuators() if wanted(model.actuator(name)))


def position_servos(machine: Machine) -> tuple[str, ...]:
    """Returns the native actuators whose force is a gain times a position error, plus damping."""

    def serves(actuator: Any) -> bool:
        return (
            actuator.gaintype[0] == _FIXED
            and actuator.biastype[0] == _AFFINE_BIAS
            and actuator.dyntype[0] != _INTEGRATOR
            and actuator.biasprm[0] == 0.0
            and actuator.biasprm[1] == -actuator.gainprm[0] != 0.0
            and bool(machine.driven[actuator.name])
        )

    return natives(machine, serves)


def command_size(machine: Machine, element: str) -> float:
    """Returns a typical command of a native actuator: half its range, or 1 without a range.

    For a position servo it is a fifth of its joint's travel, because a servo's command range limits
    its travel but says nothing about its accuracy.
    """
    actuator = machine.base.model.actuator(element)
    if element in position_servos(machine):
        gear = abs(float(actuator.gear[0]))
        return _SERVO_SHARE * gear * joints.travel(machine, machine.driven[element][0])
    return 0.5 * float(np.ptp(actuator.ctrlrange)) if actuator.ctrllimited[0] else 1.0


class CommandEffect(TableEffect):
    """Base of effects that are parameters of a `leglab.command_path`."""

    group = "valve and command"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the native actuators."""
        return machine.native_actuators()

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Applies a command path with these values to the measured command."""
        rows = plugin_tables()[COMMAND_PATH].parameters
        inside = {k: change.within(rows[k], v, rows[k].nominal) for k, v in values.items()}
        for function in command_path(inside):
            change.command(element, function)

    def write(self, change: Change, element: str, values: Values) -> None:
        """Writes the parameter into the actuator's command path."""
        rows = plugin_tables()[COMMAND_PATH].parameters
        if any(value != rows[name].nominal for name, value in values.items()):
            change.edit(
                (self.name, element, *values.values()),
                lambda spec: write_command_path(spec, change.machine, element, values),
            )


def _delayed(element: str, values: Values, spec: mujoco.MjSpec) -> None:
    actuator = spec.actuator(element)
    actuator.delay = delay = float(actuator.delay) + values["delay"]
    actuator.nsample = int(np.ceil(delay / spec.option.timestep)) + 2
    actuator.interp = 1  # linear: a delay need not be a multiple of the time step


@register_effect
class CommandDelay(CommandEffect):
    """The command arrives late."""

    name = "command_delay"
    physics = "u_actuator(t) = u(t - delay)"
    source = "fieldbus and controller cycles: 1 to 40 ms"
    excitation = "commands that change faster than the delay lasts"
    rows = (EffectParameter("delay", "s", upper=0.06, trials=(0.001, 0.004, 0.012, 0.03)),)

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns all actuators."""
        return machine.actuators

    def write(self, change: Change, element: str, values: Values) -> None:
        """Writes the delay to a native actuator's command path, or to a valve's MuJoCo `delay`."""
        if element in change.machine.native_actuators():
            super().write(change, element, values)
        elif values["delay"]:
            change.edit((self.name, element, values["delay"]), partial(_delayed, element, values))


@register_effect
class CommandDeadband(CommandEffect):
    """Small commands have no effect; for position servos, see `ServoDeadband`."""

    name = "command_deadband"
    physics = (
        "u - d sgn(u) beyond |u| = d, nothing below: stage without bias current, PWM dead time."
    )
    source = "Tao and Kokotovic 1996"
    excitation = "commands through zero"
    rows = (SizedRow("dead_band", "ctrl", (0.01, 0.05, 0.2), upper=0.5, size=command_size),)

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the native actuators except position servos."""
        servos = position_servos(machine)
        return tuple(name for name in machine.native_actuators() if name not in servos)


@register_effect
class ServoDeadband(TableEffect):
    """A position servo does not react to small position errors."""

    name = "command_deadband"
    group = "valve and command"
    physics = "kp (e - d sgn(e)) beyond |e| = d, nothing below, of the position error e = u - q."
    source = "dead bands and compliance margins of position servos: 1 to 20 mrad"
    excitation = "rest and slow motion under small loads"
    # The parameter is half the width of the band.
    rows = (SizedRow("dead_band", "ctrl", (0.02, 0.08, 0.3), upper=2.0, size=command_size),)

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the position servos."""
        return position_servos(machine)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Sets the dead band of the servo's command path, which is inserted if missing."""
        band = values["dead_band"]
        if band == 0.0:
            return
        machine = change.machine
        if name := machine.instance_on(COMMAND_PATH, "actuator", element):
            change.add_parameter(name, _SERVO_BAND, band)
        else:
            name = machine.free_name(f"{element}_path")
            key = ("insert", COMMAND_PATH, element)
            change.edit(key, lambda spec: write_command_path(spec, machine, element, {}))
            change.inserted[name] = COMMAND_PATH
            change.set_parameter(name, _SERVO_BAND, band)


@register_effect
class CommandHysteresis(CommandEffect):
    """The command passes through a play (hysteresis)."""

    name = "command_hysteresis"
    physics = "play of full width h between command and what arrives"
    source = "Krasnosel'skii and Pokrovskii 1989"
    excitation = "commands that reverse"
    rows = (SizedRow("hysteresis", "ctrl", (0.02, 0.1, 0.3), upper=1.0, size=command_size),)


@register_effect
class CommandBandwidth(CommandEffect):
    """A slow amplifier or current loop."""

    name = "command_bandwidth"
    physics = "first-order lag of time constant T; bandwidth 1/(2 pi T)"
    source = "current loops of drives: 100 to 1000 Hz"
    excitation = "commands that change within the time constant"
    rows = (EffectParameter("time_constant", "s", upper=0.5, trials=(0.003, 0.015, 0.06)),)


@register_effect
class CommandBias(CommandEffect):
    """A constant is added to the command."""

    name = "command_bias"
    physics = "u + bias; of a stateless actuator with fixed gain this is a force offset, named so"
    source = "offsets of analogue command inputs: within 1 % of full scale"
    excitation = "motion under different loads"
    rows = (
        SizedRow(
            "bias", "ctrl", (-0.1, -0.02, 0.02, 0.1), lower=-0.5, upper=0.5, size=command_size
        ),
    )

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the native actuators whose bias is not a constant force."""
        return natives(machine, lambda a: a.dyntype[0] == _INTEGRATOR or a.gaintype[0] == _AFFINE)


@register_effect
class ActuatorGain(TableEffect):
    """An actuator that is stronger or weaker than the model says."""

    name = "actuator_gain"
    group = "sensing"
    physics = "gain x force: torque constant, gear efficiency, current calibration."
    source = "torque constants of servo motors: 2 % between good ones, 10 % on data sheets"
    excitation = "forces of different size"
    rows = (
        EffectParameter(
            "gain",
            "1",
            nominal=1.0,
            lower=0.05,
            upper=5.0,
            trials=(0.5, 0.9, 0.98, 1.02, 1.1, 1.5),
            tolerance=0.02,
        ),
    )

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the native actuators with fixed or affine gain and bias."""
        gains, biases = (_FIXED, _AFFINE), (_NO_BIAS, _AFFINE_BIAS)
        return natives(machine, lambda a: a.gaintype[0] in gains and a.biastype[0] in biases)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Scales gain and bias of the actuator."""
        gain = values["gain"]

        def edit(spec: mujoco.MjSpec) -> None:
            actuator = spec.actuator(element)
            actuator.gainprm = actuator.gainprm * gain
            actuator.biasprm = actuator.biasprm * gain

        if gain != 1.0:
            change.edit(("actuator_gain", element, gain), edit)
