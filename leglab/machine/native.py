"""MuJoCo's built-in actuators as drives of one joint: force of a command, command of a force.

MuJoCo computes force = gain x input + bias, gain and bias affine in length and velocity of the
transmission, clipped to `forcerange` (MuJoCo documentation, "Computation", "Actuation model"). A
motor has a constant gain and no bias; position and velocity servos have a bias that closes a loop.
Controllers send commands in [-1, 1]; -1 and 1 are the two ends of the actuator's control range.
"""

import math
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from leglab.base.errors import ModelError

_SIMPLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_GAINS = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))
_BIASES = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
_FILTERS = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
_DYNAMICS = (int(mujoco.mjtDyn.mjDYN_NONE), *_FILTERS)
_ALLOWED = "allowed: motor, position, velocity or general actuators and leglab.cylinder"

# Travel on each side of the rest position of a hinge [rad] and of a slide [m] to which the model
# gives no range; chosen for leglab.
HINGE_TRAVEL, SLIDE_TRAVEL = math.pi / 2, 0.5
# Largest lever arm of an actuator on other joints over its lever arm on the joint that it drives.
_LEVER_ELSEWHERE = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class NativeActuator:
    """A motor, position, velocity or general actuator that drives one joint.

    Values are read from the model at each call, because a fault may have changed them.
    """

    model: mujoco.MjModel  #: The MuJoCo model
    id: int  #: Number of the actuator
    name: str  #: Name of the actuator; the joint's name if the actuator has none
    joint: int  #: Number of the joint that it drives
    centre: float  #: Control in the middle of its range, in the control's own unit
    half: float  #: Half the width of the control range: control = centre + half x command

    @classmethod
    def of(cls, model: mujoco.MjModel, number: int, moments: np.ndarray) -> "NativeActuator":
        """Reads an actuator.

        Args:
            model: The model.
            number: Number of the actuator.
            moments: Lever arms of the actuator in the rest pose, (nv,).

        Raises:
            ModelError: A run cannot command this kind of actuator, it moves several joints, or it
                has no limit; one line names the actuator and what is allowed.
        """
        joint = _joint_of(model, number, moments)
        name = model.actuator(number).name or model.joint(joint).name
        where = f"actuator {name!r}"
        wrong = _not_supported(model, number)
        if wrong:
            raise ModelError(f"{where} {wrong}; {_ALLOWED}", given=name)
        low, high = _control_range(model, number, joint, where, moments)
        return cls(
            model=model,
            id=number,
            name=name,
            joint=joint,
            centre=0.5 * (low + high),
            half=0.5 * (high - low),
        )

    @property
    def dof(self) -> int:
        """Number of the degree of freedom that the actuator drives."""
        return int(self.model.jnt_dofadr[self.joint])

    @property
    def time_constant(self) -> float:
        """Time constant of the first-order filter from control to force [s]; 0 without a filter."""
        if int(self.model.actuator_dyntype[self.id]) in _FILTERS:
            return float(self.model.actuator_dynprm[self.id, 0])
        return 0.0

    def gain(self, data: mujoco.MjData) -> float:
        """Returns force per control at the present length and velocity of the transmission."""
        affine = int(self.model.actuator_gaintype[self.id]) == mujoco.mjtGain.mjGAIN_AFFINE
        return self._affine(self.model.actuator_gainprm[self.id], affine, data)

    def bias(self, data: mujoco.MjData) -> float:
        """Returns the force at control 0, at the present length and velocity."""
        if int(self.model.actuator_biastype[self.id]) == mujoco.mjtBias.mjBIAS_NONE:
            return 0.0
        return self._affine(self.model.actuator_biasprm[self.id], True, data)

    def slopes(self, command: float) -> tuple[float, float]:
        """Returns the force's derivatives by transmission length and velocity at a command."""
        control = self.centre + self.half * command
        found = np.zeros(2)
        if int(self.model.actuator_biastype[self.id]) != mujoco.mjtBias.mjBIAS_NONE:
            found += self.model.actuator_biasprm[self.id, 1:3]
        if int(self.model.actuator_gaintype[self.id]) == mujoco.mjtGain.mjGAIN_AFFINE:
            found += control * self.model.actuator_gainprm[self.id, 1:3]
        return float(found[0]), float(found[1])

    def command(self, force: float, data: mujoco.MjData) -> float:
        """Returns the steady command that gives a force at the present length and velocity.

        For a force beyond the actuator's range the command is the nearer end of [-1, 1].
        """
        gain = self.gain(data)
        if gain == 0.0:
            text = f"actuator {self.name!r} has no gain in this pose: no command moves"
            raise ModelError(text, given=self.name)
        low, high = self.force_range(data)
        control = (min(max(force, low), high) - self.bias(data)) / gain
        if not low < force < high:
            return math.copysign(1.0, control - self.centre)
        return min(max((control - self.centre) / self.half, -1.0), 1.0)

    def force_range(self, data: mujoco.MjData) -> tuple[float, float]:
        """Returns the smallest and largest force of commands in [-1, 1] in the present state."""
        ends = [
            self.gain(data) * (self.centre + self.half * end) + self.bias(data) for end in (-1, 1)
        ]
        low, high = min(ends), max(ends)
        if self.model.actuator_forcelimited[self.id]:
            least, greatest = self.model.actuator_forcerange[self.id].tolist()
            low, high = max(low, least), min(high, greatest)
        if self.model.jnt_actfrclimited[self.joint]:
            least, greatest = self.model.jnt_actfrcrange[self.joint].tolist()
            lever = self.lever(data)
            ends = sorted((least / lever, greatest / lever))
            low, high = max(low, ends[0]), min(high, ends[1])
        return low, high

    def lever(self, data: mujoco.MjData) -> float:
        """Returns the actuator's lever arm on the joint, gear included [m/rad or 1]."""
        first, count = int(data.moment_rowadr[self.id]), int(data.moment_rownnz[self.id])
        row = slice(first, first + count)
        places = np.flatnonzero(data.moment_colind[row] == self.dof)
        return float(data.actuator_moment[row][places[0]]) if places.size else 0.0

    def setpoint(self, data: mujoco.MjData) -> tuple[float, float, float]:
        """Returns a servo's command as an affine function of desired joint position and velocity.

        Returns:
            The command for position 0 at the present lever arm, and its slopes over position and
            velocity [1/rad, s/rad]; zeros for an actuator without an internal control loop.
        """
        per_length, per_velocity = self.slopes(0.0)
        gain = self.gain(data) * self.half
        lever = self.lever(data)
        if per_length:
            # Force = gain (control - kp/gain length): the control for zero force at this length.
            slope = -per_length * lever / gain
            position = float(data.qpos[self.model.jnt_qposadr[self.joint]])
            length = float(data.actuator_length[self.id]) - lever * position
            constant = -float(self.model.actuator_biasprm[self.id, 0]) - per_length * length
            return (constant / self.gain(data) - self.centre) / self.half, slope, 0.0
        if per_velocity:
            return -self.centre / self.half, 0.0, -per_velocity * lever / gain
        return 0.0, 0.0, 0.0

    def description(self) -> dict[str, Any]:
        """Returns the actuator's parameters as they are stored in `run.json`."""
        model = self.model
        return {
            "joint": model.joint(self.joint).name,
            "control_centre": self.centre,
            "control_half_range": self.half,
            "gain": model.actuator_gainprm[self.id, :3].tolist(),
            "bias": model.actuator_biasprm[self.id, :3].tolist(),
            "gear": float(model.actuator_gear[self.id, 0]),
            "time_constant": self.time_constant,
        }

    def _affine(self, terms: np.ndarray, whole: bool, data: mujoco.MjData) -> float:
        if not whole:
            return float(terms[0])
        length, velocity = data.actuator_length[self.id], data.actuator_velocity[self.id]
        return float(terms[0] + terms[1] * length + terms[2] * velocity)


def joint_range(model: mujoco.MjModel, joint: int, rest: float) -> tuple[float, float]:
    """Returns a joint's range [rad or m]; without one, the default travel about its rest."""
    if model.jnt_limited[joint]:
        low, high = model.jnt_range[joint].tolist()
        return low, high
    hinge = int(model.jnt_type[joint]) == mujoco.mjtJoint.mjJNT_HINGE
    travel = HINGE_TRAVEL if hinge else SLIDE_TRAVEL
    return rest - travel, rest + travel


def _joint_of(model: mujoco.MjModel, number: int, moments: np.ndarray) -> int:
    """Returns the joint that an actuator moves."""
    levers = np.abs(moments)
    name = model.actuator(number).name
    where = f"actuator {name!r}" if name else f"actuator {number}"
    if not levers.any():
        text = f"{where} moves no joint in the rest pose; {_ALLOWED}"
        raise ModelError(text, given=name)
    dof = int(levers.argmax())
    joint = int(model.dof_jntid[dof])
    others = np.delete(levers, dof)
    if int(model.jnt_type[joint]) not in _SIMPLE or (others > _LEVER_ELSEWHERE * levers[dof]).any():
        text = f"{where} moves more than one joint; allowed: "
        raise ModelError(text, given=name, allowed="one hinge or slide joint an actuator")
    if not model.joint(joint).name:
        text = f"{where} moves joint {joint}, which has no name; a run needs one"
        raise ModelError(text, given=name)
    return joint


def _not_supported(model: mujoco.MjModel, number: int) -> str:
    """Returns the reason why a run cannot command an actuator; empty if it can."""
    if int(model.actuator_plugin[number]) >= 0:
        return "is of a plugin that runs do not know"
    if int(model.actuator_gaintype[number]) not in _GAINS:
        return "has a gain that is neither fixed nor affine"
    if int(model.actuator_biastype[number]) not in _BIASES:
        return "has a bias that is neither none nor affine"
    if int(model.actuator_dyntype[number]) not in _DYNAMICS:
        return "has dynamics other than none, filter or filterexact"
    if int(model.actuator_ctrlnum[number]) != 1 or int(model.actuator_outnum[number]) != 1:
        return "has several inputs or outputs"
    return ""


def _control_range(
    model: mujoco.MjModel, number: int, joint: int, where: str, moments: np.ndarray
) -> tuple[float, float]:
    """Returns the control range whose ends are the commands -1 and 1.

    It is the actuator's `ctrlrange`; without one, the joint range for a position servo and
    `forcerange` divided by the gain for a force actuator.
    """
    if model.actuator_ctrllimited[number]:
        low, high = model.actuator_ctrlrange[number].tolist()
        if not high > low:
            text = f"{where} has an empty ctrlrange {low:g} to {high:g}"
            raise ModelError(text, given=(low, high))
        return low, high
    gain, bias = model.actuator_gainprm[number], model.actuator_biasprm[number]
    affine = int(model.actuator_biastype[number]) == mujoco.mjtBias.mjBIAS_AFFINE
    on_joint = int(model.actuator_trntype[number]) == mujoco.mjtTrn.mjTRN_JOINT
    if affine and bias[1] and gain[0] and on_joint:
        rest = float(model.qpos0[model.jnt_qposadr[joint]])
        lever = float(moments[model.jnt_dofadr[joint]])
        ends = np.array(joint_range(model, joint, rest)) * lever * (-bias[1] / gain[0])
        return float(ends.min()), float(ends.max())
    if model.actuator_forcelimited[number] and gain[0] and not (affine and bias[2]):
        ends = model.actuator_forcerange[number] / gain[0]
        return float(ends.min()), float(ends.max())
    text = f"{where} has no ctrlrange, and a run commands shares of it; give it a ctrlrange"
    raise ModelError(text, given=model.actuator(number).name)
