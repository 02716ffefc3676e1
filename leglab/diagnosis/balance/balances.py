"""Balances of forces and of oil along the measured motion, and the residual that the model leaves.

The residual is the momentum or pressure gained over a window minus the impulses of all modelled
forces or flows. In this integral form, sensor noise has little influence.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from leglab.base.scale import rms
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.plant.model import CHAMBERS, Change, ForceLeft, Measured
from leglab.diagnosis.plant.moments import accelerations, dofs, plugin_offset
from leglab.diagnosis.replay.lacking import lacking_forces
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.replay.starts import measure, start_states
from leglab.diagnosis.replay.windows import Cut
from leglab.machine.cylinder import Cylinder


@dataclass(frozen=True, kw_only=True, eq=False)
class Balance:
    """Residual of the forces on one joint, or of the oil of one cylinder.

    Arrays have the shape (windows, samples); a window's residual is the mean over its samples.
    """

    element: str  #: Joint or cylinder
    joint: str  #: Joint whose motion is among the inputs
    actuator: str  #: Actuator whose command is an input; empty if nothing drives the joint
    oil: bool  #: Whether it is an oil balance
    #: Residual force [N m or N], or residual d(p_A - p_B)/dt [Pa/s], (windows, samples).
    lacking: np.ndarray
    #: d(`lacking`)/d(learned quantity), (windows, samples): 1 for forces. For oil, the learned
    #: quantity is a command offset, and the gain is d(`lacking`)/d(valve opening).
    gain: np.ndarray
    inputs: dict[str, np.ndarray]  #: Position, velocity, load and command, each (windows, samples)
    moving: np.ndarray  #: Whether the joint moves at all samples, (windows,)
    recording: np.ndarray  #: Index of each window's recording, (windows,)
    time: np.ndarray  #: Time at the middle of each window [s], (windows,)

    @property
    def gained(self) -> np.ndarray:
        """Mean residual of each window, (windows,)."""
        return np.asarray(self.lacking.mean(axis=1))

    def of(self, mask: np.ndarray) -> "Balance":
        """Returns the balance with only the windows at which `mask` is true."""
        return _combined([self], lambda own: own[0][mask])


def _combined(
    parts: Sequence[Balance], combine: Callable[[list[np.ndarray]], np.ndarray]
) -> Balance:
    """Returns a balance whose arrays are the combined arrays of several balances."""
    names = ("lacking", "gain", "moving", "recording", "time")
    made: dict[str, Any] = {name: combine([getattr(p, name) for p in parts]) for name in names}
    made["inputs"] = {k: combine([p.inputs[k] for p in parts]) for k in parts[0].inputs}
    return replace(parts[0], **made)


def balances(problem: Problem, hypothesis: Hypothesis) -> tuple[Balance, ...]:
    """Returns the balances of all joints and cylinders with known forces, for a hypothesis.

    Cylinders without measured pressures, and the joints that they move, have no balance.
    """
    change = problem.library.change(hypothesis, problem.machine)
    found: dict[tuple[str, bool], list[Balance]] = {}
    for number, cut in enumerate(problem.replay.cuts):
        for one in _of_series(problem, change, cut, number):
            found.setdefault((one.element, one.oil), []).append(one)
    return tuple(_combined(parts, np.concatenate) for parts in found.values())


def _windows(problem: Problem, cut: Cut) -> tuple[np.ndarray, int]:
    """Returns samples of windows without data gaps, (windows, samples), and half their spacing."""
    limits = problem.thresholds
    # Samples are `stride` apart, about two per bin. Windows are twice as long as the position
    # filter, so that the noise of neighbouring windows is nearly independent.
    half = max(1, round(0.25 * limits.bin / cut.series.period))
    stride, per_window = 2 * half, round(2.0 * limits.position_filter[0] / (0.5 * limits.bin))
    margin = max(c.filter[0] for c in problem.channels) + half
    valid = cut.series.valid
    starts = np.arange(margin, valid.size - margin - stride * per_window, stride * per_window)
    rows = starts[:, None] + half + stride * np.arange(per_window)
    gaps = np.concatenate([[0], np.cumsum(~valid)])
    return rows[gaps[rows[:, -1] + margin] == gaps[np.maximum(rows[:, 0] - margin, 0)]], half


def _of_series(problem: Problem, change: Change, cut: Cut, number: int) -> Iterator[Balance]:
    machine, limits, model = problem.machine, problem.thresholds, change.variant.model
    rows, half = _windows(problem, cut)
    if not rows.size:
        return
    measured = replace(measure(cut, problem.channels, change)[0], samples=rows.ravel())
    states = start_states(cut, change, measured, problem.channels, problem.replay.rest_time)
    found = lacking_forces(change, measured, states, half)
    common: dict[str, Any] = {
        "recording": np.full(len(rows), number),
        "time": cut.series.time[rows].mean(axis=1),
    }
    for joint in problem.balanced:
        dof, v = int(model.joint(joint).dofadr[0]), measured.velocity[joint]
        slow = limits.resting_speed * float(rms(v))
        drive = next((a for a in machine.actuators if joint in machine.driven[a]), "")
        inputs = {
            "position": measured.position[joint][rows],
            "velocity": v[rows],
            "load": found.load[:, dof].reshape(rows.shape),
        }
        if drive:
            inputs["command"] = measured.command[drive][rows]
        yield Balance(
            element=joint,
            joint=joint,
            actuator=drive,
            oil=False,
            lacking=found.lacking[:, dof].reshape(rows.shape),
            gain=np.ones(rows.shape),
            inputs=inputs,
            moving=(np.abs(v[rows]) > slow).all(axis=1),
            **common,
        )
    for cylinder in machine.cylinders:
        joint, index = machine.driven[cylinder][0], model.actuator(cylinder).id
        if joint not in problem.balanced:
            continue
        values = {
            "position": found.length[:, index],
            "velocity": found.speed[:, index],
            "load": found.pull[:, index],
            "command": np.clip(measured.command[cylinder][rows.ravel()], -1.0, 1.0),
        }
        lacking, gain = _oil(change, measured, states, cylinder, values, half)
        yield Balance(
            element=cylinder,
            joint=joint,
            actuator=cylinder,
            oil=True,
            lacking=lacking.reshape(rows.shape),
            gain=gain.reshape(rows.shape),
            inputs={name: x.reshape(rows.shape) for name, x in values.items()},
            moving=np.ones(len(rows), dtype=bool),
            **common,
        )


def _oil(
    change: Change,
    measured: Measured,
    states: np.ndarray,
    cylinder: str,
    at: dict[str, np.ndarray],
    half: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the residual of d(p_A - p_B)/dt, and d(residual)/d(spool position), (samples,)."""
    variant, joint, k = change.variant, change.machine.driven[cylinder][0], measured.samples
    table = variant.elements[cylinder][1].parameters
    values = {name: change.parameter(cylinder, name) for name in table}
    model = Cylinder(values)
    a, b = (measured.pressure[f"{joint}_{chamber}"] for chamber in CHAMBERS)
    rate = ((a - b)[k + half] - (a - b)[k - half]) / (2 * half * measured.period)
    slot = plugin_offset(variant.model) + variant.slot(cylinder, "spool_position")
    # Spool step of the finite difference for the gain; its size matters only at a metering edge.
    step = 0.01
    modelled = np.empty((3, k.size))
    for i, spool in enumerate(np.clip(states[:, slot], step - 1.0, 1.0 - step).tolist()):
        state = {
            "position": 0.5 * values["stroke"] + at["position"][i] - values["mid_length"],
            "velocity": at["velocity"][i],
            "pressure_a": a[k[i]],
            "pressure_b": b[k[i]],
        }
        for row, by in enumerate((-step, 0.0, step)):
            full = model.initial_state(**state, spool_position=spool + by)
            flows = model.derivative(full, command=spool)
            modelled[row, i] = flows[4] - flows[5]
    return rate - modelled[1], (modelled[2] - modelled[0]) / (2.0 * step)


def forces_left(problem: Problem, hypothesis: Hypothesis) -> dict[str, ForceLeft]:
    """Returns residual forces of fitted windows by joint: M a + bias minus all modelled forces.

    Joints of cylinders without measured pressures are left out, as their drive force is unknown.
    """
    replay, joints = problem.replay, problem.balanced
    if not joints:
        return {}
    change = problem.library.change(hypothesis, replay.machine)
    model = change.variant.model
    own = dofs(model, joints)
    tables = []
    for _, at, states in replay.along(change, problem.fitted):
        q = np.stack([at.position[joint][at.samples] for joint in joints], axis=1)
        v = np.stack([at.velocity[joint][at.samples] for joint in joints], axis=1)
        found = lacking_forces(change, at, states, replay.half).lacking[:, own]
        tables.append((q, v, accelerations(replay.machine, model, at, replay.half)[:, own], found))
    joined = [np.concatenate(parts) for parts in zip(*tables, strict=True)]
    return {joint: ForceLeft(*(x[:, i] for x in joined)) for i, joint in enumerate(joints)}
