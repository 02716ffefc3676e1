"""Springs, dampers and forces on a joint, by a spring-damper element or MuJoCo's attributes."""

import math

import mujoco

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import EffectParameter, Values, register_effect
from leglab.diagnosis.effects.joints import JointEffect, SizedRow
from leglab.diagnosis.plant.model import SPRING, Change, Machine

# Good springs differ by 2 to 3 % (DIN 2095 grade 2: 5 % of the load at a given length).
_TOLERANCE = 0.025


def _of_spring(machine: Machine, joint: str, parameter: str) -> float:
    """Returns a parameter of a joint's spring-damper element; 0 without such an element."""
    spring = machine.spring_of(joint)
    return machine.parameter(spring, parameter) if spring else 0.0


def rest_position(machine: Machine, joint: str) -> float:
    """Returns the rest position of a joint's spring, or of a spring to be added [rad or m]."""
    if spring := machine.spring_of(joint):
        return machine.parameter(spring, "rest_position")
    model = machine.base.model
    return float(model.qpos_spring[model.joint(joint).qposadr[0]])


def _size(machine: Machine, joint: str, slide: float) -> float:
    """Returns the force scale, for slides times `slide`, as they move decimetres, not radians."""
    return joints.force_scale(machine, joint) * joints.on_slide(slide)(machine, joint)


def set_spring(change: Change, joint: str, effect: str, parameter: str, value: float) -> None:
    """Shifts a joint's spring-damper parameter to a value; inserts the element if missing."""
    machine = change.machine
    if spring := machine.spring_of(joint):
        change.add_parameter(spring, parameter, value - machine.parameter(spring, parameter))
    elif value:
        insert_spring(change, joint, effect, {parameter: value})


def insert_spring(change: Change, joint: str, effect: str, values: Values) -> None:
    """Inserts a spring-damper with only the given parameters."""
    reference = {"rest_position": rest_position(change.machine, joint)}
    joints.insert_on_joint(change, SPRING, f"{joint}_{effect}", joint, reference, values)


@register_effect
class SpringStiffness(JointEffect):
    """A weakened or exchanged spring, or one that the model lacks."""

    name = "spring_stiffness"
    physics = "-k (q - q_0); with a spring-damper element its k1."
    source = "Hooke; tolerance of coil springs DIN 2095 grade 2"
    excitation = "positions over a range"

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Returns the stiffness."""
        spring = machine.spring_of(element)
        native = joints.native(machine, element, "stiffness")
        own = machine.parameter(spring, "k1") if spring else native
        size = joints.force_scale(machine, element)
        return (
            EffectParameter(
                "stiffness",
                joints.joint_unit(machine, element, "{force}/{length}"),
                nominal=own,
                upper=4.0 * own + 20.0 * size,
                trials=(0.5 * own, 0.85 * own, 1.3 * own) if own > 0 else (0.05 * size, 0.5 * size),
                tolerance=_TOLERANCE * own,
            ),
        )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Sets k1 of the joint's spring-damper, or MuJoCo's stiffness of the joint."""
        if change.machine.spring_of(element):
            set_spring(change, element, self.name, "k1", values["stiffness"])
        else:
            joints.set_native(change, element, "stiffness", values["stiffness"])


@register_effect
class SpringHardening(JointEffect):
    """A spring that stiffens with its deflection."""

    name = "spring_hardening"
    physics = "-k3 y^3 (Duffing), with a spring-damper element -k2 y^3 sin^2 y; y = q - q_0."
    source = "Duffing 1918; Folgheraiter, Eq. 23"
    excitation = "large positions on both sides of the rest position"

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Returns the cubic coefficient: k2 of an existing element, or k3 of a new one."""
        own = _of_spring(machine, element, "k2")
        size = _size(machine, element, 100.0)
        return (
            EffectParameter(
                "k2" if machine.spring_of(element) else "k3",
                joints.joint_unit(machine, element, "{force}/{length}^3"),
                nominal=own,
                lower=min(0.0, own) - (0.0 if own else 5.0 * size),
                upper=10.0 * own + 50.0 * size,
                trials=(0.0, 2.0 * own, 4.0 * own) if own > 0 else (0.2 * size, 2.0 * size),
                tolerance=2.0 * _TOLERANCE * abs(own),
            ),
        )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Sets k2 of an existing element, or k3 of a new one."""
        ((parameter, value),) = values.items()
        set_spring(change, element, "hardening", parameter, value)


@register_effect
class SpringOffset(JointEffect):
    """A spring whose rest position has changed: mounted wrongly, set, or slipped."""

    name = "spring_offset"
    physics = "-k (q - q_0 - shift)"
    source = "mounting and set of coil springs, some per cent of their travel"
    excitation = "positions over a range, so that it differs from a constant force"
    rows = (
        SizedRow(
            "shift", "{length}", (-0.2, -0.04, 0.04, 0.2), lower=-1.0, upper=1.0, size=joints.travel
        ),
    )

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the joints with a spring."""
        return tuple(
            joint
            for joint in machine.joints
            if _of_spring(machine, joint, "k1") > 0
            or joints.native(machine, joint, "stiffness") > 0
        )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Shifts the element's rest position, or the joint's spring reference."""
        shift, spring = values["shift"], change.machine.spring_of(element)
        if shift == 0.0:
            return
        if spring and change.machine.parameter(spring, "k1") > 0:
            change.add_parameter(spring, "rest_position", shift)
            return
        hinge = change.machine.unit(element) == "rad"

        def edit(spec: mujoco.MjSpec) -> None:
            degrees = hinge and spec.compiler.degree
            spec.joint(element).springref += math.degrees(shift) if degrees else shift

        change.edit(("springref", element, shift), edit)


@register_effect
class QuadraticDamping(JointEffect):
    """A damper whose force grows with the speed squared."""

    name = "quadratic_damping"
    physics = "-d |v| v: orifice dampers, drag."
    source = "turbulent flow (Bernoulli); Folgheraiter's damper, docs/concepts/physics.md"
    excitation = "slow and fast motion, which tell it from viscous friction"
    rows = (
        SizedRow(
            "damping",
            "{force} s^2/{length}^2",
            (0.01, 0.06, 0.3),
            upper=10.0,
            size=lambda machine, joint: _size(machine, joint, 10.0),
            own=lambda machine, joint: _of_spring(machine, joint, "quadratic_damping"),
        ),
    )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Sets the coefficient of an existing element, or of a new one."""
        set_spring(change, element, "quadratic_damper", "quadratic_damping", values["damping"])


@register_effect
class ForceOffset(JointEffect):
    """A constant force on a joint: a cable, a counterweight, a current offset."""

    name = "force_offset"
    group = "sensing"
    physics = "constant generalised force"
    source = "offset of a torque loop, pull of a cable or hose"
    excitation = "any motion; rest under little friction"
    rows = (SizedRow("force", "{force}", (-0.1, -0.02, 0.02, 0.1), lower=-2.0, upper=2.0),)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Inserts a spring-damper with only the constant force."""
        if values["force"]:
            insert_spring(change, element, "force", {"force_offset": values["force"]})
