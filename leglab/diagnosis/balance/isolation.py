"""Localisation of model errors: in mechanism or hydraulics, and at which joint or cylinder."""

import numpy as np

from leglab.base.scale import rms
from leglab.diagnosis.balance.balances import Balance, balances
from leglab.diagnosis.balance.regions import worst_region
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.effects.joints import joint_unit
from leglab.diagnosis.replay.residual import Problem, inverse_roots, whitened
from leglab.diagnosis.result import Where


def isolate(problem: Problem) -> tuple[Where, ...]:
    """Returns where the original model disagrees with the measured motion, largest first.

    All inputs of a balance of forces or oil are measured, so valve faults do not affect mechanical
    residuals, nor mechanical faults hydraulic ones. Residuals are in multiples of their noise.
    Without measured pressures, errors of the simulated motion of each joint are returned instead.
    """
    along = balances(problem, Hypothesis())
    if any(balance.oil for balance in along):
        found = [_of_balance(problem, balance) for balance in along]
    else:
        found = _motion(problem)
    return tuple(sorted(found, key=lambda where: -where.level))


def _of_balance(problem: Problem, balance: Balance) -> Where:
    """Returns a balance's residual relative to its noise, estimated from second differences."""
    rest = balance.lacking
    noise = float(np.median(np.abs(np.diff(rest, 2, axis=1)))) / np.sqrt(6.0)
    length = "m" if balance.oil else problem.machine.unit(balance.joint)
    force = "N" if balance.oil else joint_unit(problem.machine, balance.joint, "{force}")
    units = {"position": length, "velocity": f"{length}/s", "load": force, "command": ""}
    states = {name: (values.ravel(), units[name]) for name, values in balance.inputs.items()}
    return Where(
        residual="hydraulic" if balance.oil else "mechanical",
        element=balance.element,
        level=float(np.median(np.abs(rest))) / noise if noise > 0.0 else 0.0,
        region=worst_region(rest.ravel(), states),
    )


def _motion(problem: Problem) -> list[Where]:
    """Returns the errors of the original model's replayed motion, by joint."""
    replay, limit = problem.replay, problem.thresholds.clip
    errors, every = problem.raw_errors(Hypothesis()), np.ones(replay.windows, dtype=bool)
    found = []
    for k, channel in enumerate(problem.channels):
        if channel.chamber:
            continue
        own = [bin_motion(problem, i, channel.joint) for i in range(len(problem.series))]
        _, position, velocity = (np.concatenate(part) for part in zip(*own, strict=True))
        length = problem.machine.unit(channel.joint)
        states = {"position": (position, length), "velocity": (velocity, f"{length}/s")}
        region = worst_region(errors[:, k].ravel(), states)
        # Errors are whitened as in reports (with uncertain start states), but for one joint only.
        block = slice(k * replay.bins, (k + 1) * replay.bins)
        roots = inverse_roots(problem.noise.covariance(every, block))
        white = np.clip(whitened(roots, errors[:, k]), -limit, limit)
        level = float(rms(white))
        found.append(Where(residual="motion", element=channel.joint, level=level, region=region))
    return found


def bin_motion(
    problem: Problem, recording: int, joint: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the motion of a joint in the middle of every bin of a recording's windows.

    Returns sample indices, positions and velocities, each (bins of all windows,).
    """
    replay, series = problem.replay, problem.series[recording]
    middle = (np.arange(replay.bins) + 0.5) * (replay.samples // replay.bins)
    start = replay.start[replay.recording == recording]
    first = np.round((start - series.time[0]) / series.period)
    index = np.minimum((first[:, None] + middle).astype(int), series.time.size - 1).ravel()
    q = series.columns[f"{joint}_position"]
    return index, q[index], np.gradient(q, series.period)[index]
