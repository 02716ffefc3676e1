"""Effects on joints: base class, scales of trial values, and insertion of plugin instances."""

import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from functools import lru_cache
from typing import ClassVar

import mujoco
import numpy as np

from leglab.diagnosis.effects.base import EffectParameter, Group, TableEffect, Values
from leglab.diagnosis.plant.model import Change, Machine
from leglab.machine.parameters import plugin_tables

# Standard deviation of MuJoCo's joint attributes between good machines, as a share of the value.
_TOLERANCE = 0.1

# Function of machine and joint or actuator that returns the scale of a quantity.
Size = Callable[[Machine, str], float]


def joint_unit(machine: Machine, joint: str, pattern: str) -> str:
    """Replaces "{force}", "{inertia}" and "{length}" by the units of a hinge or slide."""
    if machine.unit(joint) == "rad":
        return pattern.format(force="N m", inertia="kg m^2", length="rad")
    return pattern.format(force="N", inertia="kg", length="m")


def inertia(machine: Machine, joint: str) -> float:
    """Returns the effective inertia of a joint at qpos0 [kg m^2 or kg]: 1/(M^-1)_ii."""
    model = machine.base.model
    return 1.0 / float(model.dof_invweight0[model.joint(joint).dofadr[0]])


def force_scale(machine: Machine, joint: str) -> float:
    """Returns a typical force on a joint [N m or N]: largest gravity force + inertia x 10/s^2."""
    return gravity(machine, joint) + 10.0 * inertia(machine, joint)


@lru_cache(maxsize=256)
def gravity(machine: Machine, joint: str) -> float:
    """Returns the largest force of gravity on a joint over its positions [N m or N]."""
    model = machine.base.model
    data = mujoco.MjData(model)
    reach = 2.0 * math.pi if machine.unit(joint) == "rad" else 1.0
    found = []
    for share in np.arange(12) / 12.0:
        data.qpos[:] = model.qpos0
        data.joint(joint).qpos[0] += share * reach
        mujoco.mj_forward(model, data)
        found.append(abs(float(data.joint(joint).qfrc_bias[0])))
    return max(found)


def drive_damping(machine: Machine, joint: str) -> float:
    """Returns the viscous friction of a joint and its cylinders [N m s/rad or N s/m]."""
    total = native(machine, joint, "damping")
    for cylinder in machine.cylinders:
        total += machine.parameter(cylinder, "viscous") * machine.moment(cylinder, joint) ** 2
    return total


def on_slide(value: float) -> Size:
    """Returns a scale that is 1 for a hinge and `value` for a slide."""
    return lambda machine, joint: 1.0 if machine.unit(joint) == "rad" else value


# Typical displacement of a joint [rad or m].
travel = on_slide(0.2)


def native(machine: Machine, joint: str, field: str) -> float:
    """Returns MuJoCo's "damping", "frictionloss", "armature" or "stiffness" of a joint."""
    return float(getattr(machine.base.model.joint(joint), field)[0])


def set_native(change: Change, joint: str, field: str, value: float) -> None:
    """Adds to a change an edit that sets a field as in `native`, unless it has the value."""

    def edit(spec: mujoco.MjSpec) -> None:
        if field in ("damping", "stiffness"):  # coefficients of a polynomial
            getattr(spec.joint(joint), field)[0] = value
        else:
            setattr(spec.joint(joint), field, value)

    if value != native(change.machine, joint, field):
        change.edit((field, joint, value), edit)


def insert(spec: mujoco.MjSpec, plugin: str, name: str, config: Mapping[str, float | str]) -> None:
    """Adds a plugin instance to a specification."""
    spec.activate_plugin(plugin)
    text = {k: v if isinstance(v, str) else repr(float(v)) for k, v in config.items()}
    spec.add_plugin(name=name, plugin_name=plugin).config = text


def insert_on_joint(
    change: Change, plugin: str, name: str, joint: str, config: Mapping[str, float], values: Values
) -> None:
    """Adds to a change a plugin instance with `config` on a joint, and sets its `values`.

    A number is appended to the name if an element has it already.
    """
    name = change.machine.free_name(name)
    rows = plugin_tables()[plugin].parameters
    kept = {k: change.within(rows[k], v, rows[k].nominal) for k, v in config.items()}
    full: dict[str, float | str] = {"joint": joint, **kept}
    key = ("insert", plugin, name, *sorted(full.items(), key=str))
    change.inserted[name] = plugin
    change.edit(key, lambda spec: insert(spec, plugin, name, full))
    for parameter, value in values.items():
        change.set_parameter(name, parameter, value)


def mean_and_difference(pairs: tuple[tuple[str, str], ...], values: Values) -> dict[str, float]:
    """Converts friction by direction, in pairs of names, to its mean and difference."""
    found = {}
    for kind, (one, other) in zip(("viscous", "coulomb"), pairs, strict=True):
        found[kind] = 0.5 * (values[one] + values[other])
        found[f"{kind}_difference"] = values[one] - values[other]
    return found


@dataclass(frozen=True)
class SizedRow:
    """A parameter of an effect on joints or actuators, with trials and bounds by a scale."""

    name: str  #: As in `EffectParameter`
    unit: str  #: As in `EffectParameter`; of a joint a pattern of `joint_unit`
    trials: tuple[float, ...]  #: Multiples of `size` above the model's value
    _: KW_ONLY
    lower: float = 0.0  #: Smallest value, as a multiple of `size`
    upper: float  #: Largest value, as a multiple of `size` above the model's value
    size: Size = force_scale  #: Scale of a joint or actuator
    #: MuJoCo's field with the joint's value, see `native`; half of this value is also a trial.
    field: str = ""
    half_above: float = 0.0  #: Multiple of `size` above which half the value is a trial
    own: Size = lambda machine, element: 0.0  #: The model's value if `field` is empty

    def __call__(self, machine: Machine, element: str) -> EffectParameter:
        """Returns the parameter on a joint or actuator."""
        size = self.size(machine, element)
        own = native(machine, element, self.field) if self.field else self.own(machine, element)
        half = (0.5 * own,) if self.field and own > self.half_above * size else ()
        return EffectParameter(
            self.name,
            joint_unit(machine, element, self.unit) if "{" in self.unit else self.unit,
            nominal=own,
            lower=self.lower * size,
            upper=own + self.upper * size,
            trials=(*half, *(own + share * size for share in self.trials)),
            tolerance=_TOLERANCE * own if self.field else 0.0,
        )


class JointEffect(TableEffect):
    """Base of effects on joints."""

    group: ClassVar[Group] = "mechanics"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns all joints."""
        return machine.joints

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Sets the MuJoCo fields that the rows name."""
        for row in self.rows:
            if isinstance(row, SizedRow) and row.field:
                set_native(change, element, row.field, values[row.name])
