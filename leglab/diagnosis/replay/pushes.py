"""What commands of MuJoCo's own actuators do to a motion, faster than filters of positions follow.

A motor's force follows its command at once, and a light joint that a noisy loop drives changes its
velocity from sample to sample. Smoothed positions do not show that, but the commands are known: the
motion that they make by themselves is added as far as the filters take it away.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import lfilter

from leglab.diagnosis.intake.series import UniformSeries
from leglab.diagnosis.plant.model import Machine
from leglab.machine.simulation import actuator_moments


@dataclass(frozen=True, kw_only=True, eq=False)
class Pushes:
    """Accelerations of the joints by the commands of native actuators, along a recording.

    Attributes:
        actuators: Those that act at once by a fixed gain.
        response: d(acceleration)/d(command), (actuators, n, joints).
        limits: Lowest and highest command, (actuators, 2).
        decay: Rate at which dampers and servos slow each joint [1/s], (joints,).
        dofs: Degrees of freedom of the model.
    """

    actuators: tuple[str, ...]
    response: np.ndarray
    limits: np.ndarray
    decay: np.ndarray
    dofs: int

    @classmethod
    def of(cls, machine: Machine, series: UniformSeries) -> "Pushes | None":
        """Those of a machine; None where no actuator of MuJoCo's acts so."""
        model = machine.base.model
        at_once = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE
        fixed = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED
        acting = np.flatnonzero(at_once & fixed & (model.actuator_plugin < 0))
        if not acting.size:
            return None
        dofs = [int(model.joint(j).dofadr[0]) for j in machine.joints]
        response = np.zeros((acting.size, series.time.size, len(dofs)))
        decay = np.zeros(len(dofs))
        gain = model.actuator_gainprm[acting, 0]
        affine = model.actuator_biastype[acting] == mujoco.mjtBias.mjBIAS_AFFINE
        damping = np.where(affine, -model.actuator_biasprm[acting, 2], 0.0)
        inverse = np.zeros((model.nv, model.nv))
        for k, data in enumerate(poses(machine, series)):
            moment = actuator_moments(model, data)[acting]
            mujoco.mj_solveM(model, data, inverse, np.eye(model.nv))
            response[:, k] = ((inverse @ moment.T)[dofs] * gain).T
            slowing = model.dof_damping + damping @ moment**2
            decay += np.maximum(slowing[dofs], 0.0) * inverse[dofs, dofs]
        limited = model.actuator_ctrllimited[acting].astype(bool)[:, None]
        return cls(
            actuators=tuple(machine.actuators[i] for i in acting),
            response=response,
            limits=np.where(limited, model.actuator_ctrlrange[acting], [-np.inf, np.inf]),
            decay=decay / series.time.size,
            dofs=model.nv,
        )

    def moved(
        self, commands: Mapping[str, np.ndarray], period: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities by the commands alone, from rest, each (joints, n).

        Commands hold for a sampling period [s].
        """
        held = np.stack([commands[name] for name in self.actuators])
        held = np.clip(held, self.limits[:, :1], self.limits[:, 1:])
        pushed = (self.response * held[:, :, None]).sum(axis=0)
        kept = np.exp(-self.decay * period)
        rate = np.where(self.decay > 0.0, self.decay, 1.0)
        gained = np.where(self.decay > 0.0, -np.expm1(-self.decay * period) / rate, period)
        each = zip(gained, kept, pushed.T, strict=True)
        velocity = np.stack([lfilter([0.0, g], [1.0, -k], a) for g, k, a in each])
        # Exact for a velocity that is straight between samples.
        return cumulative_trapezoid(velocity, dx=period, initial=0.0), velocity


def poses(machine: Machine, series: UniformSeries, stride: int = 1) -> Iterator[mujoco.MjData]:
    """The machine at measured positions, one sample in a stride after the other."""
    model = machine.base.model
    data = mujoco.MjData(model)
    places = [int(model.joint(name).qposadr[0]) for name in machine.joints]
    positions = np.stack([series.columns[f"{name}_position"] for name in machine.joints], axis=1)
    for row in positions[::stride]:
        data.qpos[places] = row
        mujoco.mj_fwdPosition(model, data)
        yield data
