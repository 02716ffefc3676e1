"""Inertia of drives, payloads and the attitude of the base."""

import math
from typing import Any

import mujoco
import numpy as np

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import Effect, EffectParameter, Values, register_effect
from leglab.diagnosis.effects.joints import JointEffect, SizedRow
from leglab.diagnosis.plant.model import Change, Machine

_AXES = {"roll": (1.0, 0.0, 0.0), "pitch": (0.0, 1.0, 0.0), "yaw": (0.0, 0.0, 1.0)}
# Least visible variation of a joint force per rad of tilt, relative to the force scale.
_SEEN = 1e-3


@register_effect
class Armature(JointEffect):
    """Inertia that turns with a joint but not with its links."""

    name = "armature"
    physics = "J q'': rotor and gears, times the ratio squared."
    source = "mechanics; rotor inertias of data sheets are good to 10 %"
    excitation = "accelerations of different size"
    rows = (
        SizedRow(
            "inertia",
            "{inertia}",
            (0.05, 0.4),
            upper=10.0,
            size=joints.inertia,
            field="armature",
            half_above=0.02,
        ),
    )


@register_effect
class Payload(Effect):
    """A point mass fixed to a moving body."""

    name = "payload"
    group = "mechanics"
    on_bodies = True
    physics = (
        "Point mass m at a distance r along the line from the joint to the body's centre; less is "
        "a body of the same shape and another density."
    )
    source = "mechanics; bounds: tools and loads of a leg of 5 to 80 kg"
    excitation = "positions away from the balance point; speed changes separate m r from m r^2"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the bodies with mass and a joint; a nameless body has its joint's name."""
        model = machine.base.model
        found = []
        for i in range(1, model.nbody):
            if model.body_jntnum[i] and model.body_mass[i] > 0:
                found.append(model.body(i).name or model.joint(model.body_jntadr[i]).name)
        return tuple(dict.fromkeys(found))

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Returns mass and distance."""
        body = moved_body(machine, element)
        own, reach = float(body.mass[0]), float((body.ipos**2).sum() ** 0.5)
        # Good links may be lighter or heavier than drawn, but only an added load is a fault.
        mass = EffectParameter(
            "mass",
            "kg",
            lower=-0.1 * own,
            upper=5.0 * own,
            trials=(0.05 * own, 0.4 * own),
            faults="above",
        )
        if reach == 0.0:  # the line has no length, so the mass is at the centre
            return (mass,)
        limits = 1.5 * reach, 0.1 * reach, 3.0 * reach
        return mass, EffectParameter.shape("distance", "m", *limits)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Adds a body with the mass, or lightens the body; new values require a compilation."""
        mass, distance = values["mass"], values.get("distance", 0.0)
        if mass == 0.0:
            return
        own = moved_body(change.machine, element)
        centre = own.ipos
        reach = float((centre @ centre) ** 0.5)
        position = centre * (distance / reach) if reach > 0.0 else centre

        name = change.machine.free_name(f"{element}_payload")

        def add(spec: mujoco.MjSpec) -> None:
            body = spec.body(element) or spec.joint(element).parent
            if mass < 0.0:
                share = 1.0 + mass / own.mass[0]
                body.mass, body.inertia = share * own.mass[0], share * own.inertia
                body.ipos, body.iquat, body.explicitinertial = own.ipos, own.iquat, True
                body.fullinertia = np.full(6, np.nan)
                return
            load = body.add_body(name=name, pos=position)
            load.mass = mass
            load.ipos = [0.0, 0.0, 0.0]  # otherwise MuJoCo adds the body's position a second time
            load.inertia = [1e-9, 1e-9, 1e-9]  # MuJoCo needs positive inertia; a point has none
            load.explicitinertial = True

        change.edit(("payload", element, mass, distance), add)


def moved_body(machine: Machine, element: str) -> Any:
    """Returns MuJoCo's view of a body by the name of the body or of its first joint."""
    model = machine.base.model
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, element) < 0:
        return model.body(int(model.joint(element).bodyid[0]))
    return model.body(element)


@register_effect
class BaseTilt(Effect):
    """The whole machine stands at an angle to gravity."""

    name = "base_tilt"
    group = "mechanics"
    physics = "gravity turned by roll, pitch and yaw about the x, y and z axis of the world"
    source = "mechanics; floors and mounts are level to a few mrad"
    excitation = "positions over a range in which gravity changes"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the world if a tilt changes the force on a joint."""
        return ("world",) if self._axes(machine) else ()

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Returns the angles about the axes that change a joint force."""
        return tuple(
            EffectParameter(axis, "rad", lower=-0.6, upper=0.6, trials=(-0.15, -0.03, 0.03, 0.15))
            for axis in self._axes(machine)
        )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Turns the gravity vector."""
        if not any(values.values()):
            return
        turned = change.machine.base.model.opt.gravity
        for axis, angle in values.items():
            # Rodrigues' rotation formula.
            k, sine, cosine = np.array(_AXES[axis]), math.sin(angle), math.cos(angle)
            along = k * (k @ turned) * (1.0 - cosine)
            turned = turned * cosine + np.cross(k, turned) * sine + along

        def edit(spec: mujoco.MjSpec) -> None:
            spec.option.gravity = turned

        change.edit(("gravity", *turned.tolist()), edit)

    def _axes(self, machine: Machine) -> list[str]:
        """Returns the tilt axes for which the change of a joint force varies with the position.

        A change that is equal at all positions (a level slide) is the effect `force_offset`.
        """
        model = machine.base.model
        data, lever = mujoco.MjData(model), np.zeros((3, model.nv))
        scale = np.array([joints.force_scale(machine, joint) for joint in machine.joints])
        # Change of gravity per rad of a small tilt, by axis.
        turns = np.cross(list(_AXES.values()), model.opt.gravity)
        forces = []
        for shift in (0.0, 0.4, -0.7):
            data.qpos[:] = model.qpos0 + shift
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_jacSubtreeCom(model, data, lever, 0)
            forces.append(turns @ lever * model.body_subtreemass[0] / scale)
        seen = np.ptp(forces, axis=0).max(axis=1) > _SEEN
        return [axis for axis, matters in zip(_AXES, seen, strict=True) if matters]
