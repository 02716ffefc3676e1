"""Motion by commands of MuJoCo's native actuators, whose fast part smoothing filters remove.

Smoothed positions do not show how a noisy command moves a light joint from sample to sample. This
motion is therefore computed from the commands, and the part that filters remove is added again.
"""

from collections.abc import Iterator, Mapping

import mujoco
import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import lfilter

from leglab.diagnosis.intake.series import UniformSeries
from leglab.diagnosis.plant.model import Machine
from leglab.machine.simulation import actuator_moments


class Pushes:
    """Joint accelerations caused by the commands of native actuators, along a recording.

    Attributes:
        actuators: Names of the native actuators with a fixed gain and no activation dynamics.
        dofs: Number of degrees of freedom of the model.

    Args:
        machine: Machine of the recording.
        series: The recording.
        stride: Samples between the poses at which accelerations are computed.
    """

    def __init__(self, machine: Machine, series: UniformSeries, stride: int = 1) -> None:
        model = machine.base.model
        at_once = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE
        fixed = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED
        acting = np.flatnonzero(at_once & fixed & (model.actuator_plugin < 0))
        self.actuators, self.dofs = tuple(machine.actuators[i] for i in acting), model.nv
        if not acting.size:
            return
        limited = model.actuator_ctrllimited[acting].astype(bool)[:, None]
        self._limits = np.where(limited, model.actuator_ctrlrange[acting], [-np.inf, np.inf])
        dofs = [int(model.joint(j).dofadr[0]) for j in machine.joints]
        # d(joint acceleration)/d(command), and rate at which dampers and servos slow joints [1/s].
        count = -(-series.time.size // stride)
        response = np.zeros((acting.size, count, len(dofs)))
        decay = np.zeros(len(dofs))
        gain = model.actuator_gainprm[acting, 0]
        affine = model.actuator_biastype[acting] == mujoco.mjtBias.mjBIAS_AFFINE
        damping = np.where(affine, -model.actuator_biasprm[acting, 2], 0.0)
        inverse, unit = np.zeros((model.nv, model.nv)), np.eye(model.nv)
        for k, data in enumerate(poses(machine, series, slice(None, None, stride))):
            moment = actuator_moments(model, data)[acting]
            mujoco.mj_solveM(model, data, inverse, unit)
            if machine.followers is not None:  # followers move with their leading joints
                moves, mass = machine.followers.motion(data.qpos), np.linalg.inv(inverse)
                inverse = moves @ np.linalg.solve(moves.T @ mass @ moves, moves.T)
            response[:, k] = ((inverse @ moment.T)[dofs] * gain).T
            slowing = model.dof_damping + damping @ moment**2
            decay += np.maximum(slowing[dofs], 0.0) * inverse[dofs, dofs]
        self._decay = decay / count
        self._response = np.repeat(response, stride, axis=1)[:, : series.time.size]

    def moved(
        self, commands: Mapping[str, np.ndarray], period: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Computes positions and velocities by commands alone, from rest, each (joints, n).

        Each command is held for a sampling period [s].
        """
        held = np.stack([commands[name] for name in self.actuators])
        held = np.clip(held, self._limits[:, :1], self._limits[:, 1:])
        pushed, decay = (self._response * held[:, :, None]).sum(axis=0), self._decay
        kept, rate = np.exp(-decay * period), np.where(decay > 0.0, decay, 1.0)
        gained = np.where(decay > 0.0, -np.expm1(-decay * period) / rate, period)
        each = zip(gained, kept, pushed.T, strict=True)
        velocity = np.stack([lfilter([0.0, g], [1.0, -k], a) for g, k, a in each])
        # The trapezoidal rule is exact for a velocity that is linear between samples.
        return cumulative_trapezoid(velocity, dx=period, initial=0.0), velocity


def poses(
    machine: Machine, series: UniformSeries, samples: slice | np.ndarray = slice(None)
) -> Iterator[mujoco.MjData]:
    """Yields the unmodified machine's state at the measured positions, sample by sample."""
    model = machine.base.model
    data = mujoco.MjData(model)
    places = [int(model.joint(name).qposadr[0]) for name in machine.joints]
    columns = [series.columns[f"{name}_position"][samples] for name in machine.joints]
    rows = np.tile(model.qpos0, (columns[0].size, 1))
    rows[:, places] = np.stack(columns, axis=1)
    for row in machine.followers.positions(rows) if machine.followers else rows:
        data.qpos[:] = row
        mujoco.mj_fwdPosition(model, data)
        yield data
