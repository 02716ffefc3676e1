"""Structural isolation: does the mechanism disagree, or the hydraulics, and where."""

from collections.abc import Mapping

import mujoco
import numpy as np
from scipy.interpolate import BSpline

from leglab.diagnosis.balance.regions import worst_region
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.effects.joints import unit
from leglab.diagnosis.plant.model import CYLINDER
from leglab.diagnosis.replay.residual import Problem, inverse_roots, whitened
from leglab.diagnosis.replay.starts import spool
from leglab.diagnosis.replay.windows import UniformSeries, derivative, smoothed
from leglab.diagnosis.result import Where
from leglab.diagnosis.thresholds import Thresholds
from leglab.machine.cylinder import Cylinder
from leglab.machine.parameters import State
from leglab.machine.simulation import actuator_moments


def isolate(problem: Problem) -> tuple[tuple[Where, ...], float | None]:
    """Balances of torque and of oil along the measured motion, each with measured inputs only.

    Torque: M a + bias - passive against pressures times areas times lever less seal friction. Oil:
    measured rates of pressure against those of the chambers at the measured motion and command.
    So a valve fault does not light the mechanism, and a mechanical one does not light the valve.

    Returns:
        Residuals, worst first, in levels of their own noise; and the ceiling: share of the worst
        residual's excess variance that static functions of position, velocity, pressure
        difference and command could explain. Where no pressures were measured there are no
        balances: the residuals are the errors of the replayed motion, joint by joint, and the
        ceiling is None.
    """
    machine = problem.machine
    names = {c.column for c in problem.channels}
    found: list[tuple[Where, float]] = []
    for cylinder in machine.instances(CYLINDER):
        joint = machine.driven[cylinder][0]
        if not {f"{joint}_pressure_a", f"{joint}_pressure_b"} <= names:
            continue
        tables = [_balances(problem, one, cylinder, joint) for one in problem.series]
        table = {key: np.concatenate([t[key] for t in tables]) for key in tables[0]}
        regressors = {k: table[k] for k in ("position", "velocity", "pressure", "command")}
        for kind, element in (("mechanical", joint), ("hydraulic", cylinder)):
            noise = float(np.median([_noise(t[kind]) for t in tables]))
            residual = table[kind]
            level = 1.4826 * float(np.median(np.abs(residual))) / noise if noise > 0 else 0.0
            region = worst_region(residual, _with_units(problem, joint, regressors))
            where = Where(residual=kind, element=element, level=level, region=region)
            found.append((where, _static_share(residual, regressors, noise, problem.thresholds)))
    if not found:
        return _motion(problem), None
    found.sort(key=lambda entry: -entry[0].level)
    return tuple(w for w, _ in found), found[0][1]


def _motion(problem: Problem) -> tuple[Where, ...]:
    """Errors of the replayed motion of every joint, worst first, of the model as it was."""
    replay = problem.replay
    errors = problem.raw_errors(Hypothesis())
    places = sample_places(problem)
    limit = problem.thresholds.clip
    found = []
    for k, channel in enumerate(problem.channels):
        if channel.chamber:
            continue
        states: dict[str, list[np.ndarray]] = {"position": [], "velocity": []}
        rows = []
        for i, series in enumerate(problem.series):
            own = replay.recording == i
            q = series.columns[f"{channel.joint}_position"]
            states["position"].append(q[places[i]])
            states["velocity"].append(np.gradient(q, series.period)[places[i]])
            rows.append(errors[own, k].ravel())
        error = np.concatenate(rows)
        along = {name: np.concatenate(values) for name, values in states.items()}
        # In the noise levels of the gap, with what the start states carry on, whatever the other
        # joints do.
        block = slice(k * replay.bins, (k + 1) * replay.bins)
        roots = inverse_roots(problem.noise.covariance[:, block, block])
        white = np.clip(whitened(roots, errors[:, k]), -limit, limit)
        level = float(np.sqrt(np.mean(white**2)))
        region = worst_region(error, _with_units(problem, channel.joint, along))
        found.append(Where(residual="motion", element=channel.joint, level=level, region=region))
    return tuple(sorted(found, key=lambda where: -where.level))


def sample_places(problem: Problem) -> list[np.ndarray]:
    """Index of the sample in the middle of every bin of the windows, by recording."""
    replay = problem.replay
    middle = (np.arange(replay.bins) + 0.5) * (replay.samples // replay.bins)
    found = []
    for i, series in enumerate(problem.series):
        start = replay.start[replay.recording == i]
        first = np.round((start - series.time[0]) / series.period)
        index = (first[:, None] + middle).astype(int)
        found.append(np.minimum(index, series.time.size - 1).ravel())
    return found


def _with_units(
    problem: Problem, joint: str, states: Mapping[str, np.ndarray]
) -> dict[str, tuple[np.ndarray, str]]:
    """States by name with the units in which they are shown."""
    length = unit(problem.machine, joint)
    known = {
        "position": (1.0, length),
        "velocity": (1.0, f"{length}/s"),
        "pressure": (1e-5, "bar"),
        "command": (1.0, ""),
    }
    return {name: (known[name][0] * values, known[name][1]) for name, values in states.items()}


def _balances(
    problem: Problem, series: UniformSeries, cylinder: str, joint: str
) -> dict[str, np.ndarray]:
    """Torque and pressure-rate residuals and what they may depend on, each (samples,)."""
    machine, period = problem.machine, series.period
    filters = {c.column: c.filter for c in problem.channels}
    raw = {name: series.columns[name] for name in filters}
    smooth = {name: smoothed(x, filters[name]) for name, x in raw.items()}
    q_name = f"{joint}_position"
    wide = (2 * filters[q_name][0] + 1, 4)
    stride = max(1, round(problem.thresholds.balance_stride / period))
    at = np.arange(wide[0], series.time.size - wide[0], stride)
    values = {
        name: machine.parameter(cylinder, name)
        for name, entry in machine.base.elements[cylinder][1].parameters.items()
        if not isinstance(entry, State)
    }
    model = Cylinder(values)
    command = np.clip(series.columns[f"{cylinder}_command"], -1.0, 1.0)
    moved = spool(
        np.clip(command + values["null_bias"], -1.0, 1.0),
        2.0 * np.pi * values["bandwidth_hz"],
        values["damping_ratio"],
        period,
    )
    mj = machine.base.model
    data = mujoco.MjData(mj)
    dof = int(mj.joint(joint).dofadr[0])
    actuator = mj.actuator(cylinder).id
    motion = {}
    for name in machine.joints:
        x = raw[f"{name}_position"]
        speed = derivative(x, wide, period)
        motion[name] = smoothed(x, wide), speed, np.gradient(speed, period)
    slope = filters[q_name][0], 2
    rates = [derivative(smooth[f"{joint}_pressure_{c}"], slope, period) for c in "ab"]
    out = {k: np.empty(at.size) for k in ("mechanical", "hydraulic")}
    for i, k in enumerate(at.tolist()):
        for name, (q, v, a) in motion.items():
            j = mj.joint(name)
            data.qpos[j.qposadr[0]] = q[k]
            data.qvel[j.dofadr[0]], data.qacc[j.dofadr[0]] = v[k], a[k]
        mujoco.mj_inverse(mj, data)
        lever = actuator_moments(mj, data)[actuator, dof]
        speed = lever * motion[joint][1][k]
        pa, pb = smooth[f"{joint}_pressure_a"][k], smooth[f"{joint}_pressure_b"][k]
        friction = model.native.steady_friction(speed, pa, pb)
        force = pa * model.area_a - pb * model.area_b - friction
        out["mechanical"][i] = data.qfrc_inverse[dof] - lever * force
        x = 0.5 * values["stroke"] + data.actuator_length[actuator] - values["mid_length"]
        state = model.initial_state(
            position=x,
            velocity=speed,
            spool_position=moved[k, 0],
            spool_velocity=moved[k, 1],
            pressure_a=pa,
            pressure_b=pb,
        )
        rate = model.derivative(state, command=float(command[k]))
        out["hydraulic"][i] = (rates[0][k] - rate[4]) - (rates[1][k] - rate[5])
    q, v, _ = motion[joint]
    difference = smooth[f"{joint}_pressure_a"] - smooth[f"{joint}_pressure_b"]
    along = {"position": q, "velocity": v, "pressure": difference, "command": command}
    return out | {name: values[at] for name, values in along.items()}


def _noise(residual: np.ndarray) -> float:
    """Level of white noise from second differences, whose variance is six times the noise's."""
    if residual.size < 5:
        return 0.0
    return float(1.4826 * np.median(np.abs(np.diff(residual, 2))) / np.sqrt(6.0))


def _static_share(
    residual: np.ndarray, regressors: Mapping[str, np.ndarray], noise: float, thresholds: Thresholds
) -> float:
    """Share of the excess variance that additive cubic B-splines of the regressors explain."""
    columns = [np.ones((residual.size, 1))]
    for values in regressors.values():
        low, high = np.quantile(values, [0.01, 0.99])
        inner = np.linspace(low, high, thresholds.balance_knots)
        knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
        columns.append(BSpline.design_matrix(np.clip(values, low, high), knots, 3).toarray()[:, 1:])
    design = np.concatenate(columns, axis=1)
    even = np.arange(residual.size) // 20 % 2 == 0  # blocks, so that neighbours do not help
    inner_product = design[even].T @ design[even]
    inner_product[np.diag_indices_from(inner_product)] *= 1.0 + thresholds.balance_ridge
    inner_product[np.diag_indices_from(inner_product)] += 1e-9
    weights = np.linalg.solve(inner_product, design[even].T @ residual[even])
    rest = residual[~even] - design[~even] @ weights
    excess = float(np.mean(residual[~even] ** 2)) - noise**2
    if excess <= 0.2 * noise**2:
        return 0.0
    return float(np.clip(1.0 - (np.mean(rest**2) - noise**2) / excess, 0.0, 1.0))
