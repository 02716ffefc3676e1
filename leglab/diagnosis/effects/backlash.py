"""Play and flexibility between the drive and a joint."""

import math
from collections.abc import Callable

import mujoco
import numpy as np
from scipy.signal import bilinear, lfilter, lfilter_zi

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import EffectParameter, TableEffect, Values, register_effect
from leglab.diagnosis.effects.joints import SizedRow
from leglab.diagnosis.plant.model import Change, Machine, Measured, Variant

_BACKLASH = "leglab.backlash"
_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_BIASES = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
# Natural frequency [Hz] of a motor on the gear flank that it touches: rigid for any recording.
_FLANK_HZ = 500.0
# Motor inertia as a share of the joint's inertia, if the model has no armature.
_MOTOR_SHARE = 0.1
# Negligible play width [rad or m], for a play with elastic flanks that represents a flexibility.
_NO_PLAY = 1e-9
# Trial values and lower bound [Hz] of a joint's natural frequency on its spring, motor fixed.
_TRIALS_HZ, _SOFTEST_HZ = (30.0, 12.0), 1.5
# Time before a window in which the motor's motion in the play is simulated.
_HISTORY = 0.4  # s


def _motor_inertia(machine: Machine, joint: str) -> EffectParameter:
    own = joints.native(machine, joint, "armature")
    motor = own or _MOTOR_SHARE * joints.inertia(machine, joint)
    unit = joints.joint_unit(machine, joint, "{inertia}")
    return EffectParameter.shape("motor_inertia", unit, motor, 0.1 * motor, own or 10.0 * motor)


def _compliance(machine: Machine, joint: str) -> EffectParameter:
    own, unit = (
        joints.inertia(machine, joint),
        joints.joint_unit(machine, joint, "{length}/({force})"),
    )
    softness = [1.0 / (own * (2.0 * math.pi * f) ** 2) for f in (*_TRIALS_HZ, _SOFTEST_HZ)]
    return EffectParameter("compliance", unit, upper=softness[-1], trials=tuple(softness[:-1]))


class DriveEffect(TableEffect):
    """Base of the effects between a motor and its joint."""

    gradual = False
    group = "mechanics"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns the joints with native motor, position or velocity actuators."""
        model = machine.base.model
        return tuple(
            joint
            for joint in machine.joints
            if (drives := _drives(model, joint)) and all(_followed(model, i) for i in drives)
        )


@register_effect
class Backlash(DriveEffect):
    """Gear play, within which motor and joint move independently."""

    name = "backlash"
    physics = "J w' = tau - T; the flanks transmit T only when the play is used up."
    source = "Nordin and Gutman 2002; gears 1 to 20 mrad, worn ones more"
    excitation = "torque that changes its sign, reversals under small load"
    rows = (
        SizedRow("width", "{length}", (0.004, 0.02, 0.08), upper=0.5, size=joints.on_slide(0.1)),
        _motor_inertia,
    )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Inserts a play whose states at window starts follow from the measured motion."""
        width, motor = values["width"], values["motor_inertia"]
        if width == 0.0:
            return

        def states(measured: Measured, variant: Variant) -> tuple[np.ndarray, np.ndarray]:
            return motor_states(measured, variant.model, element, width, motor)

        play = {**values, "stiffness": motor * (2.0 * math.pi * _FLANK_HZ) ** 2}
        insert_play(change, f"{element}_backlash", element, play, states)


@register_effect
class JointFlexibility(DriveEffect):
    """A soft gear, belt, coupling or shaft: a spring and damper between motor and joint."""

    name = "joint_flexibility"
    physics = "J w' = tau - T, T = k (theta - q) + c (w - v); the joint feels T."
    source = "Spong 1987; harmonic drives and belts: 1e3 to 1e5 N m/rad"
    excitation = "torques that change quickly, fast reversals"
    rows = (
        _compliance,
        _motor_inertia,
        EffectParameter.shape("damping_ratio", "1", 0.1, 0.005, 2.0),
    )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Inserts the spring; its twist at window starts follows from the motor's dynamics."""
        compliance, motor = values["compliance"], values["motor_inertia"]
        if compliance == 0.0:
            return
        own = joints.native(change.machine, element, "armature")
        link = max(joints.inertia(change.machine, element) - own, 1e-9)
        reduced = 1.0 / (1.0 / motor + 1.0 / link)
        damping = 2.0 * values["damping_ratio"] * math.sqrt(reduced / compliance)

        def twist(measured: Measured, variant: Variant) -> tuple[np.ndarray, np.ndarray]:
            h, velocity = measured.period, measured.velocity[element]
            acceleration = np.gradient(velocity, h)
            every, zero = np.arange(velocity.size), np.zeros(velocity.size)
            torque = drive_torque(measured, variant.model, element)(every, zero, zero)
            # The twist o obeys J o'' + c o' + k o = tau - J q'' with the measured q. The filter
            # computes k o, with a gain of 1, since a filter for o has a gain as small as 1/k.
            excess = torque - motor * acceleration
            under = [motor * compliance, damping * compliance, 1.0]
            over, under = bilinear([1.0], under, 1.0 / h)
            start = lfilter_zi(over, under) * excess[0]
            offset = compliance * lfilter(over, under, excess, zi=start)[0]
            lag = 0.5 * variant.model.opt.timestep
            speed = velocity - lag * acceleration + np.gradient(offset, h)
            return offset[measured.samples], speed[measured.samples]

        play = {"width": _NO_PLAY, "motor_inertia": motor, "stiffness": 1.0 / compliance}
        play["damping_ratio"] = values["damping_ratio"]
        insert_play(change, f"{element}_flexibility", element, play, twist)


# Computes a motor's position in its play and its velocity at window starts, both (windows,).
MotorStates = Callable[[Measured, Variant], tuple[np.ndarray, np.ndarray]]


def insert_play(change: Change, name: str, joint: str, values: Values, states: MotorStates) -> None:
    """Inserts a play between motor and joint; `states` is called once for each recording."""
    joints.insert_on_joint(change, _BACKLASH, name, joint, {"motor_inertia": 1.0}, values)
    latest: list[tuple[Measured, tuple[np.ndarray, np.ndarray]]] = []

    def state(measured: Measured, variant: Variant, index: int) -> np.ndarray:
        if not latest or latest[0][0] is not measured:
            latest[:] = [(measured, states(measured, variant))]
        return latest[0][1][index]

    change.start(name, "offset", lambda m, variant, _: state(m, variant, 0))
    change.start(name, "motor_velocity", lambda m, variant, _: state(m, variant, 1))
    change.start(name, "seated_width", lambda m, *_: np.full(m.samples.size, values["width"]))


def motor_states(
    measured: Measured, model: mujoco.MjModel, joint: str, width: float, inertia: float
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the motor's position in the play and its velocity at window starts, (windows,).

    The joint moves as measured; the motor, of inertia `inertia`, moves by its torque between rigid
    flanks.
    """
    h, half = measured.period, 0.5 * width
    velocity = measured.velocity[joint]
    acceleration = np.gradient(velocity, h)
    index = (measured.samples[:, None] + np.arange(-round(_HISTORY / h), 1)).clip(0)
    torque = drive_torque(measured, model, joint)
    k, zero = index[:, 0], np.zeros(index.shape[0])
    # The motor begins on the flank that a rigid gear would load.
    offset = half * np.sign(torque(k, zero, zero) - inertia * acceleration[k])
    slip = zero  # motor velocity less the joint's
    for column in range(index.shape[1] - 1):
        k, after = index[:, column], index[:, column + 1]
        pushed = torque(k, offset, slip) * (h / inertia) - (velocity[after] - velocity[k])
        moved = offset + h * (slip + 0.5 * pushed)
        offset = np.clip(moved, -half, half)
        # A motor that reaches a flank takes on the joint's velocity at once.
        slip = np.where(moved == offset, slip + pushed, 0.0)
    k = index[:, -1]
    # MuJoCo's velocities lag its positions by half a time step.
    free = torque(k, offset, slip) / inertia - acceleration[k]
    lag = np.where(np.abs(offset) < half, 0.5 * model.opt.timestep * free, 0.0)
    return offset, velocity[k] - 0.5 * model.opt.timestep * acceleration[k] + slip - lag


# Torque by sample indices, and by position and speed of the motor minus the joint's; all (k,).
Torque = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def drive_torque(measured: Measured, model: mujoco.MjModel, joint: str) -> Torque:
    """Returns a joint's drive torque along a recording, with activations in the steady state."""
    q, v, drives = measured.position[joint], measured.velocity[joint], _drives(model, joint)
    command = np.stack([measured.command[model.actuator(i).name] for i in drives])
    # Each (drives, 1), for samples along the second axis.
    gear, gain = model.actuator_gear[drives, :1], model.actuator_gainprm[drives, :1]
    level, stiffness, damping = model.actuator_biasprm[drives, :3].T[:, :, None]
    limited = model.actuator_forcelimited[drives, None] != 0
    limits = np.where(limited, model.actuator_forcerange[drives], (-np.inf, np.inf))

    def torque(k: np.ndarray, offset: np.ndarray, slip: np.ndarray) -> np.ndarray:
        turned = stiffness * (q[k] + offset) + damping * (v[k] + slip)
        force = gain * command[:, k] + level + gear * turned
        return np.sum(gear * np.clip(force, limits[:, :1], limits[:, 1:]), axis=0)

    return torque


def _drives(model: mujoco.MjModel, joint: str) -> list[int]:
    """Returns the actuators of a joint."""
    on_joint = np.isin(model.actuator_trntype, _JOINT)
    return np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == model.joint(joint).id)).tolist()


def _followed(model: mujoco.MjModel, i: int) -> bool:
    """Tests whether `drive_torque` can compute the force of an actuator."""
    return (
        model.actuator_plugin[i] < 0
        and model.actuator_gaintype[i] == int(mujoco.mjtGain.mjGAIN_FIXED)
        and model.actuator_biastype[i] in _BIASES
        and model.actuator_dyntype[i] <= int(mujoco.mjtDyn.mjDYN_FILTEREXACT)
        and not model.actuator_actearly[i]
        and model.actuator_history[i, 0] == 0
    )
