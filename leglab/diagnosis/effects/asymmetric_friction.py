"""Friction of a joint that differs by direction."""

from collections.abc import Mapping

from leglab.diagnosis.change import Change
from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import Effect, EffectParameter, register
from leglab.diagnosis.effects.load_friction import start_from_motion
from leglab.diagnosis.machine import FRICTION, Machine


@register
class AsymmetricFriction(Effect):
    """Friction that differs by direction."""

    name = "asymmetric_friction"
    group = "friction"
    physics = "(F_1 + b_1 |v|) for v > 0, (F_2 + b_2 |v|) for v < 0, against the motion."
    source = "Armstrong-Helouvry et al. 1994: one-sided seals and preloaded gears"
    excitation = "motion in both directions at several speeds; reversals"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """All joints."""
        return machine.joints

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Added friction of each direction."""
        size = joints.force_scale(machine, element)
        force, length = joints.force_unit(machine, element), joints.unit(machine, element)
        least = -0.8 * joints.drive_damping(machine, element)
        viscous = [
            EffectParameter(
                name=f"viscous_{side}",
                unit=f"{force} s/{length}",
                nominal=0.0,
                lower=least,
                upper=10.0 * size,
                trials=(0.1 * size,),
            )
            for side in ("forward", "backward")
        ]
        coulomb = [
            EffectParameter(
                name=f"coulomb_{side}",
                unit=force,
                nominal=0.0,
                lower=0.0,
                upper=size,
                trials=(0.05 * size,),
            )
            for side in ("forward", "backward")
        ]
        return (*viscous, *coulomb)

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Inserts joint friction with a mean and a difference."""
        if not any(values.values()):
            return
        name = f"{element}_asymmetric_friction"
        bristle = joints.bristle(change.machine, element)
        joints.insert_on_joint(change, FRICTION, name, element, bristle)
        for kind in ("viscous", "coulomb"):
            forward, backward = values[f"{kind}_forward"], values[f"{kind}_backward"]
            change.set_parameter(name, kind, 0.5 * (forward + backward))
            change.set_parameter(name, f"{kind}_difference", forward - backward)
        change.set_parameter(name, "static", change.parameter(name, "coulomb"))
        start_from_motion(change, name, element)
