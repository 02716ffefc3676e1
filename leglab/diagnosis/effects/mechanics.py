"""Inertia of drives and the attitude of the base."""

import math

import mujoco
import numpy as np

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import Effect, EffectParameter, Values, register_effect
from leglab.diagnosis.effects.joints import JointEffect, JointRow
from leglab.diagnosis.plant.model import Change, Machine

_AXES = {"roll": (1.0, 0.0, 0.0), "pitch": (0.0, 1.0, 0.0), "yaw": (0.0, 0.0, 1.0)}
# A tilt that changes no joint force by more than this share of its scale cannot be seen.
_SEEN = 1e-3


@register_effect
class Armature(JointEffect):
    """Inertia that turns with a joint but not with its links."""

    name = "armature"
    group = "mechanics"
    physics = "J q'': rotor and gears, times the ratio squared."
    source = "mechanics; rotor inertias of data sheets are good to 10 %"
    excitation = "accelerations of different size"
    rows = (
        JointRow(
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
class BaseTilt(Effect):
    """The whole machine stands at an angle to gravity."""

    name = "base_tilt"
    group = "mechanics"
    physics = "gravity turned by roll, pitch and yaw about the x, y and z axis of the world"
    source = "mechanics; floors and mounts are level to a few mrad"
    excitation = "positions over a range in which gravity changes"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """The world, if a tilt changes the force on a joint."""
        return ("world",) if self._axes(machine) else ()

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Angles about the axes that matter."""
        return tuple(
            EffectParameter(axis, "rad", lower=-0.6, upper=0.6, trials=(-0.15, -0.03, 0.03, 0.15))
            for axis in self._axes(machine)
        )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Turns the gravity vector."""
        if not any(values.values()):
            return
        turned = change.machine.base.model.opt.gravity.copy()
        for axis, angle in values.items():
            turned = _turn(turned, axis, angle)

        def edit(spec: mujoco.MjSpec) -> None:
            spec.option.gravity = turned

        change.edit(("gravity", *turned.tolist()), edit)

    def _axes(self, machine: Machine) -> tuple[str, ...]:
        """Axes about which a small tilt changes a joint force, differently at different positions.

        Where it changes it by a constant, as on a level slide, that is a force offset.
        """
        model, zero = machine.base.model, np.zeros(3)
        data, gravity = mujoco.MjData(model), model.opt.gravity
        scale = np.array([joints.force_scale(machine, joint) for joint in machine.joints])
        forces: dict[str, list[np.ndarray]] = {axis: [] for axis in _AXES}
        for shift in (0.0, 0.4, -0.7):
            data.qpos[:] = model.qpos0 + shift
            mujoco.mj_fwdPosition(model, data)
            for axis, found in forces.items():
                # Per rad of a small tilt; linear in gravity, and the model itself stays as it is.
                turn = np.cross(_AXES[axis], gravity)
                force = np.zeros(model.nv)
                for body in range(1, model.nbody):
                    weight = model.body_mass[body] * turn
                    mujoco.mj_applyFT(model, data, weight, zero, data.xipos[body], body, force)
                found.append(force / scale)
        return tuple(axis for axis, found in forces.items() if np.ptp(found, axis=0).max() > _SEEN)


def _turn(vector: np.ndarray, axis: str, angle: float) -> np.ndarray:
    """Rotates a vector (3,) about a world axis (Rodrigues)."""
    k = np.array(_AXES[axis])
    sine, cosine = math.sin(angle), math.cos(angle)
    return vector * cosine + np.cross(k, vector) * sine + k * (k @ vector) * (1.0 - cosine)
