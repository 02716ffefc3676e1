"""What commands of MuJoCo's own actuators do to a motion, faster than filters of positions follow.

A motor's force follows its command at once, and a light joint that a noisy loop drives changes its
velocity from sample to sample. Smoothed positions do not show that, but the commands are known: the
motion that they make by themselves is added as far as the filters take it away.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.signal import lfilter

from leglab.diagnosis.intake.series import UniformSeries
from leglab.diagnosis.plant.model import Machine
from leglab.machine.simulation import actuator_moments


@dataclass(frozen=True, kw_only=True, eq=False)
class Pushes:
    """Accelerations of the joints by the commands of native actuators, along a recording.

    Attributes:
        joints: Of the machine.
        response: d(acceleration)/d(command), by actuator, each (n, joints).
        limits: Lowest and highest command, by actuator.
        decay: Rate at which dampers and servos slow each joint [1/s], (joints,).
        dofs: Degrees of freedom of the model.
    """

    joints: tuple[str, ...]
    response: dict[str, np.ndarray]
    limits: dict[str, tuple[float, float]]
    decay: np.ndarray
    dofs: int

    @classmethod
    def of(cls, machine: Machine, series: UniformSeries) -> "Pushes | None":
        """Those of a machine; None where no actuator of MuJoCo's acts at once by a fixed gain."""
        model = machine.base.model
        acting = [
            name
            for name in machine.native_actuators()
            if model.actuator(name).dyntype[0] == mujoco.mjtDyn.mjDYN_NONE
            and model.actuator(name).gaintype[0] == mujoco.mjtGain.mjGAIN_FIXED
        ]
        if not acting:
            return None
        data = mujoco.MjData(model)
        numbers = [model.actuator(name).id for name in acting]
        places = [int(model.joint(j).qposadr[0]) for j in machine.joints]
        dofs = [int(model.joint(j).dofadr[0]) for j in machine.joints]
        position = np.stack([series.columns[f"{j}_position"] for j in machine.joints], axis=1)
        response = np.zeros((len(position), len(dofs), len(acting)))
        decay = np.zeros(len(dofs))
        gain = model.actuator_gainprm[numbers, 0]
        affine = model.actuator_biastype[numbers] == mujoco.mjtBias.mjBIAS_AFFINE
        damping = np.where(affine, -model.actuator_biasprm[numbers, 2], 0.0)
        inverse = np.zeros((model.nv, model.nv))
        for k, q in enumerate(position):
            data.qpos[places] = q
            mujoco.mj_fwdPosition(model, data)
            moment = actuator_moments(model, data)[numbers]
            mujoco.mj_solveM(model, data, inverse, np.eye(model.nv))
            response[k] = (inverse @ moment.T)[dofs] * gain
            slowing = model.dof_damping + damping @ moment**2
            decay += np.maximum(slowing[dofs], 0.0) * inverse[dofs, dofs]
        limits = {
            name: tuple(model.actuator(name).ctrlrange.tolist())
            if model.actuator(name).ctrllimited[0]
            else (-np.inf, np.inf)
            for name in acting
        }
        return cls(
            joints=machine.joints,
            response={name: response[:, :, i] for i, name in enumerate(acting)},
            limits=limits,
            decay=decay / len(position),
            dofs=model.nv,
        )

    def moved(
        self, commands: Mapping[str, np.ndarray], period: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities by the commands alone, from rest, each (joints, n).

        Commands hold for a sampling period [s].
        """
        pushed = sum(
            response * np.clip(commands[name], *self.limits[name])[:, None]
            for name, response in self.response.items()
        )
        kept = np.exp(-self.decay * period)
        rate = np.where(self.decay > 0.0, self.decay, 1.0)
        gained = np.where(self.decay > 0.0, -np.expm1(-self.decay * period) / rate, period)
        velocity = np.stack(
            [
                lfilter([0.0, g], [1.0, -k], a)
                for g, k, a in zip(gained, kept, np.asarray(pushed).T, strict=True)
            ]
        )
        # Trapezia, exact for a velocity that is straight between samples.
        steps = 0.5 * period * (velocity[:, 1:] + velocity[:, :-1])
        position = np.concatenate([np.zeros((len(velocity), 1)), np.cumsum(steps, axis=1)], axis=1)
        return position, velocity
