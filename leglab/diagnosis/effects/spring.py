"""Springs and dampers beside a joint: a spring-damper element, or MuJoCo's own."""

import math
from collections.abc import Mapping

import mujoco

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import Effect, EffectParameter, register
from leglab.diagnosis.model import Change, Machine

# Good springs differ by 2 to 3 % (DIN 2095 grade 2: 5 % of the load at a given length).
_TOLERANCE = 0.025


def _native_stiffness(machine: Machine, joint: str) -> float:
    model = machine.base.model
    return float(model.jnt_stiffness[model.joint(joint).id])


def _spring_reference(machine: Machine, joint: str) -> float:
    model = machine.base.model
    return float(model.qpos_spring[model.joint(joint).qposadr[0]])


def _has_spring(machine: Machine, joint: str) -> bool:
    spring = machine.spring_of(joint)
    stiff = spring is not None and machine.parameter(spring, "k1") > 0
    return stiff or _native_stiffness(machine, joint) > 0


def insert_spring(change: Change, joint: str, kind: str) -> str:
    """Inserts a neutral spring-damper for one effect and returns its name."""
    name = f"{joint}_{kind}"
    reference = {"rest_position": _spring_reference(change.machine, joint)}
    joints.insert_on_joint(change, joints.SPRING, name, joint, reference)
    return name


@register
class SpringStiffness(Effect):
    """A spring that has tired or was exchanged, or one that the model lacks."""

    name = "spring_stiffness"
    group = "mechanics"
    physics = "-k (q - q_0); with a spring-damper element its k1."
    source = "Hooke; tolerance of coil springs DIN 2095 grade 2"
    excitation = "positions over a range"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """All joints."""
        return machine.joints

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The stiffness."""
        spring = machine.spring_of(element)
        own = machine.parameter(spring, "k1") if spring else _native_stiffness(machine, element)
        size = joints.force_scale(machine, element)
        return (
            EffectParameter(
                name="stiffness",
                unit=f"{joints.force_unit(machine, element)}/{joints.unit(machine, element)}",
                nominal=own,
                lower=0.0,
                upper=4.0 * own + 20.0 * size,
                trials=(0.5 * own, 0.85 * own, 1.3 * own) if own > 0 else (0.05 * size, 0.5 * size),
                tolerance=_TOLERANCE * own,
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Sets k1, or the joint's own stiffness."""
        stiffness, spring = values["stiffness"], change.machine.spring_of(element)
        if spring:
            difference = stiffness - change.machine.parameter(spring, "k1")
            change.add_parameter(spring, "k1", difference)
        elif stiffness != _native_stiffness(change.machine, element):

            def edit(spec: mujoco.MjSpec) -> None:
                spec.joint(element).stiffness[0] = stiffness

            change.edit(("stiffness", element, stiffness), edit)


@register
class SpringHardening(Effect):
    """A spring that stiffens with its deflection."""

    name = "spring_hardening"
    group = "mechanics"
    physics = "-k3 y^3 (Duffing), with a spring-damper element -k2 y^3 sin^2 y; y = q - q_0."
    source = "Duffing 1918; Folgheraiter, Eq. 23"
    excitation = "large positions on both sides of the rest position"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """All joints."""
        return machine.joints

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The coefficient of the cubic part."""
        spring = machine.spring_of(element)
        own = machine.parameter(spring, "k2") if spring else 0.0
        size = joints.force_scale(machine, element)
        if joints.unit(machine, element) == "m":
            size *= 100.0  # a slide moves some decimetres
        trials = (0.0, 2.0 * own, 4.0 * own) if own > 0 else (0.2 * size, 2.0 * size)
        return (
            EffectParameter(
                name="k2" if spring else "k3",
                unit=f"{joints.force_unit(machine, element)}/{joints.unit(machine, element)}^3",
                nominal=own,
                lower=min(0.0, own) - (0.0 if own else 5.0 * size),
                upper=10.0 * own + 50.0 * size,
                trials=trials,
                tolerance=2.0 * _TOLERANCE * abs(own),
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Sets k2 of the element that is there, or k3 of a new one."""
        spring = change.machine.spring_of(element)
        if spring:
            own = change.machine.parameter(spring, "k2")
            change.add_parameter(spring, "k2", values["k2"] - own)
        elif values["k3"]:
            change.set_parameter(insert_spring(change, element, "hardening"), "k3", values["k3"])


@register
class SpringOffset(Effect):
    """A spring that rests elsewhere: mounted wrongly, set, or slipped."""

    name = "spring_offset"
    group = "mechanics"
    physics = "-k (q - q_0 - shift)"
    source = "mounting and set of coil springs, some per cent of their travel"
    excitation = "positions over a range, so that it differs from a constant force"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Joints with a spring."""
        return tuple(joint for joint in machine.joints if _has_spring(machine, joint))

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The shift of the rest position."""
        travel = 1.0 if joints.unit(machine, element) == "rad" else 0.2
        return (
            EffectParameter(
                name="shift",
                unit=joints.unit(machine, element),
                nominal=0.0,
                lower=-travel,
                upper=travel,
                trials=tuple(share * travel for share in (-0.2, -0.04, 0.04, 0.2)),
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Shifts the element's rest position, or the joint's spring reference."""
        shift, spring = values["shift"], change.machine.spring_of(element)
        if shift == 0.0:
            return
        if spring and change.machine.parameter(spring, "k1") > 0:
            change.add_parameter(spring, "rest_position", shift)
            return
        hinge = joints.unit(change.machine, element) == "rad"

        def edit(spec: mujoco.MjSpec) -> None:
            degrees = hinge and spec.compiler.degree
            spec.joint(element).springref += math.degrees(shift) if degrees else shift

        change.edit(("springref", element, shift), edit)


@register
class QuadraticDamping(Effect):
    """A damper whose force grows with the speed squared."""

    name = "quadratic_damping"
    group = "mechanics"
    physics = "-d |v| v: orifice dampers, drag."
    source = "turbulent flow (Bernoulli); Folgheraiter's damper, physics.md"
    excitation = "slow and fast motion, which tell it from viscous friction"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """All joints."""
        return machine.joints

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The coefficient."""
        spring = machine.spring_of(element)
        own = machine.parameter(spring, "quadratic_damping") if spring else 0.0
        size = joints.force_scale(machine, element)
        if joints.unit(machine, element) == "m":
            size *= 10.0  # a slide moves some decimetres a second
        return (
            EffectParameter(
                name="damping",
                unit=f"{joints.force_unit(machine, element)} s^2/{joints.unit(machine, element)}^2",
                nominal=own,
                lower=0.0,
                upper=own + 10.0 * size,
                trials=(own + 0.01 * size, own + 0.06 * size, own + 0.3 * size),
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Sets the parameter of the element that is there, or of a new one."""
        spring = change.machine.spring_of(element)
        if spring:
            own = change.machine.parameter(spring, "quadratic_damping")
            change.add_parameter(spring, "quadratic_damping", values["damping"] - own)
        elif values["damping"]:
            name = insert_spring(change, element, "quadratic_damper")
            change.set_parameter(name, "quadratic_damping", values["damping"])
