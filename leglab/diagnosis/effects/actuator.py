"""Force of actuators: a gain of native ones, a constant force on any joint."""

import mujoco

from leglab.diagnosis.effects.base import EffectParameter, TableEffect, Values, register_effect
from leglab.diagnosis.effects.joints import JointEffect, JointRow
from leglab.diagnosis.effects.spring import insert_spring
from leglab.diagnosis.plant.model import Change, Machine

_LINEAR_GAINS = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))
_LINEAR_BIASES = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))


@register_effect
class ActuatorGain(TableEffect):
    """An actuator that is stronger or weaker than the model says."""

    name = "actuator_gain"
    group = "sensing"
    physics = "gain x force: torque constant, gear efficiency, current calibration."
    source = "torque constants of servo motors: 2 % between good ones, 10 % on data sheets"
    excitation = "forces of different size"
    rows = (
        EffectParameter(
            "gain",
            "1",
            nominal=1.0,
            lower=0.05,
            upper=5.0,
            trials=(0.5, 0.9, 0.98, 1.02, 1.1, 1.5),
            tolerance=0.02,
        ),
    )

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Native actuators with fixed or affine gain and bias."""
        actuators = {name: machine.base.model.actuator(name) for name in machine.native_actuators()}
        return tuple(
            name
            for name, actuator in actuators.items()
            if actuator.gaintype[0] in _LINEAR_GAINS and actuator.biastype[0] in _LINEAR_BIASES
        )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Scales gain and bias of the actuator."""
        gain = values["gain"]

        def edit(spec: mujoco.MjSpec) -> None:
            actuator = spec.actuator(element)
            actuator.gainprm = actuator.gainprm * gain
            actuator.biasprm = actuator.biasprm * gain

        if gain != 1.0:
            change.edit(("actuator_gain", element, gain), edit)


@register_effect
class ForceOffset(JointEffect):
    """A constant force on a joint: a cable, a counterweight, a current offset."""

    name = "force_offset"
    group = "sensing"
    physics = "constant generalised force"
    source = "offset of a torque loop, pull of a cable or hose"
    excitation = "any motion; rest under little friction"
    rows = (JointRow("force", "{force}", (-0.1, -0.02, 0.02, 0.1), lower=-2.0, upper=2.0),)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Inserts a spring-damper that has nothing but the constant force."""
        if values["force"]:
            insert_spring(change, element, "force", {"force_offset": values["force"]})
