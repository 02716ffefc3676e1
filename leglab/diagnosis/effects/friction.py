"""Friction of joints: viscous, Coulomb, stiction, load-dependent and asymmetric."""

import math
from dataclasses import replace

import mujoco

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import EffectParameter, Row, Values, register_effect
from leglab.diagnosis.effects.joints import JointEffect, SizedRow
from leglab.diagnosis.plant.model import FRICTION, Change, Machine

# Natural frequency of LuGre bristles, half damped: stiff for a joint, yet stable at 1 ms steps.
_BRISTLE = 2.0 * math.pi * 100.0  # rad/s

# Impedance of MuJoCo's friction loss (solimp): share of a load that friction holds without creep.
_HOLDS = 0.9999


class FrictionEffect(JointEffect):
    """Base of friction effects on joints without a cylinder."""

    group = "friction"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the joints without a cylinder."""
        return tuple(joint for joint in machine.joints if joint not in machine.on_cylinders)


@register_effect
class JointViscousFriction(FrictionEffect):
    """Viscous friction of a joint, MuJoCo's damping, that differs from the model."""

    name = "viscous_friction"
    physics = "b v: lubricated bearings, grease, eddy currents."
    source = "Armstrong-Helouvry et al. 1994; 10 % between good machines"
    excitation = "fast motion"
    rows = (SizedRow("damping", "{force} s/{length}", (0.02, 0.15), upper=10.0, field="damping"),)


def insert_friction(change: Change, joint: str, effect: str, values: Values) -> None:
    """Inserts a `leglab.joint_friction` with only the given parameters."""
    inertia = joints.inertia(change.machine, joint)
    neutral = {"sigma_0": inertia * _BRISTLE**2, "sigma_1": inertia * _BRISTLE}
    joints.insert_on_joint(change, FRICTION, f"{joint}_{effect}", joint, neutral, values)


@register_effect
class JointCoulombFriction(FrictionEffect):
    """Dry friction that differs from the model: less MuJoCo friction loss, or an added bristle.

    MuJoCo's friction loss yields over the time `solreffriction`, 20 ms by default, so that it does
    not hold against a strong drive. A LuGre bristle holds and therefore models added friction.
    """

    name = "coulomb_friction"
    physics = "F_c sgn(v); at rest it holds up to F_c."
    source = "Armstrong-Helouvry et al. 1994"
    excitation = "slow motion in both directions, and rest"
    rows = (SizedRow("coulomb", "{force}", (0.01, 0.08), upper=1.0, field="frictionloss"),)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Sets MuJoCo's friction loss, and inserts joint friction for additional friction."""
        own = joints.native(change.machine, element, "frictionloss")
        super().apply(change, element, {"coulomb": min(own, values["coulomb"])})
        if (more := values["coulomb"] - own) > 0.0:
            insert_friction(change, element, self.name, {"coulomb": more, "static": more})

    def write(self, change: Change, element: str, values: Values) -> None:
        """Sets MuJoCo's friction loss; if increased, also a fast and hard constraint for it."""
        super().apply(change, element, values)
        if values["coulomb"] > joints.native(change.machine, element, "frictionloss"):

            def edit(spec: mujoco.MjSpec) -> None:
                spec.joint(element).solref_friction = [2.0 * spec.option.timestep, 1.0]
                spec.joint(element).solimp_friction[:2] = _HOLDS

            change.edit(("solref_friction", element), edit)


def _stribeck_velocity(machine: Machine, joint: str) -> EffectParameter:
    limits = (0.05, 0.005, 1.0) if machine.unit(joint) == "rad" else (0.01, 0.001, 0.2)
    unit = joints.joint_unit(machine, joint, "{length}/s")
    return EffectParameter.shape("stribeck_velocity", unit, *limits)


@register_effect
class JointStiction(FrictionEffect):
    """Breakaway friction above the Coulomb friction of a joint."""

    name = "stiction"
    physics = "(F_s - F_c) exp(-|v/v_s|^n) sgn(v), LuGre bristle before sliding."
    source = "Canudas de Wit et al. 1995; n by Armstrong-Helouvry et al. 1994, sect. 2.1.3"
    excitation = "slow motion, reversals and rest"
    rows = (
        SizedRow("breakaway", "{force}", (0.02, 0.1), upper=1.0),
        _stribeck_velocity,
        EffectParameter.shape("stribeck_exponent", "1", 2.0, 0.5, 4.0),
    )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Inserts joint friction with only a breakaway level."""
        if values["breakaway"]:
            shape = {k: v for k, v in values.items() if k.startswith("stribeck")}
            insert_friction(change, element, self.name, {"static": values["breakaway"], **shape})


@register_effect
class LoadDependentFriction(JointEffect):
    """Friction that grows with the load that the joint carries."""

    name = "load_dependent_friction"
    group = "friction"
    physics = "|k_a F_actuator + k_b F_bias| sgn(v): gears and bearings under load."
    source = "Duclusaud et al. 2025 (BAM, model M3); worm and harmonic gears: 0.02 to 0.4"
    excitation = "motion under loads of different size; a load without motion shows nothing"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the joints that an actuator or gravity loads."""
        return tuple(joint for joint in machine.joints if _loads(machine, joint))

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Returns friction per unit of actuator force and of gravity (with Coriolis forces)."""
        loads = _loads(machine, element)
        return tuple(EffectParameter(n, "1", upper=1.0, trials=(0.03, 0.15)) for n in loads)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Inserts joint friction with only load coefficients."""
        if any(values.values()):
            shares = {f"{load}_load_coefficient": share for load, share in values.items()}
            insert_friction(change, element, self.name, shares)


def _loads(machine: Machine, joint: str) -> tuple[str, ...]:
    """Returns the loads that a joint has: "actuator", "bias" (gravity), both or none."""
    driven = any(joint in moved for moved in machine.driven.values())
    heavy = joints.gravity(machine, joint) > 0.01 * joints.inertia(machine, joint)
    return ("actuator",) * driven + ("bias",) * heavy


def _viscous(name: str) -> Row:
    """Returns the parameter of added viscous friction, at least -80 % of the drive's damping."""
    row = SizedRow(name, "{force} s/{length}", (0.02, 0.1), upper=10.0)
    return lambda machine, joint: replace(
        row(machine, joint), lower=-0.8 * joints.drive_damping(machine, joint)
    )


@register_effect
class AsymmetricFriction(JointEffect):
    """Friction that differs by direction."""

    name = "asymmetric_friction"
    group = "friction"
    physics = "(F_1 + b_1 |v|) for v > 0, (F_2 + b_2 |v|) for v < 0, against the motion."
    source = "Armstrong-Helouvry et al. 1994: one-sided seals and preloaded gears"
    excitation = "motion in both directions at several speeds; reversals"
    # It contains friction of cylinder seals, which acts like the joint's at a constant lever.
    contains = ("viscous_friction", "coulomb_friction", "asymmetric_friction")
    by_direction = (
        ("viscous_forward", "viscous_backward"),
        ("coulomb_forward", "coulomb_backward"),
    )
    rows = (
        _viscous("viscous_forward"),
        _viscous("viscous_backward"),
        SizedRow("coulomb_forward", "{force}", (0.01, 0.05), upper=1.0),
        SizedRow("coulomb_backward", "{force}", (0.01, 0.05), upper=1.0),
    )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Inserts joint friction with mean and difference of the two directions."""
        if any(values.values()):
            found = joints.mean_and_difference(self.by_direction, values)
            insert_friction(change, element, self.name, {**found, "static": found["coulomb"]})
