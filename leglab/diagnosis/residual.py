"""The fit problem: whitened replay errors of hypotheses, nuisance parameters under priors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_coeffs

from leglab.diagnosis.hypothesis import Hypothesis, Key, Library
from leglab.diagnosis.model import CYLINDER, Change, Machine
from leglab.diagnosis.replay import Layout, Replay
from leglab.diagnosis.starts import Nudge
from leglab.diagnosis.windows import Channel, Series, filter_difference, noise_level

# Start states are free within this many standard deviations of what smoothing leaves: a start
# that is a little off must not speak for or against an effect.
_LOOSE = 3.0
# Timing of sampling, hold and integrator: this share of a channel's change over a bin is not
# held against a model; of positions and of pressures.
_TIMING = (3e-4, 3e-3)
# Pressures that a replay before the window had to find are that uncertain.
_UNSEEN = 3e5  # Pa
# Bristles start within this share of their full deflection.
_BRISTLE = 0.3
# A chamber below this pressure holds vapour; from then on a window says nothing.
_VAPOUR = 2e4  # Pa gauge


class Whitening:
    """Turns replay errors into numbers of unit variance.

    The covariance of a window's errors is N + S P S': sensor noise of the bins, and start-state
    errors of covariance P carried on by the sensitivity S of the predictions, from replays with
    nudged starts.

    Args:
        replay: Gives windows and sensitivities.
        series: The recordings.
        change: About which sensitivities are taken.
        reference: Errors under `change`, shape (windows, channels, bins).

    Attributes:
        noise: Standard deviation of each channel's samples, by recording and channel.
    """

    def __init__(
        self, replay: Replay, series: Sequence[Series], change: Change, reference: np.ndarray
    ) -> None:
        channels, period = replay.channels, series[0].period
        self.noise = np.array(
            [[noise_level(s.columns[c.column], c.filter) for c in channels] for s in series]
        )
        floor = np.array([_resolution(series, c.column) for c in channels])
        self.noise = np.maximum(self.noise, floor)
        per_bin = replay.samples // replay.bins
        sigma = self.noise[replay.recording]  # (windows, channels)
        measured = replay.measured()
        binned = measured[:, :, 1:].reshape(*measured.shape[:2], replay.bins, per_bin).mean(axis=3)
        change_over_bin = np.abs(np.gradient(binned, axis=2)) if replay.bins > 1 else 0.0 * binned
        timing = np.array([_TIMING[bool(c.chamber)] for c in channels])[:, None]
        variance = (sigma**2 / per_bin)[:, :, None] + (timing * change_over_bin) ** 2
        for chamber in [k for k, c in enumerate(channels) if c.chamber]:
            vapour = np.minimum.accumulate(binned[:, chamber], axis=1) < _VAPOUR
            variance[np.broadcast_to(vapour[:, None], variance.shape)] *= 1e8
        size = len(channels) * replay.bins
        covariance = np.zeros((replay.windows, size, size))
        diagonal = np.arange(size)
        covariance[:, diagonal, diagonal] = variance.reshape(replay.windows, size)
        for nudge, spread in _nudges(replay, series, self.noise, period):
            moved = replay.error(change, nudge=nudge) - reference
            direction = moved.reshape(replay.windows, size) * (spread / nudge.size)[:, None]
            covariance += direction[:, :, None] * direction[:, None, :]
        # Applied hundreds of times: a product of all windows at once beats triangular solves.
        self._whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        self.shape = (len(channels), replay.bins)

    def __call__(self, errors: np.ndarray, chosen: np.ndarray | None = None) -> np.ndarray:
        """Whitened errors, shape (chosen windows, channels x bins)."""
        whiten = self._whiten if chosen is None else self._whiten[chosen]
        return (whiten @ errors.reshape(len(errors), -1, 1))[:, :, 0]


def _resolution(series: Sequence[Series], column: str) -> float:
    """Rounding error of a quantised column: its smallest step over sqrt(12)."""
    steps = [np.abs(np.diff(s.columns[column])) for s in series]
    steps = [s[s > 0].min() for s in steps if (s > 0).any()]
    return float(min(steps)) / np.sqrt(12.0) if steps else 0.0


def _nudges(
    replay: Replay, series: Sequence[Series], noise: np.ndarray, period: float
) -> list[tuple[Nudge, np.ndarray]]:
    """Nudges and the spread of each start state, shape (windows,)."""
    found = []
    machine = replay.machine
    for k, channel in enumerate(replay.channels):
        sigma = noise[replay.recording, k]
        length, order = channel.filter
        kernel = float(np.sqrt((savgol_coeffs(length, order) ** 2).sum()))
        # What another filter makes of the same samples tells where smoothing is biased.
        rough = replay.at_starts(
            [filter_difference(s.columns[channel.column], channel.filter) for s in series]
        )
        spread = _LOOSE * np.hypot(kernel * sigma, rough)
        if channel.chamber and channel.cylinder:
            nudge = Nudge(cylinder=channel.cylinder, quantity=channel.chamber, size=2e4)
            found.append((nudge, spread))
            continue
        size = float(np.median(spread))
        found.append((Nudge(joint=channel.joint, quantity="position", size=size), spread))
        rate = savgol_coeffs(*channel.filter, deriv=1, delta=period)
        rough = replay.at_starts(
            [filter_difference(s.columns[channel.column], channel.filter, period) for s in series]
        )
        spread = _LOOSE * np.hypot(float(np.sqrt((rate**2).sum())) * sigma, rough)
        size = float(np.median(spread))
        found.append((Nudge(joint=channel.joint, quantity="velocity", size=size), spread))
    for cylinder in machine.instances(CYLINDER):
        for chamber in ("pressure_a", "pressure_b") if replay.blind else ():
            nudge = Nudge(cylinder=cylinder, quantity=chamber, size=1e5)
            found.append((nudge, np.full(replay.windows, _UNSEEN)))
        stiffness = machine.parameter(cylinder, "sigma_0")
        if stiffness > 0.0:
            size = _BRISTLE * machine.parameter(cylinder, "static") / stiffness
            spread = np.full(replay.windows, size)
            found.append((Nudge(cylinder=cylinder, quantity="bristle", size=size), spread))
    return found


# A window whose mean square exceeds this counts by its logarithm only: one window that starts in
# a bad moment must not outvote a hundred others.
_ROBUST = 3.0
_CLIP = 1e5


@dataclass(frozen=True, kw_only=True)
class Nuisance:
    """One parameter that differs between good machines.

    Attributes:
        key: Effect and element it belongs to.
        index: Its place among the effect's parameters.
        nominal: Expected value.
        tolerance: Prior standard deviation.
    """

    key: Key
    index: int
    nominal: float
    tolerance: float


def robust_cost(mean_square: np.ndarray) -> np.ndarray:
    """Cost of windows by their mean square c: c, beyond a limit its logarithm, shape as given."""
    beyond = _ROBUST * (1.0 + np.log(np.maximum(mean_square, _ROBUST) / _ROBUST))
    return np.where(mean_square <= _ROBUST, mean_square, beyond)


def robust_weight(mean_square: np.ndarray) -> np.ndarray:
    """Derivative of `robust_cost`: weights of windows in a least-squares step."""
    return _ROBUST / np.maximum(mean_square, _ROBUST)


class Problem:
    """Recordings and machine as a least-squares problem.

    Args:
        machine: The unmodified machine at the replay's time step.
        library: Its effects.
        series: The recordings.
        channels: What is predicted.
        layout: How recordings are cut.
        fit: Indices of the recordings that are fitted; the others are held out.
        threads: Of the rollouts.

    Attributes:
        replay: The windows.
        nuisances: Parameters with a tolerance.
        fitted: Mask of windows that are fitted, shape (windows,).
        held: Mask of windows that are held out.
        size: Numbers in a whitened window.
    """

    def __init__(
        self,
        machine: Machine,
        library: Library,
        series: list[Series],
        channels: tuple[Channel, ...],
        layout: Layout,
        fit: Sequence[int],
        *,
        threads: int = 2,
    ) -> None:
        self.machine, self.library = machine, library
        self.series, self.channels = series, channels
        self.replay = Replay(machine, series, channels, layout, threads=threads)
        fine = Replay(
            machine.at_timestep(0.5 * machine.timestep), series, channels, layout, threads=threads
        )
        nominal = self.replay.error(Change(machine))
        # Errors of the time step, of second order, are taken off: with half the step a third
        # of the difference is left (Richardson).
        self._defect = (fine.error(Change(fine.machine)) - nominal) * (4.0 / 3.0)
        self._fine = fine
        self._whiten = Whitening(self.replay, series, Change(machine), nominal)
        self.size = self._whiten.shape[0] * self._whiten.shape[1]
        self.fitted = np.isin(self.replay.recording, list(fit))
        self.held = ~self.fitted
        self.nuisances = tuple(
            Nuisance(key=key, index=i, nominal=p.nominal, tolerance=p.tolerance)
            for key, site in library.sites.items()
            for i, p in enumerate(site.parameters)
            if p.tolerance > 0.0
        )

    def residual(self, hypothesis: Hypothesis, chosen: np.ndarray | None = None) -> np.ndarray:
        """Whitened errors, shape (chosen windows, size); 0 in windows where an effect begins."""
        errors, certain = self._errors(self.replay, hypothesis, chosen)
        defect = self._defect if chosen is None else self._defect[chosen]
        white = self._whiten((errors + defect) * certain[:, None, None], chosen)
        return np.clip(white, -_CLIP, _CLIP)

    def _errors(
        self, replay: Replay, hypothesis: Hypothesis, chosen: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Errors of the chosen windows; and 0 for windows in which an effect begins, else 1."""
        if not hypothesis.onsets:
            change = self.library.change(hypothesis, replay.machine)
            errors = replay.error(change, chosen=chosen) / replay.noise_gain[:, None]
            return errors, np.ones(len(errors))
        chosen = np.ones(replay.windows, dtype=bool) if chosen is None else chosen
        length = self.replay.layout.window
        keys = sorted(hypothesis.onsets)
        begins = np.stack([hypothesis.onsets[k][replay.recording] for k in keys])
        active = begins <= replay.start
        begun = (begins > replay.start) & (begins < replay.start + length)
        certain = np.asarray(~begun.any(axis=0))
        codes = (active * (1 << np.arange(len(keys)))[:, None]).sum(axis=0)
        out = np.zeros((replay.windows, len(self.channels), replay.bins))
        for code in np.unique(codes[chosen]):
            group = chosen & (codes == code)
            absent = [k for i, k in enumerate(keys) if not code >> i & 1]
            change = self.library.change(hypothesis.without(*absent), replay.machine)
            out[group] = replay.error(change, chosen=group) / replay.noise_gain[:, None]
        return out[chosen], certain[chosen].astype(float)

    def raw_errors(self, hypothesis: Hypothesis) -> np.ndarray:
        """Measured less predicted in SI units, shape (windows, channels, bins)."""
        return self._errors(self.replay, hypothesis, None)[0] + self._defect

    def rewhiten(self, hypothesis: Hypothesis) -> None:
        """Takes sensitivities to start states and time step anew, about a hypothesis."""
        errors, _ = self._errors(self.replay, hypothesis, None)
        fine, _ = self._errors(self._fine, hypothesis, None)
        self._defect = (fine - errors) * (4.0 / 3.0)
        change = self.library.change(hypothesis, self.machine)
        reference = self.replay.error(change)
        self._whiten = Whitening(self.replay, self.series, change, reference)

    @property
    def noise(self) -> np.ndarray:
        """Standard deviation of the sensors' noise, (recordings, channels)."""
        return self._whiten.noise

    def active_nuisances(self, free: set[Key]) -> tuple[Nuisance, ...]:
        """Nuisances but those of effects that are fitted freely."""
        return tuple(n for n in self.nuisances if n.key not in free)

    def prior_cost(self, hypothesis: Mapping[Key, np.ndarray], free: set[Key]) -> float:
        """Sum of squared departures of the nuisances in tolerances."""
        total = 0.0
        for n in self.active_nuisances(free):
            if n.key in hypothesis:
                total += ((hypothesis[n.key][n.index] - n.nominal) / n.tolerance) ** 2
        return total

    def cost(self, residual: np.ndarray, prior: float = 0.0) -> float:
        """Robust chi-square of whitened errors plus the prior's."""
        return float(self.size * robust_cost(np.mean(residual**2, axis=1)).sum()) + prior

    def moved(
        self, hypothesis: Hypothesis, nuisances: Sequence[Nuisance], values: np.ndarray
    ) -> Hypothesis:
        """The hypothesis with nuisances at values, clipped to the bounds of their parameters."""
        for n, value in zip(nuisances, values, strict=True):
            site = self.library.sites[n.key]
            now = hypothesis.get(n.key, site.nominal).copy()
            now[n.index] = np.clip(value, site.lower[n.index], site.upper[n.index])
            hypothesis = hypothesis.with_values(n.key, now)
        return hypothesis

    def nuisance_values(
        self, hypothesis: Mapping[Key, np.ndarray], nuisances: Sequence[Nuisance]
    ) -> np.ndarray:
        """Present values of nuisances, shape (nuisances,)."""
        return np.array(
            [hypothesis[n.key][n.index] if n.key in hypothesis else n.nominal for n in nuisances]
        )

    def tangents(
        self,
        hypothesis: Hypothesis,
        residual: np.ndarray,
        chosen: np.ndarray,
        nuisances: Sequence[Nuisance],
        share: float = 0.5,
    ) -> np.ndarray:
        """d(residual)/d(nuisance in tolerances), shape (chosen windows, size, nuisances).

        By differences over a share of the tolerance.
        """
        columns = []
        values = self.nuisance_values(hypothesis, nuisances)
        for i, n in enumerate(nuisances):
            site = self.library.sites[n.key]
            step = share * n.tolerance
            if values[i] + step > site.upper[n.index]:
                step = -step
            trial = values.copy()
            trial[i] += step
            moved = self.residual(self.moved(hypothesis, nuisances, trial), chosen)
            columns.append((moved - residual) * (n.tolerance / step))
        if not columns:
            return np.zeros((*residual.shape, 0))
        return np.stack(columns, axis=2)
