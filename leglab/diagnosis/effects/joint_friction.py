"""Viscous, dry and breakaway friction of joints without a cylinder."""

from collections.abc import Mapping

import mujoco

from leglab.diagnosis.change import Change
from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import Effect, EffectParameter, register
from leglab.diagnosis.machine import FRICTION, Machine


@register
class JointViscousFriction(Effect):
    """Another damping of a joint."""

    name = "viscous_friction"
    group = "friction"
    physics = "b v: lubricated bearings, grease, eddy currents."
    source = "Armstrong-Helouvry et al. 1994; 10 % between good machines"
    excitation = "fast motion"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Joints without a cylinder."""
        return joints.plain_joints(machine)

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The joint's damping."""
        own = float(machine.base.model.dof_damping[joints.dof(machine, element)])
        size = joints.force_scale(machine, element)
        trials = tuple(own + share * size for share in (0.02, 0.15))
        return (
            EffectParameter(
                name="damping",
                unit=f"{joints.force_unit(machine, element)} s/{joints.unit(machine, element)}",
                nominal=own,
                lower=0.0,
                upper=own + 10.0 * size,
                trials=(0.5 * own, *trials) if own > 0 else trials,
                tolerance=0.1 * own,
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Sets MuJoCo's own damping."""
        damping = values["damping"]
        own = change.machine.base.model.dof_damping[joints.dof(change.machine, element)]

        def edit(spec: mujoco.MjSpec) -> None:
            spec.joint(element).damping[0] = damping

        if damping != own:
            change.edit(("damping", element, damping), edit)


@register
class JointCoulombFriction(Effect):
    """Another dry friction of a joint."""

    name = "coulomb_friction"
    group = "friction"
    physics = "F_c sgn(v); at rest it holds up to F_c."
    source = "Armstrong-Helouvry et al. 1994"
    excitation = "slow motion in both directions, and rest"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Joints without a cylinder."""
        return joints.plain_joints(machine)

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The joint's friction loss."""
        own = float(machine.base.model.dof_frictionloss[joints.dof(machine, element)])
        size = joints.force_scale(machine, element)
        trials = tuple(own + share * size for share in (0.01, 0.08))
        return (
            EffectParameter(
                name="coulomb",
                unit=joints.force_unit(machine, element),
                nominal=own,
                lower=0.0,
                upper=own + size,
                trials=(0.5 * own, *trials) if own > 0 else trials,
                tolerance=0.1 * own,
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Sets MuJoCo's own friction loss."""
        coulomb = values["coulomb"]
        own = change.machine.base.model.dof_frictionloss[joints.dof(change.machine, element)]

        def edit(spec: mujoco.MjSpec) -> None:
            spec.joint(element).frictionloss = coulomb

        if coulomb != own:
            change.edit(("frictionloss", element, coulomb), edit)


@register
class JointStiction(Effect):
    """Breakaway friction above the Coulomb friction of a joint."""

    name = "stiction"
    group = "friction"
    physics = "(F_s - F_c) exp(-(v/v_s)^2) sgn(v), LuGre bristle before sliding."
    source = "Canudas de Wit et al. 1995"
    excitation = "slow motion, reversals and rest"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Joints without a cylinder."""
        return joints.plain_joints(machine)

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Breakaway above Coulomb friction, and the Stribeck velocity."""
        size = joints.force_scale(machine, element)
        length = joints.unit(machine, element)
        return (
            EffectParameter(
                name="breakaway",
                unit=joints.force_unit(machine, element),
                nominal=0.0,
                lower=0.0,
                upper=size,
                trials=(0.02 * size, 0.1 * size),
            ),
            EffectParameter(
                name="stribeck_velocity",
                unit=f"{length}/s",
                nominal=0.05 if length == "rad" else 0.01,
                lower=0.005 if length == "rad" else 0.001,
                upper=1.0 if length == "rad" else 0.2,
                role="shape",
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Inserts joint friction that has a breakaway level only."""
        if values["breakaway"] == 0.0:
            return
        name = f"{element}_stiction"
        bristle = joints.bristle(change.machine, element)
        joints.insert_on_joint(change, FRICTION, name, element, bristle)
        change.set_parameter(name, "static", values["breakaway"])
        change.set_parameter(name, "stribeck_velocity", values["stribeck_velocity"])
