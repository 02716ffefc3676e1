"""Gains of position servos."""

import mujoco
import numpy as np

from leglab.diagnosis.effects.base import EffectParameter, TableEffect, Values, register_effect
from leglab.diagnosis.effects.command import natives, position_servos
from leglab.diagnosis.plant.model import Change, Machine


@register_effect
class ServoStiffness(TableEffect):
    """A position servo is stiffer or softer than in the model, with another damping.

    Two special cases have other names because they give the same motion: a change of damping alone
    is `viscous_friction`, a change of stiffness of a servo without damping is `actuator_gain`.
    """

    name = "servo_stiffness"
    group = "valve and command"
    physics = (
        "s kp e - s^n kv q': stiffness and damping are those of the model times s and s^n; n is 0 "
        "where damping stays, 1/2 where its ratio does, 1 of a weak drive."
    )
    source = "gains of servos as users set them; MuJoCo's gainprm and biasprm"
    excitation = "position errors under load, and motion that decays"
    contains = ("actuator_gain",)
    rows = (
        # The deflection of a servo under a load is proportional to 1/s.
        EffectParameter(
            "stiffness",
            "1",
            nominal=1.0,
            lower=0.05,
            upper=20.0,
            trials=(0.3, 0.7, 0.95, 1.05, 1.5, 4.0),
            inverse=True,
        ),
        EffectParameter.shape("damping_exponent", "1", 0.0, -2.0, 3.0),
    )

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the position servos with damping."""
        servos = position_servos(machine)
        return natives(machine, lambda a: a.name in servos and a.biasprm[2] != 0.0)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Scales gain and bias of the actuator."""
        stiffness = values["stiffness"]
        damping = stiffness ** values["damping_exponent"]

        def edit(spec: mujoco.MjSpec) -> None:
            actuator = spec.actuator(element)
            actuator.gainprm = actuator.gainprm * stiffness
            factors = np.ones_like(actuator.biasprm)
            factors[1:3] = stiffness, damping
            actuator.biasprm = actuator.biasprm * factors

        if stiffness != 1.0:
            change.edit((self.name, element, stiffness, damping), edit)
