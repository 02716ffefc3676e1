"""Columns of recordings that a model can use, with the units and ranges that the model implies."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leglab.diagnosis.plant.model import CHAMBERS, Machine
from leglab.diagnosis.thresholds import FAR

_FREE = (-np.inf, np.inf)


@dataclass(frozen=True)
class UsableColumn:
    """A column that a model can use."""

    name: str  #: For instance "knee_position"
    element: str  #: Joint or actuator
    kind: str  #: "position", "velocity", "command", "pressure_a" or "pressure_b"
    unit: str  #: Unit of the column; "ctrl" if only the actuator defines it
    limits: tuple[float, float] = _FREE  #: Allowed range in `unit`
    follows: str = ""  #: Quantity that a command sets ("position", "velocity", "effort") or ""


def usable_columns(machine: Machine) -> tuple[UsableColumn, ...]:
    """Lists the columns of a recording that a model can use."""
    model = machine.base.model
    found, ranges = [], {}
    for joint in machine.joints:
        entry, unit = model.joint(joint), machine.unit(joint)
        low, high = entry.range.tolist()
        # A cylinder's joint has a stroke even if its limit is not active.
        on_cylinder, ranges[joint] = joint in machine.on_cylinders, _FREE
        if low < high and (model.jnt_limited[entry.id] or on_cylinder):
            ranges[joint] = low, high
        elif on_cylinder and unit == "rad":
            ranges[joint] = -FAR, FAR
        found.append(UsableColumn(f"{joint}_position", joint, "position", unit, ranges[joint]))
        found.append(UsableColumn(f"{joint}_velocity", joint, "velocity", f"{unit}/s"))
    for name in machine.cylinders:
        joint = machine.driven[name][0]
        supply = (0.0, machine.parameter(name, "supply_pressure"))
        found += [UsableColumn(f"{joint}_{c}", joint, c, "Pa", supply) for c in CHAMBERS]
    for name in machine.actuators:
        unit, follows = _control(machine, name)
        entry, limits = model.actuator(name), _FREE
        if entry.ctrllimited[0]:
            limits = tuple(entry.ctrlrange.tolist())
        elif follows == "position" and unit != "ctrl":
            limits = ranges[machine.driven[name][0]]
        found.append(UsableColumn(f"{name}_command", name, "command", unit, limits, follows))
    return tuple(found)


def _control(machine: Machine, name: str) -> tuple[str, str]:
    """Returns unit and controlled quantity of a command u; MuJoCo's force is gain u + bias."""
    if name in machine.cylinders:
        return "1", ""
    entry = machine.base.model.actuator(name)
    stiffness, damping = (float(entry.biasprm[k]) for k in (1, 2))
    follows = "position" if stiffness else "velocity" if damping else "effort"
    is_plain = entry.trntype[0] == mujoco.mjtTrn.mjTRN_JOINT and entry.gear[0] == 1.0
    if not is_plain or (follows == "effort" and entry.gainprm[0] != 1.0):
        return "ctrl", follows
    unit = machine.unit(machine.driven[name][0])
    effort = "N m" if unit == "rad" else "N"
    return {"position": unit, "velocity": f"{unit}/s", "effort": effort}[follows], follows
