"""Recordings and machine as a least-squares problem: whitened errors and their noise model.

The errors are those of "replays": simulations of short windows from measured states.
"""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg.lapack import dtrtri
from scipy.signal import savgol_coeffs

from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.intake.series import UniformSeries
from leglab.diagnosis.plant.model import CHAMBERS, Change, Machine
from leglab.diagnosis.replay.lacking import balanced_joints
from leglab.diagnosis.replay.replay import Replay
from leglab.diagnosis.replay.starts import Nudge
from leglab.diagnosis.replay.windows import Channel, filter_difference
from leglab.diagnosis.thresholds import DEFAULT, EXPLAINED, EXPLANATION, ROOM, SMALL, Thresholds

# Relative increase of a covariance's diagonal, far above rounding errors: see `inverse_roots`.
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseModel:
    """Covariance of a correct model's replay errors, linearised at one hypothesis."""

    defect: np.ndarray  #: Errors at time step zero minus replay errors, (windows, channels, bins)
    #: Inverse Cholesky factors of the windows' covariances, which turn errors into numbers of unit
    #: variance, shape (windows, size, size).
    whitening: np.ndarray
    # `whitening` of the last chosen windows, by their mask, because hundreds of successive replays
    # use the same windows, and a copy of their factors takes as long as a replay of a leg.
    _chosen: dict[bytes, np.ndarray] = field(default_factory=dict, init=False)

    def covariance(self, chosen: np.ndarray, block: slice = slice(None)) -> np.ndarray:
        """Returns error covariances of chosen windows, or their blocks, (windows, size, size)."""
        factors = (dtrtri(root, lower=1)[0][block] for root in self.whitening[chosen])
        return np.stack([factor @ factor.T for factor in factors])

    def white(self, errors: np.ndarray, chosen: np.ndarray | None = None) -> np.ndarray:
        """Whitens errors of the chosen windows to unit variance, shape (windows, size)."""
        if chosen is None or chosen.all():
            return whitened(self.whitening, errors)
        mask = chosen.tobytes()
        if mask not in self._chosen:
            self._chosen.clear()
            self._chosen[mask] = self.whitening[chosen]
        return whitened(self._chosen[mask], errors)


def whitened(roots: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Whitens errors to unit variance, (windows, size), by one batched product, which is fast."""
    return (roots @ errors.reshape(len(errors), -1, 1))[:, :, 0]


def inverse_roots(covariances: Iterable[np.ndarray]) -> np.ndarray:
    """Computes inverse Cholesky factors of covariances (size, size), shape (count, size, size).

    Model errors far above noise make covariances nearly singular, so their diagonals are raised by
    a relative 1e-9. Inverting triangular factors takes a third of the work of a general inverse.
    """

    def factor(one: np.ndarray) -> np.ndarray:
        root = np.linalg.cholesky(one * (1.0 + _ROUNDING * np.eye(len(one))))
        return np.asarray(dtrtri(root, lower=1)[0])

    return np.stack([factor(one) for one in covariances])


def robust_cost(mean_square: np.ndarray, limit: float) -> np.ndarray:
    """Computes robust costs of mean squared errors: equal up to a limit, logarithmic beyond."""
    beyond = limit * (1.0 + np.log(np.maximum(mean_square, limit) / limit))
    return np.where(mean_square <= limit, mean_square, beyond)


def robust_weight(mean_square: np.ndarray, limit: float) -> np.ndarray:
    """Returns the derivative of `robust_cost`: weights of windows in a least-squares step."""
    return limit / np.maximum(mean_square, limit)


class Problem:
    """Recordings and machine as a least-squares problem; immutable.

    `machine` is the unmodified machine at the replay's time step. `fit` are the indices of the
    recordings that are fitted; all others are held out.
    """

    def __init__(
        self,
        machine: Machine,
        library: Library,
        series: list[UniformSeries],
        channels: tuple[Channel, ...],
        fit: Sequence[int],
        *,
        threads: int = 2,
        thresholds: Thresholds = DEFAULT,
    ) -> None:
        self.machine, self.library, self.thresholds = machine, library, thresholds
        self.threads = max(1, threads)
        self.series, self.channels = series, channels
        self.replay = Replay(machine, series, channels, thresholds, threads=threads)
        self._fine = self._at(0.5)
        #: Joints whose drive forces along the measured motion are known.
        self.balanced = balanced_joints(machine, channels)
        self.fitted = np.isin(self.replay.recording, list(fit))  #: mask of windows, (windows,)
        self.held = ~self.fitted
        #: Standard deviation of each channel's samples, (recordings, channels).
        self.sensor_noise = self.replay.sensor_noise
        some = np.zeros(self.replay.windows, dtype=bool)
        some[:: max(1, self.replay.windows // thresholds.order_windows)] = True

        def errors(replay: Replay, chosen: np.ndarray | None = None) -> np.ndarray:
            change = library.change(Hypothesis(), replay.machine)
            return replay.error(change, chosen=chosen).values

        whole, half, quarter = errors(self.replay), errors(self._fine), errors(self._at(0.25), some)
        #: Joint that becomes unstable in replays of the unmodified model, or None; and whether all
        #: joints are stable at half the time step.
        self.blown, self.finer_helps = self._blown(whole), self._blown(half) is None
        self._beyond_half = extrapolation((half - whole)[some], quarter - half[some])
        #: Linearised at the unmodified machine; `about` changes this.
        self.noise = self._noise_model(library.change(Hypothesis(), machine), whole, half - whole)

    @property
    def size(self) -> int:
        """Number of whitened errors of a window."""
        return len(self.channels) * self.replay.bins

    @property
    def judged(self) -> np.ndarray:
        """Mask of the windows on which errors are reported: held out, or else fitted."""
        return self.held if self.held.any() else self.fitted

    def _at(self, share: float) -> Replay:
        """Returns the replay at its time step times `share`."""
        return self.replay.on(self.machine.at_timestep(share * self.machine.timestep))

    def _blown(self, errors: np.ndarray) -> str | None:
        """Returns the joint that the time step makes unstable in replays, or None.

        Its position errors, of (windows, channels, bins), exceed a hundred times its travel in more
        than half of the windows. Wrong models err less; unstable steps amplify errors by 1e6.
        """
        for k, channel in enumerate(self.channels):
            if channel.chamber:
                continue
            travel = max(float(np.ptp(one.columns[channel.column])) for one in self.series)
            far = np.abs(errors[:, k]).max(axis=1) > 100.0 * max(travel, 1e-3)
            if np.mean(far) > 0.5:
                return channel.joint
        return None

    def about(self, hypothesis: Hypothesis) -> "Problem":
        """Returns a copy of the problem whose noise model is linearised at a hypothesis."""
        errors, fine = (self._errors(r, hypothesis, None)[0] for r in (self.replay, self._fine))
        change = self.library.change(hypothesis, self.machine)
        other = copy(self)
        other.noise = self._noise_model(change, self.replay.error(change).values, fine - errors)
        return other

    def beside(self, own: np.ndarray) -> "Problem":
        """Returns a copy with `own`, (recordings, size, size), added to the noise covariances."""
        other, recording = copy(self), self.replay.recording
        noise = self.noise.covariance(np.ones(self.replay.windows, dtype=bool))
        whitening = inverse_roots(noise + own[recording])
        other.noise = NoiseModel(defect=self.noise.defect, whitening=whitening)
        return other

    def _noise_model(self, change: Change, reference: np.ndarray, finer: np.ndarray) -> NoiseModel:
        """Computes the noise model at a change with errors `reference`, (windows, channels, bins).

        The covariance of a window's errors is N + S P S' + D D'. N is the noise of sensors and of
        timing, P the covariance of the start states, S the sensitivity of predictions to start
        states, from replays with perturbed starts, and D the error due to the time step. D is
        subtracted, since a machine has no time step, but also counts as noise, since a recording
        by a simulation has this error. `finer`: change of the errors at half the time step.
        """
        replay, limits, size = self.replay, self.thresholds, self.size
        per_bin = replay.samples // replay.bins
        sigma = self.sensor_noise[replay.recording]  # (windows, channels)
        measured = replay.measured()
        binned = measured[:, :, 1:].reshape(*measured.shape[:2], replay.bins, per_bin).mean(axis=3)
        timing = np.array([limits.timing_share[bool(c.chamber)] for c in self.channels])[:, None]
        moving = timing * np.abs(np.gradient(binned, axis=2))
        variance = (sigma**2 / per_bin)[:, :, None] + moving**2
        for chamber in [k for k, c in enumerate(self.channels) if c.chamber]:
            lowest = np.minimum.accumulate(binned[:, chamber], axis=1)
            variance *= np.where(lowest < limits.vapour_pressure, 1e8, 1.0)[:, None]
        defect = finer * self._beyond_half[:, None]
        directions = [defect.reshape(-1, size)]
        for nudge, spread in self._nudges():
            moved = replay.error(change, nudge=nudge).values - reference
            directions.append(moved.reshape(-1, size) * (spread / nudge.size)[:, None])
        together = zip(np.stack(directions, axis=2), variance.reshape(-1, size), strict=True)
        # One window at a time, because all covariances together take hundreds of megabytes.
        whitening = inverse_roots(moves @ moves.T + np.diag(own) for moves, own in together)
        return NoiseModel(defect=defect, whitening=whitening)

    def _nudges(self) -> list[tuple[Nudge, np.ndarray]]:
        """Returns for each start state a perturbation and its standard deviations, (windows,)."""
        found: list[tuple[Nudge, np.ndarray]] = []
        replay, machine, limits = self.replay, self.machine, self.thresholds
        for k, channel in enumerate(self.channels):
            known: dict[str, float | None] = {"position": None, "velocity": self.series[0].period}
            if channel.chamber:
                known = {channel.chamber: None}
            for quantity, period in known.items():
                rule = {"deriv": int(period is not None), "delta": period or 1.0}
                kernel = float(np.sqrt((savgol_coeffs(*channel.filter, **rule) ** 2).sum()))
                # The difference from a filter of lower order indicates the bias of the smoothing.
                samples = (s.columns[channel.column] for s in self.series)
                rough = [filter_difference(x, channel.filter, period) for x in samples]
                sigma = kernel * self.sensor_noise[replay.recording, k]
                spread = limits.start_spread * np.hypot(sigma, replay.at_starts(rough))
                size = 2e4 if channel.chamber else float(np.median(spread))
                found.append((Nudge(channel.cylinder or channel.joint, quantity, size), spread))
        for cylinder in machine.cylinders:
            for chamber in CHAMBERS if replay.blind else ():
                spread = np.full(replay.windows, limits.unseen_pressure)
                found.append((Nudge(cylinder, chamber, 1e5), spread))
            stiffness = machine.parameter(cylinder, "sigma_0")
            if stiffness > 0.0:
                full = machine.parameter(cylinder, "static") / stiffness
                size = limits.bristle_share * full
                joint = machine.driven[cylinder][0]
                touched = replay.at_starts([cut.touched[joint] for cut in replay.cuts])
                found.append((Nudge(cylinder, "bristle", size), np.where(touched, full, size)))
        return found

    def residual(self, hypothesis: Hypothesis, chosen: np.ndarray | None = None) -> np.ndarray:
        """Computes whitened errors, (chosen windows, size); 0 if an effect begins in the window."""
        errors, certain = self._errors(self.replay, hypothesis, chosen)
        defect = self.noise.defect if chosen is None else self.noise.defect[chosen]
        white = self.noise.white((errors + defect) * certain[:, None, None], chosen)
        return np.clip(white, -self.thresholds.clip, self.thresholds.clip)

    def noise_levels(self, hypothesis: Hypothesis) -> np.ndarray:
        """Computes the mean square whitened error of each window, (windows,)."""
        return np.mean(self.residual(hypothesis) ** 2, axis=1)

    def raw_errors(self, hypothesis: Hypothesis) -> np.ndarray:
        """Computes measured minus predicted outputs in SI units, (windows, channels, bins)."""
        return self._errors(self.replay, hypothesis, None)[0] + self.noise.defect

    def _errors(
        self, replay: Replay, hypothesis: Hypothesis, chosen: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Computes errors of chosen windows, and by window 0 if an effect begins in it, else 1."""
        if not hypothesis.onsets:
            change = self.library.change(hypothesis, replay.machine)
            errors = replay.error(change, chosen=chosen).normalised
            return errors, np.ones(len(errors))
        chosen = np.full(replay.windows, True) if chosen is None else chosen
        keys = sorted(hypothesis.onsets)
        begins = np.stack([hypothesis.onsets[k][replay.recording] for k in keys])
        active = begins <= replay.start
        certain = np.all(active | (begins >= replay.start + replay.window), axis=0)
        out = np.zeros((replay.windows, len(self.channels), replay.bins))
        for present in np.unique(active[:, chosen], axis=1).T:
            group = chosen & (active == present[:, None]).all(axis=0)
            absent = [k for k, there in zip(keys, present, strict=True) if not there]
            change = self.library.change(hypothesis.without(*absent), replay.machine)
            out[group] = replay.error(change, chosen=group).normalised
        return out[chosen], certain[chosen].astype(float)

    def window_cost(self, hypothesis: Hypothesis) -> np.ndarray:
        """Computes the robust cost of every window, fitted and held out, (windows,)."""
        return robust_cost(self.noise_levels(hypothesis), self.thresholds.robust_limit)


def noise_alone(squares: np.ndarray, recording: np.ndarray) -> bool:
    """Tests whether the errors of each recording are noise in all but a few windows.

    `squares` are the mean squared whitened errors of the windows, (windows,).
    """
    share, limit = 1.0 - SMALL, EXPLAINED**2
    own = (squares[recording == r] for r in np.unique(recording))
    return all(float(np.quantile(one, share)) <= limit for one in own)


def as_noise(squares: np.ndarray, recording: np.ndarray) -> bool:
    """Tests whether the median error of each recording is noise; arguments as of `noise_alone`."""
    largest = max(float(np.median(squares[recording == r])) for r in np.unique(recording))
    return largest**0.5 <= EXPLAINED


def lessens(before: float, after: float) -> bool:
    """Tests whether an error falls by the share `EXPLANATION` of its excess over noise.

    Both errors are in noise levels, so a complete model has the error 1.
    """
    return before - after >= EXPLANATION * max(before - 1.0, ROOM)


def thinned(mask: np.ndarray, count: int) -> np.ndarray:
    """Returns a mask of about `count` of the windows in `mask`, evenly spaced."""
    out = np.zeros_like(mask)
    out[np.flatnonzero(mask)[:: max(1, round(mask.sum() / count))]] = True
    return out


def extrapolation(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Computes the factor that extrapolates a halved time step to step zero, (channels,).

    `first` is the change of the errors, (windows, channels, bins), from the step h to h/2, `second`
    the change from h/2 to h/4. If the error is c_1 h + c_2 h^2, both determine the change from h to
    0 (Romberg): (2 first + 8 second)/3. This is 4/3 `first` for second-order errors (c_1 = 0) and
    twice `first` for an error of first order. The factor is the median over windows, because near
    discontinuities and stick-slip, errors have no order.
    """
    limit = (2.0 * first + 8.0 * second) / 3.0
    square = (first**2).sum(axis=2)
    factor = (limit * first).sum(axis=2) / np.where(square > 0.0, square, 1.0)
    middle = np.median(np.where(square > 0.0, factor, 4.0 / 3.0), axis=0)
    return np.clip(middle, 4.0 / 3.0, 2.0)
