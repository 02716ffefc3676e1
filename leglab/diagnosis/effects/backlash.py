"""Play between the drive and a joint."""

from collections.abc import Mapping

import mujoco

from leglab.diagnosis.change import Change
from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import Effect, EffectParameter, register
from leglab.diagnosis.machine import Machine

BACKLASH = "leglab.backlash"
_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_BIASES = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
# A flank in contact swings at this frequency with the motor alone: rigid against a recording.
_FLANK_HZ = 500.0
# Share of a joint's inertia that a motor has where the model says nothing about it.
_MOTOR_SHARE = 0.1


@register
class Backlash(Effect):
    """Gear play: within it motor and joint move apart."""

    name = "backlash"
    group = "mechanics"
    physics = "J w' = tau - T; the flanks transmit T only when the play is used up."
    source = "Nordin and Gutman 2002; gears 1 to 20 mrad, worn ones more"
    excitation = "torque that changes its sign, reversals under small load"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Joints with native motor, position or velocity actuators."""
        model = machine.base.model
        found = []
        for joint in machine.joints:
            drives = [
                i
                for i in range(model.nu)
                if model.actuator_trntype[i] in _JOINT
                and model.actuator_trnid[i, 0] == model.joint(joint).id
            ]
            if drives and all(_followed(model, i) for i in drives):
                found.append(joint)
        return tuple(found)

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Width of the play and inertia of the motor."""
        small = 1.0 if joints.unit(machine, element) == "rad" else 0.1
        own = float(machine.base.model.dof_armature[joints.dof(machine, element)])
        motor = own or _MOTOR_SHARE * joints.inertia(machine, element)
        return (
            EffectParameter(
                name="width",
                unit=joints.unit(machine, element),
                nominal=0.0,
                lower=0.0,
                upper=0.5 * small,
                trials=(0.004 * small, 0.02 * small, 0.08 * small),
            ),
            EffectParameter(
                name="motor_inertia",
                unit="kg m^2" if joints.unit(machine, element) == "rad" else "kg",
                nominal=motor,
                lower=0.1 * motor,
                upper=own or 10.0 * motor,
                role="shape",
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Inserts a play; its motor starts every window on the flank that the load presses."""
        if values["width"] == 0.0:
            return
        name = f"{element}_backlash"
        motor = values["motor_inertia"]
        rate = 2.0 * 3.141592653589793 * _FLANK_HZ
        joints.insert_on_joint(change, BACKLASH, name, element, {"motor_inertia": 1.0})
        change.set_parameter(name, "width", values["width"])
        change.set_parameter(name, "motor_inertia", motor)
        change.set_parameter(name, "stiffness", motor * rate**2)


def _followed(model: mujoco.MjModel, i: int) -> bool:
    return (
        model.actuator_plugin[i] < 0
        and model.actuator_gaintype[i] == int(mujoco.mjtGain.mjGAIN_FIXED)
        and model.actuator_biastype[i] in _BIASES
        and model.actuator_dyntype[i] <= int(mujoco.mjtDyn.mjDYN_FILTEREXACT)
        and not model.actuator_actearly[i]
        and model.actuator_history[i, 0] == 0
    )
