"""Play between the drive and a joint."""

import math
from collections.abc import Callable

import mujoco
import numpy as np

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import Effect, EffectParameter, Values, register_effect
from leglab.diagnosis.plant.model import Change, Machine, Measured, Variant

_BACKLASH = "leglab.backlash"
_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_BIASES = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
# A flank in contact swings at this frequency with the motor alone: rigid against a recording.
_FLANK_HZ = 500.0
# Share of a joint's inertia that a motor has where the model says nothing about it.
_MOTOR_SHARE = 0.1
# The motor is followed through the play from this long before a window.
_HISTORY = 0.4  # s


@register_effect
class Backlash(Effect):
    """Gear play: within it motor and joint move apart."""

    name = "backlash"
    gradual = False
    group = "mechanics"
    physics = "J w' = tau - T; the flanks transmit T only when the play is used up."
    source = "Nordin and Gutman 2002; gears 1 to 20 mrad, worn ones more"
    excitation = "torque that changes its sign, reversals under small load"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Joints with native motor, position or velocity actuators."""
        model = machine.base.model
        return tuple(
            joint
            for joint in machine.joints
            if (drives := _drives(model, joint)) and all(_followed(model, i) for i in drives)
        )

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Width of the play and inertia of the motor."""
        unit = machine.unit(element)
        small = 1.0 if unit == "rad" else 0.1
        own = joints.native(machine, element, "armature")
        motor = own or _MOTOR_SHARE * joints.inertia(machine, element)
        return (
            EffectParameter(
                "width", unit, upper=0.5 * small, trials=(0.004 * small, 0.02 * small, 0.08 * small)
            ),
            EffectParameter(
                "motor_inertia",
                joints.unit_of(machine, element, "{inertia}"),
                nominal=motor,
                lower=0.1 * motor,
                upper=own or 10.0 * motor,
                role="shape",
            ),
        )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Inserts a play, and follows its motor through the measured motion to window starts."""
        width, motor = values["width"], values["motor_inertia"]
        if width == 0.0:
            return

        def states(measured: Measured, variant: Variant) -> tuple[np.ndarray, np.ndarray]:
            return motor_states(measured, variant.model, element, width, motor)

        stiffness = motor * (2.0 * math.pi * _FLANK_HZ) ** 2
        play = {"width": width, "motor_inertia": motor, "stiffness": stiffness}
        insert_play(change, f"{element}_backlash", element, play, states)


# Where a motor is in its play, and its velocity, at window starts; both (windows,).
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
    """Where the motor is in the play, and its velocity, at window starts; both (windows,).

    The joint moves as measured, the motor as its torque drives it between rigid flanks; `inertia`
    is the motor's.
    """
    h, half = measured.period, 0.5 * width
    velocity = measured.velocity[joint]
    acceleration = np.gradient(velocity, h)
    index = (measured.samples[:, None] + np.arange(-round(_HISTORY / h), 1)).clip(0)
    torque = drive_torque(measured, model, joint)
    k, zero = index[:, 0], np.zeros(index.shape[0])
    # At first on the flank that a rigid gear would load.
    offset = half * np.sign(torque(k, zero, zero) - inertia * acceleration[k])
    slip = zero  # motor velocity less the joint's
    for column in range(index.shape[1] - 1):
        k, after = index[:, column], index[:, column + 1]
        pushed = torque(k, offset, slip) * (h / inertia) - (velocity[after] - velocity[k])
        moved = offset + h * (slip + 0.5 * pushed)
        offset = np.clip(moved, -half, half)
        # A flank takes the motor along, at once.
        slip = np.where(moved == offset, slip + pushed, 0.0)
    k = index[:, -1]
    # Velocities in MuJoCo lag half a step.
    free = torque(k, offset, slip) / inertia - acceleration[k]
    lag = np.where(np.abs(offset) < half, 0.5 * model.opt.timestep * free, 0.0)
    return offset, velocity[k] - 0.5 * model.opt.timestep * acceleration[k] + slip - lag


# Torque at samples, and where the motor is ahead of the joint there and how fast; all (k,).
Torque = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def drive_torque(measured: Measured, model: mujoco.MjModel, joint: str) -> Torque:
    """Torque of a joint's actuators along a recording; activations as if they had settled."""
    q, v = measured.position[joint], measured.velocity[joint]
    drives = []
    for i in _drives(model, joint):
        gear, gain = float(model.actuator_gear[i, 0]), float(model.actuator_gainprm[i, 0])
        limited = model.actuator_forcelimited[i]
        low, high = model.actuator_forcerange[i] if limited else (-np.inf, np.inf)
        command, bias = measured.command[model.actuator(i).name], model.actuator_biasprm[i, :3]
        drives.append((command, gear, gain, bias, low, high))

    def torque(k: np.ndarray, offset: np.ndarray, slip: np.ndarray) -> np.ndarray:
        theta, omega = q[k] + offset, v[k] + slip
        total = np.zeros(k.size)
        for command, gear, gain, bias, low, high in drives:
            force = gain * command[k] + bias[0] + gear * (bias[1] * theta + bias[2] * omega)
            total += gear * np.clip(force, low, high)
        return total

    return torque


def _drives(model: mujoco.MjModel, joint: str) -> list[int]:
    """Actuators of a joint."""
    on_joint = np.isin(model.actuator_trntype, _JOINT)
    return np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == model.joint(joint).id)).tolist()


def _followed(model: mujoco.MjModel, i: int) -> bool:
    """Whether `drive_torque` gives the force of an actuator."""
    return (
        model.actuator_plugin[i] < 0
        and model.actuator_gaintype[i] == int(mujoco.mjtGain.mjGAIN_FIXED)
        and model.actuator_biastype[i] in _BIASES
        and model.actuator_dyntype[i] <= int(mujoco.mjtDyn.mjDYN_FILTEREXACT)
        and not model.actuator_actearly[i]
        and model.actuator_history[i, 0] == 0
    )
