"""Resampling of recordings to a uniform time grid, by the time stamps of their samples.

A measured value at a grid point is the mean of the nearest samples, each shifted to the grid point
along a parabola through its neighbours, so that noise stays white and motion is not delayed.
Commands are held between stamps and averaged over the period after a grid point (same integral).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median_high

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from leglab.base.recording import Recording
from leglab.base.scale import deviation, rms
from leglab.data.clock import straight_line, usual_step
from leglab.diagnosis.thresholds import CERTAIN, DEFAULT, NEGLIGIBLE, NEIGHBOURS, SAME, Thresholds

# Distance [periods] up to which a time stamp counts as lying on the grid.
_ON_GRID = NEGLIGIBLE
# Share of the largest value below which differences are floating-point errors.
_FLOAT = float(np.sqrt(np.finfo(float).eps))
# Relative uncertainty of a clock's period if jitter and lost samples hide its ticks.
_UNCLEAR = CERTAIN * SAME


@dataclass(frozen=True)
class UniformSeries:
    """One recording, resampled to a uniform time grid."""

    name: str  #: Name of the recording
    period: float  #: Sampling period of the grid [s]
    time: np.ndarray  #: Time of each grid point [s], (n,)
    columns: dict[str, np.ndarray]  #: Samples by column, each (n,), interpolated in gaps
    valid: np.ndarray  #: Mask of grid points at which every column was measured, (n,)
    #: Quantisation step of the logged samples by column, 0 if not quantised.
    steps: dict[str, float]
    #: Standard deviation of the noise after resampling, by column, 0 if none is visible; empty if
    #: the logged samples already lie on the grid.
    noise: dict[str, float]
    #: Time by which commands act at native actuators before their stamps [s]; None if unknown.
    command_lead: float | None

    @classmethod
    def from_recording(
        cls,
        recording: Recording,
        name: str,
        needed: tuple[str, ...],
        thresholds: Thresholds = DEFAULT,
        *,
        period: float | None = None,
    ) -> "UniformSeries":
        """Resamples the needed columns of a recording, by default at the recording's period [s].

        Columns that end with "_command" are held between samples; NaN marks missing samples.
        """
        clock = Clock.of(recording.time)
        period = period or clock.period
        stamps = clock.stamps - clock.stamps[0]
        grid = period * np.arange(int(np.floor(stamps[-1] / period + _ON_GRID)) + 1)
        off_grid = np.abs(stamps - period * np.rint(stamps / period)).max() > _ON_GRID * period
        valid = np.ones(grid.size, dtype=bool)
        columns, steps, noise = {}, {}, {}
        for column in needed:
            samples = recording[column]
            good = np.isfinite(samples)
            log = _Log(stamps[good], samples[good], clock.period, grid, period, thresholds)
            steps[column] = log.step
            if column.endswith("_command"):
                columns[column], known = log.held(lossy=clock.lost > 0 or not good.all())
            else:
                columns[column], known, white = log.averaged()
                # Interpolation at lost samples also changes the noise.
                if off_grid or good.sum() <= (1.0 - SAME) * grid.size:
                    noise[column] = white
            valid &= known
        time, lead = recording.time[0] + grid, recording.command_lead
        return cls(name, period, time, columns, valid, steps, noise, lead)


@dataclass(frozen=True, eq=False)
class Clock:
    """Time stamps of a recording, corrected for rounding, with the period of the logger's clock."""

    period: float  #: Usual time between two samples [s], without jitter or lost samples
    stamps: np.ndarray  #: Stamps [s], (n,); evenly spaced if rounding was the only error
    rounding: float  #: Step to which stamps were rounded [s]; 0 if not rounded or harmless
    #: RMS departure of the intervals from multiples of the period [periods].
    jitter: float
    lost: int  #: Number of samples that are missing in between
    #: Whether the period is certain; jitter together with lost samples makes it uncertain.
    clear: bool

    @classmethod
    def of(cls, time: np.ndarray) -> "Clock":
        """Estimates period, rounding and jitter of at least three time stamps [s]."""
        stamps, rounding = time, 0.0
        line, step = straight_line(np.arange(time.size), time), quantum(time - time[0])
        off, mean = float(np.abs(time - line).max()), float(line[1] - line[0])
        # Rounding moves a stamp by up to half a step, and the fitted line adds a small error.
        if _ON_GRID * mean < off <= 0.75 * step < 2.0 * mean:
            stamps, rounding = line, step
        period = usual_interval(stamps)
        jitter, ticks, lost = _ticks(stamps, period)
        clear = jitter < _UNCLEAR or not lost
        if not clear and (beat := _beat(stamps, period)):
            period, clear = beat, True
            jitter, ticks, lost = _ticks(stamps, period)
        if lost and jitter > _ON_GRID:
            line = straight_line(ticks, time)
            if 0.0 < step < 2.0 * period and np.abs(time - line).max() <= 0.75 * step:
                period = float(line[-1] - line[0]) / float(ticks[-1])
                stamps, rounding, jitter = line, step, 0.0
        return cls(period, stamps, rounding, jitter, lost, clear)


def _ticks(stamps: np.ndarray, period: float) -> tuple[float, np.ndarray, int]:
    """Returns `Clock.jitter`, the number of clock ticks before each stamp, and `Clock.lost`."""
    passed = np.diff(stamps) / period
    whole = np.maximum(np.rint(passed), 1.0)
    close = whole < 5
    jitter = float(rms((passed - whole)[close])) if close.any() else 0.0
    lost = max(0, round(float(stamps[-1] - stamps[0]) / period) + 1 - stamps.size)
    return jitter, np.append(0.0, np.cumsum(whole)), lost


def _beat(time: np.ndarray, guess: float) -> float:
    """Returns the period of the strongest peak in the stamps' spectrum near a guess [s], or 0."""
    some = time[:4000] - time[0]
    place = guess / 16.0
    count = np.bincount(np.rint(some / place).astype(np.int64)).astype(float)
    size = 4 * count.size
    strength = np.abs(np.fft.rfft(count - count.mean(), size)) / some.size
    rate = np.fft.rfftfreq(size, place)
    near = np.abs(rate * guess - 1.0) < 1.5 * _UNCLEAR
    best = int(np.argmax(np.where(near, strength, 0.0)))
    clear = near.any() and strength[best] > CERTAIN / np.sqrt(some.size)
    return float(1.0 / rate[best]) if clear else 0.0


def usual_interval(time: np.ndarray) -> float:
    """Returns the usual interval of samples, by an average that ignores lost samples.

    It is the mean of the intervals that lie within 50 % of this mean, iterated from the median. If
    no sample is lost, the duration divided by the number of intervals is more accurate and used.
    """
    intervals = np.diff(time)
    period = float(np.median(intervals))
    if np.abs(intervals - period).min() > 0.5 * period:  # half of the intervals are long
        period = usual_step(time)
    for _ in range(50):
        close = np.abs(intervals - period) <= 0.5 * period * (1.0 + 1e-9)
        before, period = period, float(intervals[close].mean())
        if abs(period - before) <= 1e-12 * period:
            break
    mean = float(time[-1] - time[0]) / intervals.size
    error = float(intervals[close].std()) / np.sqrt(close.sum())
    return mean if abs(mean - period) < CERTAIN * error else period


def common_period(recordings: Mapping[str, Recording], thresholds: Thresholds = DEFAULT) -> float:
    """Returns the period of the grid for all recordings [s]: the longest of their periods.

    If several of the longest periods differ only by errors of clocks, their median is returned.
    """
    clocks = [Clock.of(recording.time) for recording in recordings.values()]
    clear = [c.period for c in clocks if c.clear] or [c.period for c in clocks]
    longest, slowest = max(c.period for c in clocks), max(clear)
    slowest = longest if longest > (1.0 + _UNCLEAR) * slowest else slowest
    same = [period for period in clear if period > (1.0 - SAME) * slowest]
    return median_high(same) if same else slowest


def readings_change(samples: np.ndarray, length: int) -> np.ndarray:
    """Masks samples around which a signal, (n,), takes more than one value within `length` samples.

    Elsewhere the signal rests on one reading, because its noise is below the quantisation step, so
    that the samples do not show the noise.
    """
    apart = maximum_filter1d(samples, length) - minimum_filter1d(samples, length)
    return apart > _FLOAT * np.abs(samples).max()


def quantum(samples: np.ndarray) -> float:
    """Returns the step of a quantised signal, (n,); 0 if it is not quantised or never moves.

    It is the largest step of which nearly all differences of successive samples are multiples, so
    that a few values between two counts, or rounding of floats, do not reduce it.
    """
    largest = float(np.abs(samples).max(initial=0.0))
    moves = np.abs(np.diff(samples))
    moves = np.sort(moves[moves > _FLOAT * largest])
    if not moves.size:
        return 0.0
    rests = moves.size < samples.size - 1
    # Differences of moves are guesses too, since a fast signal may never move by a single count.
    apart = np.diff(moves)
    apart = apart[apart > max(_FLOAT * largest, 1e-6 * moves[-1])]
    shares = (0.0, 0.01, 0.03, 0.1, 0.25, 0.5)
    pools = [np.quantile(pool, shares, method="lower") for pool in (moves, apart) if pool.size]
    guesses = np.concatenate(pools).tolist()
    return max(_fitted_step(moves, guess, largest, rests=rests) for guess in guesses)


def _fitted_step(moves: np.ndarray, step: float, largest: float, *, rests: bool) -> float:
    """Returns a quantisation step near a guess, of which moves are multiples; 0 if none fits."""
    for most in (3, 10, 30, 100):
        count = np.rint(moves / step)
        some = (count > 0) & (count <= most)
        if not some.any():
            return 0.0
        # The median is insensitive to the few moves that are not multiples.
        step = float(np.median(moves[some] / count[some]))
    share = moves[moves <= 100.5 * step] / step
    count = np.rint(share)
    rounding = 2.0 * np.finfo(np.float32).eps * largest / step
    multiple = (count > 0) & (np.abs(share - count) < SAME + rounding)
    # A steady motion also has equal moves, but it has no rests and no other multiples.
    varied = rests or (count != np.median(count)).mean() > 0.02
    whole = multiple.mean() > 0.8 and share.size >= 0.5 * moves.size
    return step if whole and varied else 0.0


@dataclass(eq=False)
class _Log:
    """A logged column without its missing samples, and the grid to which it is resampled.

    Times are relative to the recording's first stamp [s].
    """

    times: np.ndarray  # (n,)
    samples: np.ndarray  # (n,)
    own: float  # usual interval of the recording's samples [s]
    grid: np.ndarray  # (count,)
    period: float  # sampling period of the grid [s]
    limits: Thresholds

    def __post_init__(self) -> None:
        self.step, self.spacing = quantum(self.samples), self.own
        if self.times.size >= 3:  # some columns are logged less often than others
            self.spacing = min(max(usual_interval(self.times), self.own), 5.0 * self.own)
        # Index of the first sample at or after each grid point, (count,).
        near = self.grid - _ON_GRID * self.period
        self.after = np.searchsorted(self.times, near).clip(1, self.times.size - 1)

    def _known(self, smooth: np.ndarray) -> np.ndarray:
        """Masks grid points with a reliable value; longer gaps are interpolated if `smooth`."""
        before, after = self.times[self.after - 1], self.times[self.after]
        outside = (self.grid < self.times[0]) | (self.grid > self.times[-1])
        width = np.where(outside, np.inf, after - before)
        reach = np.where(outside, 0.5 * max(self.period, self.spacing), _ON_GRID * self.period)
        on_stamp = np.minimum(np.abs(self.grid - before), np.abs(after - self.grid)) <= reach
        near = max(0.5 * NEIGHBOURS * self.spacing, 1.5 * self.period)
        far = max((NEIGHBOURS - 0.5) * self.spacing, self.limits.bin)
        return on_stamp | (width <= near) | (smooth & (width <= far))

    def averaged(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Returns the average of samples at each grid point, a mask of known points, and the noise.

        If each grid point has exactly one sample at its own time, these samples are returned.
        """
        grid, period, count = self.grid, self.period, self.grid.size
        place = np.floor(self.times / period + 0.5 - 1e-9).astype(np.int64).clip(0, count - 1)
        inside = np.abs(self.times - grid[place]) <= 0.5 * period * (1.0 + 1e-6)
        place, times, samples = place[inside], self.times[inside], self.samples[inside]
        number = np.bincount(place, minlength=count)
        held = np.maximum(number, 1)
        away = times - grid[place]
        away[np.abs(away) <= _ON_GRID * period] = 0.0
        if (number == 1).all() and not away.any():  # saves time and memory for long logs
            return samples, np.ones(count, dtype=bool), 0.0
        fit = _Parabolas(self)
        early, spread, value = (
            np.bincount(place, x, minlength=count) / held for x in (away, away**2, samples)
        )
        value -= fit.slope * early + fit.bend * spread
        value = np.where(number > 0, value, fit.value)
        rest = samples - fit.value[place] - fit.slope[place] * away - fit.bend[place] * away**2
        shown = rest[readings_change(samples, fit.neighbours.shape[1])]
        scatter = deviation(shown) / np.sqrt(1.0 - fit.leverage)
        least = max(scatter, self.step / np.sqrt(12.0), NEGLIGIBLE * float(np.std(samples)))
        smooth = fit.misfit <= CERTAIN * least
        known = (number > 0) | self._known(smooth)
        # Later filters extend into gaps, so gaps are filled by linear interpolation.
        value = np.where(known, value, np.interp(grid, self.times, self.samples))
        # Weights of each sample, summed over the values of all known grid points.
        share = np.stack([number == 0, -early * (number > 0), -spread * (number > 0)], axis=1)
        given = np.einsum("kp,kpn->kn", share * known[:, None], fit.weights)
        weight = np.bincount(fit.neighbours.ravel(), given.ravel(), minlength=self.times.size)
        weight[inside] += known[place] / held[place]
        noise = scatter * float(np.sqrt((weight**2).sum() / max(int(known.sum()), 1)))
        return value, known, noise

    def held(self, *, lossy: bool) -> tuple[np.ndarray, np.ndarray]:
        """Returns a held command's mean between grid points, and a mask of the known means.

        The command is interpolated at lost clock ticks, because it may have changed there. If the
        log is not `lossy`, no ticks are lost and long intervals are jitter.
        """
        grid, period, near = self.grid, self.period, _ON_GRID * self.period
        intervals, change = np.diff(self.times), np.diff(self.samples)
        ticks = np.ones(intervals.size, dtype=np.int64)
        if lossy:
            ticks = np.rint(intervals / self.spacing).clip(1.0, 100.0).astype(np.int64)
        first = np.repeat(np.arange(ticks.size), ticks)
        share = (np.arange(first.size) - np.repeat(np.cumsum(ticks) - ticks, ticks)) / ticks[first]
        times = np.append(self.times[first] + share * intervals[first], self.times[-1])
        values = np.append(self.samples[first] + share * change[first], self.samples[-1])
        end = max(times[-1], period * grid.size) + period
        times = np.concatenate([[min(0.0, times[0])], times[1:], [end]])
        impulse = np.append(0.0, np.cumsum(values * np.diff(times)))
        mean = np.diff(np.interp(period * np.arange(grid.size + 1), times, impulse)) / period
        # The mean has rounding errors, so values that are held for a whole period are copied.
        at = np.searchsorted(times, grid + near, side="right") - 1
        stays = times[at + 1] >= grid + (1.0 - _ON_GRID) * period
        whole = stays & (np.abs(times[at] - grid) <= near)
        usual = np.quantile(np.abs(change) / ticks, 0.95)
        smooth = (np.abs(change) <= 3.0 * usual * ticks)[self.after - 1]
        return np.where(whole, values[at], mean), self._known(smooth)


class _Parabolas:
    """Parabolas fitted to the `size` samples next to each of the `count` points of a log's grid."""

    def __init__(self, log: _Log) -> None:
        reach = max(1.5 * log.period, 0.5 * NEIGHBOURS * log.spacing)
        size = max(NEIGHBOURS, 2 * int(np.ceil(1.5 * log.period / log.spacing)) + 1)
        size = min(size, log.times.size)
        # Indices of the nearest samples on both sides, (count, size).
        first = np.searchsorted(log.times, log.grid) - size // 2
        self.neighbours = first.clip(0, log.times.size - size)[:, None] + np.arange(size)
        away = (log.times[self.neighbours] - log.grid[:, None]) / reach
        # Samples beyond a gap have almost no weight, because they belong to another motion.
        trust = np.where(np.abs(away) <= 1.5, 1.0, 1e-6)
        design = np.stack([np.ones_like(away), away, away**2], axis=2)
        weighted = design * trust[:, :, None]
        normal = np.einsum("knp,knq->kpq", weighted, design) + 1e-9 * np.eye(3)
        rows = np.linalg.solve(normal, weighted.transpose(0, 2, 1))
        level = log.samples[self.neighbours].mean(axis=1)
        samples = log.samples[self.neighbours] - level[:, None]
        a, b, c = np.einsum("kpn,kn->pk", rows, samples)
        rest = samples - (a[:, None] + b[:, None] * away + c[:, None] * away**2)
        # Standard deviation of the neighbours about the parabola, (count,).
        freedom = np.maximum(trust.sum(axis=1) - 3.0, 1.0)
        self.misfit = np.sqrt((rest**2 * trust).sum(axis=1) / freedom)
        # Value, slope and half the second derivative at the grid point, each (count,), and the
        # weights of the neighbours in them, (count, 3, size).
        self.value, self.slope, self.bend = a + level, b / reach, c / reach**2
        self.weights = rows / np.array([1.0, reach, reach**2])[:, None]
        # Share of a sample's noise variance that the parabola follows near its centre.
        self.leverage = min(2.25 / size, 0.9)
