"""Joints ("followers") whose motion equality constraints determine from other joints' motion."""

import copy
from collections.abc import Collection, Sequence

import mujoco
import numpy as np

_OFF = mujoco.mjtDisableBit
_ITERATIONS = 50
# Number of steps from the reference pose to the first measured pose. A linkage can close in several
# ways, and small steps keep Newton's method on the branch of the reference pose.
_APPROACH = 50
# Residual at which a constraint is satisfied [m or rad], below 1/1000 of encoder resolutions.
_CLOSED = 1e-9


class Followers:
    """Joints ("followers") whose positions are determined by equality constraints.

    Newton's method solves MuJoCo's active equalities (joint, connect, weld, tendon) with residual r
    and Jacobian [J_l J_f] of leading joints and followers: dq_f = -J_f^+ r, v_f = -J_f^+ J_l v_l.

    Attributes:
        names: Names of the followers.
        leading: Names of the joints that move each follower.
    """

    def __init__(
        self, model: mujoco.MjModel, joints: Sequence[str], names: Collection[str]
    ) -> None:
        self.names = tuple(name for name in joints if name in names)
        self._model = copy_of_equalities(model)
        self._data = mujoco.MjData(self._model)
        rows = [model.joint(name) for name in self.names]
        self._places = [int(row.qposadr[0]) for row in rows]
        self._dofs = [int(row.dofadr[0]) for row in rows]
        self._others = np.setdiff1d(np.arange(model.nv), self._dofs)
        self._inverse: np.ndarray | None = None  # pseudo-inverse of J_f at a pose nearby
        self._data.qpos[:] = model.qpos0
        _, jacobian = self._residual()
        slope = np.abs(self._gain(jacobian))
        moved = slope > 1e-9 * max(float(slope.max(initial=0.0)), 1e-300)
        named = [joints[int(model.dof_jntid[k])] for k in self._others]
        self.leading = {
            name: tuple(one for one, moves in zip(named, row, strict=True) if moves)
            for name, row in zip(self.names, moved, strict=True)
        }

    def positions(self, rows: np.ndarray, *, near: bool = False) -> np.ndarray:
        """Returns poses `rows`, (samples, nq), with the positions of followers computed.

        The poses are samples of one motion or, if `near`, almost satisfy the equalities already.
        """
        out, data = rows.copy(), self._data
        others = np.setdiff1d(np.arange(self._model.nq), self._places)
        data.qpos[:] = self._model.qpos0
        first = data.qpos[others].copy()
        for share in () if near else np.linspace(0.0, 1.0, _APPROACH)[:-1]:
            data.qpos[others] = first + share * (rows[0, others] - first)
            self._close()
        for k, row in enumerate(rows):
            data.qpos[others] = row[others]
            if near:
                data.qpos[:] = row
            self._close()
            out[k, self._places] = data.qpos[self._places]
        return out

    def velocities(self, positions: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Returns velocities `rows`, (samples, nv), with the followers' velocities computed."""
        out = rows.copy()
        for k, position in enumerate(positions):
            self._data.qpos[:] = position
            _, jacobian = self._residual()
            out[k, self._dofs] = self._gain(jacobian) @ rows[k, self._others]
        return out

    def motion(self, position: np.ndarray) -> np.ndarray:
        """Returns d(all joints' velocities)/d(other joints' velocities) at a pose, (nv, others)."""
        self._data.qpos[:] = position
        _, jacobian = self._residual()
        out = np.zeros((self._model.nv, self._others.size))
        out[self._others] = np.eye(self._others.size)
        out[self._dofs] = self._gain(jacobian)
        return out

    def _gain(self, jacobian: np.ndarray) -> np.ndarray:
        """Returns d(followers' velocities)/d(other joints' velocities), (followers, others)."""
        return -np.linalg.pinv(jacobian[:, self._dofs]) @ jacobian[:, self._others]

    def _close(self) -> None:
        for i in range(_ITERATIONS):
            residual, jacobian = self._residual()
            if np.abs(residual).max(initial=0.0) < _CLOSED:
                return
            if self._inverse is None or i > 1:  # Neighbouring samples share an inverse.
                self._inverse = np.linalg.pinv(jacobian[:, self._dofs], rcond=1e-9)
            self._data.qpos[self._places] -= self._inverse @ residual

    def _residual(self) -> tuple[np.ndarray, np.ndarray]:
        return _residual(self._model, self._data)


def copy_of_equalities(model: mujoco.MjModel) -> mujoco.MjModel:
    """Copies a model with all constraints but equalities disabled, and a dense Jacobian."""
    found = copy.copy(model)
    found.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    for flag in (_OFF.mjDSBL_CONTACT, _OFF.mjDSBL_LIMIT, _OFF.mjDSBL_FRICTIONLOSS):
        found.opt.disableflags |= int(flag)
    return found


def _residual(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Returns the residuals of all equalities, (rows,), and their Jacobian, (rows, nv)."""
    mujoco.mj_fwdPosition(model, data)
    return data.efc_pos.copy(), data.efc_J.reshape(-1, model.nv).copy()


def determined(
    model: mujoco.MjModel, joints: Sequence[str], unmeasured: Collection[str]
) -> frozenset[str]:
    """Returns the unmeasured joints whose positions equalities and measured joints determine.

    A joint is determined if it cannot move while the measured joints rest and all equalities hold,
    that is, if its component in the null space of the unmeasured joints' Jacobian is zero.
    """
    if not unmeasured or not model.neq:
        return frozenset()
    own = copy_of_equalities(model)
    data = mujoco.MjData(own)
    # The pose need not satisfy the equalities, because the rank does not depend on residuals.
    data.qpos[:] = model.qpos0 + 0.1
    _, jacobian = _residual(own, data)
    names = [name for name in joints if name in unmeasured]
    part = jacobian[:, [int(model.joint(name).dofadr[0]) for name in names]]
    _, values, rows = np.linalg.svd(part, full_matrices=True)
    rank = int((values > 1e-9 * max(float(values.max(initial=0.0)), 1e-300)).sum())
    free = np.abs(rows[rank:]).max(axis=0, initial=0.0)
    return frozenset(name for name, size in zip(names, free, strict=True) if size < 1e-6)
