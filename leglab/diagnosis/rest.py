"""Bristles of joints at rest: what friction holds there follows from the balance of forces.

A bristle that slid further than it bends is known from the motion (`states.bristle`). At rest the
measured motion is all noise, and the balance says what dry friction carries; where several
bristles rest on one joint (a cylinder's seals, a bearing) they share it by their limits.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from leglab.diagnosis.change import Measured
from leglab.diagnosis.machine import CYLINDER, FRICTION, Machine, Variant
from leglab.parameters import PluginTable

# A bristle that slid less than twice its deflection in this time rests.
_REST = 0.03  # s


@dataclass(frozen=True, kw_only=True, eq=False)
class Bristle:
    """A bristle on a joint, at every window start; arrays of shape (windows,).

    Attributes:
        slot: Place of its deflection in the plugin state.
        stiffness: sigma_0, force a deflection.
        lever: d(deflection)/d(joint position) while it sticks.
        forward: Largest friction against motion towards positive joint positions, as a force on
            the joint.
        backward: The same for the other direction, positive.
    """

    slot: int
    stiffness: float
    lever: np.ndarray
    forward: np.ndarray
    backward: np.ndarray

    @property
    def travel(self) -> np.ndarray:
        """Full deflection as a travel of the joint."""
        most = np.maximum(self.forward, self.backward)
        return most / (self.lever**2 * self.stiffness + 1e-300)


def bristles(
    machine: Machine, measured: Measured, variant: Variant, state: np.ndarray, joint: str
) -> list[Bristle]:
    """Bristles that act on a joint.

    Args:
        machine: The unmodified machine.
        measured: Series of one recording.
        variant: Compiled model.
        state: Parameters and states at window starts, shape (windows, npluginstate).
        joint: Name.
    """
    found = []
    for element, (start, table) in variant.elements.items():
        seal = table.plugin == CYLINDER and joint in machine.driven[element]
        if not seal and (table.plugin != FRICTION or variant.joint_of[element] != joint):
            continue

        def get(name: str, start: int = start, table: PluginTable = table) -> np.ndarray:
            return state[:, start + table.entry(name).offset]

        stiffness = float(get("sigma_0")[0])
        if stiffness <= 0.0:
            continue
        slot = start + table.entry("bristle").offset
        breakaway = np.maximum(get("coulomb"), get("static"))
        if seal:
            lever = measured.lever[element][measured.samples]
            pressures = [measured.pressure.get(f"{joint}_pressure_{c}") for c in "ab"]
            total = sum(p[measured.samples] for p in pressures if p is not None)
            seals = get("pressure_coefficient") * np.maximum(total, 0.0)
            forward = backward = np.abs(lever) * (breakaway + seals)
        else:
            lever = np.ones(len(state))
            half = 0.5 * get("coulomb_difference")
            forward, backward = (
                get("wear")
                * (1.0 + side * get("direction_asymmetry"))
                * np.maximum(breakaway + side * half + get("load"), 0.0)
                for side in (1.0, -1.0)
            )
        found.append(
            Bristle(slot=slot, stiffness=stiffness, lever=lever, forward=forward, backward=backward)
        )
    return found


def balance(machine: Machine, measured: Measured, variant: Variant, state: np.ndarray) -> None:
    """Sets the deflection of resting bristles in place.

    Joints of cylinders without measured pressures are left as they are.

    Args:
        machine: The unmodified machine.
        measured: Series of one recording.
        variant: Compiled model.
        state: Parameters and states at window starts, shape (windows, npluginstate).
    """
    for joint in machine.joints:
        acting = bristles(machine, measured, variant, state, joint)
        cylinders = [c for c in machine.instances(CYLINDER) if joint in machine.driven[c]]
        chambers = [f"{joint}_pressure_{c}" for c in "ab"]
        if not acting or (cylinders and not all(c in measured.pressure for c in chambers)):
            continue
        position = measured.position[joint]
        back = np.maximum(measured.samples - round(_REST / measured.period), 0)
        travel = np.abs(position[measured.samples] - position[back])
        resting = np.stack([travel < 2.0 * bristle.travel for bristle in acting])
        rows = np.flatnonzero(resting.any(axis=0))
        if not rows.size:
            continue
        for bristle, rests in zip(acting, resting, strict=True):
            state[rests, bristle.slot] = 0.0
        held = _unbalanced(machine, measured, variant, state, rows, joint)
        limit = np.stack([np.where(held > 0, b.forward[rows], b.backward[rows]) for b in acting])
        limit *= resting[:, rows]
        share = held / np.maximum(limit.sum(axis=0), np.abs(held) + 1e-300)
        for bristle, rests, part in zip(acting, resting[:, rows], limit * share, strict=True):
            deflection = part / (bristle.lever[rows] * bristle.stiffness)
            state[rows[rests], bristle.slot] = deflection[rests]


def _unbalanced(
    machine: Machine,
    measured: Measured,
    variant: Variant,
    state: np.ndarray,
    rows: np.ndarray,
    joint: str,
) -> np.ndarray:
    """Force on a joint that the measured motion leaves over at some windows, (rows,)."""
    model = variant.model
    data = mujoco.MjData(model)
    dof = int(model.joint(joint).dofadr[0])
    out = np.empty(rows.size)
    for i, (row, k) in enumerate(zip(rows.tolist(), measured.samples[rows].tolist(), strict=True)):
        data.plugin_state[:] = state[row]
        for name in machine.joints:
            data.qpos[model.joint(name).qposadr[0]] = measured.position[name][k]
            data.qvel[model.joint(name).dofadr[0]] = measured.velocity[name][k]
        for number, name in enumerate(machine.actuators):
            data.ctrl[number] = measured.command[name][k]
        mujoco.mj_forward(model, data)
        for name in machine.joints:
            v = measured.velocity[name]
            slope = (v[k + 1] - v[k - 1]) / (2.0 * measured.period)
            data.qacc[model.joint(name).dofadr[0]] = slope
        mujoco.mj_inverseSkip(model, data, mujoco.mjtStage.mjSTAGE_VEL, 1)
        out[i] = data.qfrc_actuator[dof] - data.qfrc_inverse[dof]
    return out
