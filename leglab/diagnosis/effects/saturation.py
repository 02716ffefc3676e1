"""Limits of a drive: of its command, and of its force on the joint."""

from typing import Any, Literal

import mujoco
import numpy as np

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import (
    Effect,
    EffectParameter,
    TableEffect,
    Values,
    register_effect,
)
from leglab.diagnosis.effects.command import command_size
from leglab.diagnosis.plant.model import Change, Machine

# Trial values as shares of the model's limit, from one that clips only peaks to one that clips most
# of a motion. They apply until recordings show the magnitudes of commands and forces.
_SHARES = (0.98, 0.9, 0.5, 0.2)
# Limit, as a multiple of the usual command or force, that stands for no limit.
_UNLIMITED = 1e6
# Lowest limit, as a multiple of the usual command or force. A drive with less moves nothing.
_LEAST = 0.01


def _limit(
    unit: str, of: Literal["command", "force"], size: float, most: float, inner: float = 0.0
) -> EffectParameter:
    """Returns a limit between `inner` and `most`; a limit of `most` changes nothing.

    `size` is the usual command or force.
    """
    most = min(most, inner + _UNLIMITED * size)
    return EffectParameter(
        "limit",
        unit,
        nominal=most,
        lower=inner + _LEAST * min(size, most - inner),
        upper=most,
        trials=tuple(inner + share * (most - inner) for share in _SHARES),
        inverse=True,  # steps are shares of the limit
        limit_of=of,
    )


@register_effect
class CommandSaturation(TableEffect):
    """A spool at its stop, or a current at its limit: larger commands have no further effect."""

    name = "command_saturation"
    group = "valve and command"
    physics = "min(max(u, -limit), limit), of the command as it is sent"
    source = "stops of spools, current limits of amplifiers; MuJoCo's ctrlrange"
    gradual = False  # no good machine clips a little
    excitation = "commands beyond the limit"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns all actuators."""
        return machine.actuators

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Returns the limit, which lies within the range of the model's commands."""
        actuator = machine.base.model.actuator(element)
        low, high = actuator.ctrlrange.tolist() if actuator.ctrllimited[0] else (-np.inf, np.inf)
        size, inner = command_size(machine, element), max(low, -high, 0.0)
        return (_limit("ctrl", "command", size, max(-low, high), inner),)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Clips the measured command before the rest of its path, as `ctrlrange` does."""
        limit = values["limit"]
        path = change.commands.setdefault(element, [])
        path.insert(0, lambda samples, _: np.clip(samples, -limit, limit))

    def write(self, change: Change, element: str, values: Values) -> None:
        """Narrows the actuator's `ctrlrange`."""
        limit = values["limit"]

        def edit(spec: mujoco.MjSpec) -> None:
            actuator, own = spec.actuator(element), change.machine.base.model.actuator(element)
            limited = bool(own.ctrllimited[0])
            ends = own.ctrlrange if limited else np.array([-np.inf, np.inf])
            actuator.ctrlrange, actuator.ctrllimited = np.clip(ends, -limit, limit), True

        change.edit((self.name, element, limit), edit)


@register_effect
class ForceSaturation(Effect):
    """The force of native drives on their joint has an upper limit."""

    name = "force_saturation"
    group = "valve and command"
    physics = "min(max(F, -limit), limit), of the force of the drives on the joint"
    source = "current limits of motors, slipping clutches; MuJoCo's forcerange, actuatorfrcrange"
    gradual = False  # no good machine clips a little
    excitation = "forces beyond the limit"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the joints that only native actuators drive."""
        native = {j for a in machine.native_actuators() for j in machine.driven[a]}
        return tuple(j for j in machine.joints if j in native - machine.on_cylinders)

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Returns the limit, which does not exceed the limits of the model."""
        joint = machine.base.model.joint(element)
        most = np.inf
        if machine.base.model.jnt_actfrclimited[joint.id]:
            most = np.abs(machine.base.model.jnt_actfrcrange[joint.id]).max()
        if (alone := _alone(machine, element)) and alone.forcelimited[0]:
            gear = abs(machine.moment(alone.name, element))
            most = min(most, gear * np.abs(alone.forcerange).max())
        unit, size = joints.joint_unit(machine, element, "{force}"), joints.force_scale
        return (_limit(unit, "force", size(machine, element), float(most)),)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Narrows `forcerange` of the only drive, or `actuatorfrcrange` of the joint."""
        machine, limit = change.machine, values["limit"]
        alone, joint = _alone(machine, element), machine.base.model.joint(element)

        def edit(spec: mujoco.MjSpec) -> None:
            if alone:
                at_drive = limit / abs(machine.moment(alone.name, element))
                own = alone.forcerange if alone.forcelimited[0] else np.array([-np.inf, np.inf])
                actuator = spec.actuator(alone.name)
                actuator.forcerange, actuator.forcelimited = np.clip(own, -at_drive, at_drive), True
                return
            model = machine.base.model
            limited = model.jnt_actfrclimited[joint.id]
            own = model.jnt_actfrcrange[joint.id] if limited else np.array([-np.inf, np.inf])
            spec.joint(element).actfrcrange = np.clip(own, -limit, limit)
            spec.joint(element).actfrclimited = True

        change.edit((self.name, element, limit), edit)


def _alone(machine: Machine, joint: str) -> Any:
    """Returns MuJoCo's view of a joint's actuator if it is the only one and direct; else None."""
    driving = [a for a in machine.actuators if joint in machine.driven[a]]
    actuator = machine.base.model.actuator(driving[0])
    on_joint = int(actuator.trntype[0]) == int(mujoco.mjtTrn.mjTRN_JOINT)
    return actuator if len(driving) == 1 and on_joint else None
