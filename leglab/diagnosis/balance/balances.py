"""Balances of force and of oil along the measured motion: what the model lacks at every moment.

Integral form: the measured momentum gained over a window against the impulses of all modelled
forces, and the pressure gained against the modelled flows. Nothing is differentiated but over the
length of a window, so that noise of sensors hardly counts.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.plant.model import CHAMBERS, CYLINDER, Change, Measured
from leglab.diagnosis.plant.moments import plugin_offset
from leglab.diagnosis.replay.lacking import balanced_joints, lacking_forces
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.replay.starts import measure, start_states
from leglab.diagnosis.replay.windows import Cut
from leglab.machine.cylinder import Cylinder
from leglab.machine.parameters import RESIDUAL_VARIABLES, State

# Time between samples of a balance [s], and length of the windows over which it is integrated.
_STRIDE = 0.005
_WINDOW = 0.04
# Step of the spool [1] for the gain of an oil balance.
_SPOOL_STEP = 0.01
# A joint slower than this share of its usual speed rests: its friction is anything up to a limit.
_RESTING = 0.03


@dataclass(frozen=True, kw_only=True, eq=False)
class Balance:
    """What the model lacks in one joint's balance of forces, or one cylinder's of oil.

    Samples lie in rows of windows, (windows, samples), or are sums of windows, (windows,).

    Attributes:
        element: Joint or cylinder.
        joint: Whose motion it is.
        actuator: Whose command the inputs have; empty where nothing drives the joint.
        oil: Whether it is an oil balance.
        lacking: Force [N m or N], or rate of pressure A less B [Pa/s], (windows,).
        gain: d(lacking)/d(what is learned), (windows, samples): 1 for a force, rate of pressure an
            opening of the valve.
        inputs: By variable, each (windows, samples).
        moving: Share of every window in which the joint moves, (windows,).
        recording: Number of the recording, (windows,).
        time: s, in the middle of windows, (windows,).
    """

    element: str
    joint: str
    actuator: str
    oil: bool
    lacking: np.ndarray
    gain: np.ndarray
    inputs: dict[str, np.ndarray]
    moving: np.ndarray
    recording: np.ndarray
    time: np.ndarray

    def of(self, mask: np.ndarray) -> "Balance":
        """Some of the windows."""
        return replace(
            self,
            lacking=self.lacking[mask],
            gain=self.gain[mask],
            inputs={k: v[mask] for k, v in self.inputs.items()},
            moving=self.moving[mask],
            recording=self.recording[mask],
            time=self.time[mask],
        )


def balances(problem: Problem, hypothesis: Hypothesis) -> tuple[Balance, ...]:
    """Balances of all joints and cylinders whose actuators' forces can be known.

    Cylinders without measured pressures, and the joints that they move, have none.
    """
    machine = problem.machine
    change = problem.library.change(hypothesis, machine)
    known = balanced_joints(machine, problem.channels)
    found: dict[tuple[str, bool], list[Balance]] = {}
    for number, cut in enumerate(problem.replay.cuts):
        for one in _of_series(problem, change, cut, number, known):
            found.setdefault((one.element, one.oil), []).append(one)
    return tuple(_joined(parts) for parts in found.values())


def _joined(parts: list[Balance]) -> Balance:
    first = parts[0]
    moving = np.concatenate([p.moving for p in parts])
    return replace(
        first,
        lacking=np.concatenate([p.lacking for p in parts]),
        gain=np.concatenate([p.gain for p in parts]),
        inputs={k: np.concatenate([p.inputs[k] for p in parts]) for k in first.inputs},
        moving=moving,
        recording=np.concatenate([p.recording for p in parts]),
        time=np.concatenate([p.time for p in parts]),
    )


def _of_series(
    problem: Problem, change: Change, cut: Cut, number: int, known: Collection[str]
) -> Iterator[Balance]:
    machine, period = problem.machine, cut.series.period
    model = change.variant.model
    # Samples lie half a stride to both sides of an odd number of periods apart.
    half = max(1, round(0.5 * _STRIDE / period))
    stride, per_window = 2 * half, max(2, round(_WINDOW / _STRIDE))
    margin = max(c.filter[0] for c in problem.channels) + half
    valid = cut.series.valid
    starts = np.arange(margin, valid.size - margin - stride * per_window, stride * per_window)
    rows = starts[:, None] + half + stride * np.arange(per_window)
    gaps = np.concatenate([[0], np.cumsum(~valid)])
    rows = rows[gaps[rows[:, -1] + margin] == gaps[np.maximum(rows[:, 0] - margin, 0)]]
    if not rows.size:
        return
    measured, _ = measure(cut, problem.channels, change)
    flat = replace(measured, samples=rows.ravel())
    states = start_states(cut, change, flat, problem.channels, problem.replay.rest_time)
    found = lacking_forces(change, flat, states, half)
    shape = rows.shape
    common = {
        "recording": np.full(len(rows), number),
        "time": cut.series.time[rows].mean(axis=1),
    }
    for joint in machine.joints:
        if joint not in known:
            continue
        dof = int(model.joint(joint).dofadr[0])
        v = measured.velocity[joint]
        slow = _RESTING * float(np.sqrt(np.mean(v**2)))
        drive = next((a for a in machine.actuators if joint in machine.driven[a]), "")
        inputs = {
            "position": measured.position[joint][rows],
            "velocity": v[rows],
            "load": found.load[:, dof].reshape(shape),
        }
        if drive:
            inputs["command"] = measured.command[drive][rows]
        yield Balance(
            element=joint,
            joint=joint,
            actuator=drive,
            oil=False,
            lacking=found.lacking[:, dof].reshape(shape).mean(axis=1),
            gain=np.ones(shape),
            inputs=inputs,
            moving=(np.abs(v[rows]) > slow).mean(axis=1),
            **common,
        )
    for cylinder in machine.instances(CYLINDER):
        joint = machine.driven[cylinder][0]
        if joint not in known:
            continue
        index = model.actuator(cylinder).id
        at = {"length": found.length[:, index], "speed": found.speed[:, index]}
        lacking, gain = _oil(problem, change, flat, states, cylinder, at, half)
        values = {
            "position": at["length"],
            "velocity": at["speed"],
            "load": found.pull[:, index],
            "command": np.clip(measured.command[cylinder][flat.samples], -1.0, 1.0),
        }
        yield Balance(
            element=cylinder,
            joint=joint,
            actuator=cylinder,
            oil=True,
            lacking=lacking.reshape(shape).mean(axis=1),
            gain=gain.reshape(shape),
            inputs={name: values[name].reshape(shape) for name in RESIDUAL_VARIABLES},
            moving=np.ones(len(rows)),
            **common,
        )


def _oil(
    problem: Problem,
    change: Change,
    measured: Measured,
    states: np.ndarray,
    cylinder: str,
    at: dict[str, np.ndarray],
    half: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Rate of pressure A less B beyond the modelled one, and its gain by the spool, (samples,)."""
    joint = problem.machine.driven[cylinder][0]
    names = change.variant.elements[cylinder][1].parameters
    values = {
        name: change.parameter(cylinder, name)
        for name, entry in names.items()
        if not isinstance(entry, State)
    }
    model = Cylinder(values)
    k, period = measured.samples, measured.period
    a, b = (measured.pressure[f"{joint}_{chamber}"] for chamber in CHAMBERS)
    difference = a - b
    rate = (difference[k + half] - difference[k - half]) / (2 * half * period)
    plugin = plugin_offset(change.variant.model)
    spool = states[:, plugin + change.variant.slot(cylinder, "spool_position")]
    lacking, gain = np.empty(k.size), np.empty(k.size)
    for i, sample in enumerate(k.tolist()):
        state = {
            "position": 0.5 * values["stroke"] + at["length"][i] - values["mid_length"],
            "velocity": at["speed"][i],
            "pressure_a": a[sample],
            "pressure_b": b[sample],
        }
        x = float(np.clip(spool[i], -1.0 + _SPOOL_STEP, 1.0 - _SPOOL_STEP))
        rates = []
        for step in (-_SPOOL_STEP, 0.0, _SPOOL_STEP):
            full = model.initial_state(**state, spool_position=x + step)
            change_of = model.derivative(full, command=x)
            rates.append(change_of[4] - change_of[5])
        lacking[i] = rate[i] - rates[1]
        gain[i] = (rates[2] - rates[0]) / (2.0 * _SPOOL_STEP)
    return lacking, gain
