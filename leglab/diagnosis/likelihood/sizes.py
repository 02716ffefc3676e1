"""Scales of effect parameters from recorded motions and forces, by the parameters' units.

A machine of a hundred times the inertia has faults of a hundred times the magnitude.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from leglab.base.scale import rms
from leglab.diagnosis.effects.base import EffectParameter
from leglab.diagnosis.effects.command import position_servos
from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.effects.spring import rest_position
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.plant.moments import accelerations, commands_at, dofs, forces_at
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.thresholds import KINDS_OF_FORCE, LONGEST_DELAY, TOP_QUANTILE, TRIALS


@dataclass(frozen=True)
class Motion:
    """Largest recorded values of a joint."""

    position: float  #: Half the range of the joint's positions [rad or m]
    deflection: float  #: Distance from the rest position, with or without spring [rad or m]
    velocity: float  #: [rad/s or m/s]
    acceleration: float  #: [rad/s^2 or m/s^2]
    force: float  #: Force of drive, gravity and other bias, or inertia [N m or N]

    def of_unit(self, unit: str) -> float:
        """Returns the recorded magnitude of the quantity of a unit; 0 for all other units."""
        q, y = max(self.position, 1e-12), max(self.deflection, 1e-12)
        v, a = max(self.velocity, 1e-12), max(self.acceleration, 1e-12)
        f = self.force
        for of_hinge, of_slide in (("N m", "N"), ("kg m^2", "kg"), ("rad", "m")):
            unit = unit.replace(of_hinge, of_slide)
        return {
            "N": f,
            "N s/m": f / v,
            "N s^2/m^2": f / v**2,
            "kg": f / a,
            "N/m": f / y,
            "N/m^3": f / y**3,
            "m": q,
            "m/s": v,
            "m/(N)": q / f if f else 0.0,
        }.get(unit, 0.0)


@dataclass(frozen=True)
class Shown:
    """Largest quantities in recordings."""

    joints: Mapping[str, Motion]  #: Largest recorded values, by joint
    #: Half the range of each actuator's input, by actuator. The input is the command, or for a
    #: position servo its position error.
    commands: Mapping[str, float]
    #: Largest command by ("command", actuator), and largest drive force by ("force", joint).
    largest: Mapping[tuple[str, str], float]
    period: float  #: Sampling period [s]
    change: float  #: Shortest time in which a command changes by its rms, rms u / rms du/dt [s]
    correlation: float  #: Longest time at which a command's autocorrelation falls to a half [s]

    def or_larger(self, other: "Shown") -> "Shown":
        """Returns the larger quantities of two sets of recordings, and the shorter `change`."""
        joints = {
            joint: Motion(*map(max, astuple(own), astuple(other.joints[joint])))
            for joint, own in self.joints.items()
        }
        commands = {a: max(own, other.commands[a]) for a, own in self.commands.items()}
        largest = {of: max(own, other.largest[of]) for of, own in self.largest.items()}
        period, change = max(self.period, other.period), min(self.change, other.change)
        correlation = max(self.correlation, other.correlation)
        return Shown(joints, commands, largest, period, change, correlation)


def shown(problem: Problem) -> Shown:
    """Computes the largest quantities in the fitted recordings of a problem."""
    replay, machine = problem.replay, problem.machine
    change = problem.library.change(Hypothesis(), replay.machine)
    model = change.variant.model
    rows: dict[str, list[np.ndarray]] = {j: [] for j in machine.joints}
    commands: dict[str, list[np.ndarray]] = {a: [] for a in machine.actuators}
    errors: dict[str, list[np.ndarray]] = {a: [] for a in position_servos(machine)}
    # Largest command of all recordings: commands are inputs, so they are known even of held-out
    # recordings. A limit at the largest command has no effect.
    largest = {
        ("command", a): max(float(np.abs(s.columns[f"{a}_command"]).max()) for s in problem.series)
        for a in machine.actuators
    }
    longest = 0.0
    for _, measured, states in replay.along(change, problem.fitted):
        samples = measured.samples
        slope = accelerations(machine, model, measured, replay.half)
        found = forces_at(model, states, commands_at(machine, measured, samples))
        inertia = np.abs(np.einsum("nij,nj->ni", found.inertia, slope))
        for j, d in zip(machine.joints, dofs(model, machine.joints), strict=True):
            q, v = measured.position[j][samples], measured.velocity[j][samples]
            drive = np.abs(found.load[:, d])
            largest["force", j] = max(largest.get(("force", j), 0.0), float(drive.max(initial=0.0)))
            force = np.maximum(drive, np.abs(found.bias[:, d]))
            force = np.maximum(force, inertia[:, d])
            bent = q - rest_position(machine, j)
            rows[j].append(np.stack([q, bent, v, slope[:, d], force], axis=1))
        for a in machine.actuators:
            commands[a].append(measured.command[a])
            longest = max(longest, correlation_time(measured.command[a], measured.period))
        for a, rest in errors.items():
            gear = float(model.actuator(a).gear[0])
            rest.append(measured.command[a] - gear * measured.position[machine.driven[a][0]])
    joints = {}
    for j, parts in rows.items():
        x = np.concatenate(parts)
        ends = np.quantile(x[:, 0], [1.0 - TOP_QUANTILE, TOP_QUANTILE])
        tops = (float(np.quantile(np.abs(x[:, k]), TOP_QUANTILE)) for k in (1, 2, 3, 4))
        joints[j] = Motion(0.5 * float(np.ptp(ends)), *tops)
    half = {
        a: 0.5 * float(np.ptp(np.quantile(np.concatenate(c), [1.0 - TOP_QUANTILE, TOP_QUANTILE])))
        for a, c in (commands | errors).items()
    }
    period = problem.series[0].period
    shortest = min((change_time(c, period) for c in commands.values()), default=0.0)
    return Shown(joints, half, largest, period, shortest, longest)


def change_time(parts: Sequence[np.ndarray], period: float) -> float:
    """Computes the time in which a command changes by its rms, rms u / rms du/dt [s]."""
    size = np.concatenate([u - u.mean() for u in parts])
    rate = np.concatenate([np.diff(u) / period for u in parts])
    return float(np.std(size) / rms(rate)) if rate.any() else 0.0


def correlation_time(x: np.ndarray, period: float) -> float:
    """Computes the lag at which the autocorrelation first falls below a half [s]."""
    x = x - x.mean()
    if not x.any():
        return 0.0
    length = 1 << (2 * x.size - 1).bit_length()
    c = np.fft.irfft(np.abs(np.fft.rfft(x, length)) ** 2, length)[: x.size]
    below = np.flatnonzero(c < 0.5 * c[0])
    return float((below[0] if below.size else x.size) * period)


def sized(library: Library, machine: Machine, seen: Shown) -> Library:
    """Returns the library with trial values and bounds scaled to the recorded quantities."""
    sites = {}
    for key, site in library.sites.items():
        joint = None if site.effect.on_bodies else seen.joints.get(site.element)
        command = seen.commands.get(site.element)
        parameters = tuple(
            _limited(p, seen.largest.get((p.limit_of, site.element), 0.0))
            if p.limit_of
            else _sized(p, _size(p, joint, command, seen), seen)
            for p in site.parameters
        )
        sites[key] = replace(site, parameters=parameters)
    return library.with_sites(sites)


def _limited(p: EffectParameter, largest: float) -> EffectParameter:
    """Returns a limit parameter with trial values below the largest recorded command or force."""
    most = min(p.nominal, largest)
    if most <= p.lower:
        return p  # no possible limit would cut off recorded values
    # The trial limits cut off a little, some or most of the largest recorded value.
    shares = (*(1.0 - share for share in TRIALS), *TRIALS[::-1])
    trials = tuple(most * share for share in shares if most * share > p.lower)
    return replace(p, nominal=most, upper=most, trials=trials or p.trials)


def _size(p: EffectParameter, joint: Motion | None, command: float | None, seen: Shown) -> float:
    if p.unit == "s":
        return seen.change
    if p.unit == "ctrl":
        return command or 0.0
    return joint.of_unit(p.unit) if joint else 0.0


def _sized(p: EffectParameter, size: float, seen: Shown) -> EffectParameter:
    """Scales bounds and trial values of a strength parameter to `size`, on its trials' sides."""
    if p.role == "shape" or size <= 0.0 or not p.trials:
        return p
    # A delay below two periods is no fault: a controller computes for up to a period and holds the
    # command for another. Logs do not show when in a period a command acts or a sensor is read.
    period = seen.period if p.unit == "s" else 0.0
    least = max(TRIALS[0] * size, 2.0 * period)
    steps = [least * t / TRIALS[0] for t in TRIALS]
    far = KINDS_OF_FORCE * size if p.unit.startswith(("N", "kg")) else size
    if p.unit == "s":
        far = min(max(seen.correlation, steps[-1]), LONGEST_DELAY)
        steps = sorted({*(t for t in steps if t < far), TRIALS[-1] * far})
    sides = [s for s in (-1.0, 1.0) if any((t - p.nominal) * s > 0.0 for t in p.trials)]
    lower = p.nominal - far if p.lower < p.nominal else p.lower
    if p.lower >= 0.0:
        lower = p.lower  # a physical bound stays
    upper = p.nominal + far if p.upper > p.nominal else p.upper
    if p.unit in ("rad", "m"):  # zeros and rest positions lie anywhere in the joint's travel
        lower, upper = min(lower, p.lower), max(upper, p.upper)
    trials = [p.nominal + s * t for s in sides for t in steps]
    if p.lower >= 0.0 and p.nominal > 0.0:
        trials = [t for t in trials if t >= p.lower] + [0.5 * p.nominal]
        if abs(0.5 * p.nominal) < least:
            trials.pop()
    trials = sorted(t for t in trials if lower <= t <= upper and t != p.nominal)
    if not trials:
        return p
    # Good controllers' delays differ by up to a period, since they compute and hold commands.
    tolerance = max(p.tolerance, period / math.sqrt(3.0))
    return replace(p, lower=lower, upper=upper, trials=tuple(trials), tolerance=tolerance)
