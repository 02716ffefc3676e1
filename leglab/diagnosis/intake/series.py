"""Recordings on one uniform grid, by the times at which their rows were measured.

A measured value on the grid is the mean of the samples nearest to it, moved there along a parabola
through their neighbours: noise stays white, motion keeps its phase. A command is held between its
stamps; on the grid it is its mean over the period that it acts in: no impulse is lost.
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

# Stamps this near to the grid, in periods, are on it.
_ON_GRID = NEGLIGIBLE
# Differences below this share of the largest value are rounding of floats.
_FLOAT = float(np.sqrt(np.finfo(float).eps))
# Where jitter and lost rows hide the beat of a clock, its period is known to this share only.
_UNCLEAR = CERTAIN * SAME


@dataclass(frozen=True)
class UniformSeries:
    """One recording, ready for replay."""

    name: str  #: Of its file
    period: float  #: s
    time: np.ndarray  #: Shape (n,), s
    columns: dict[str, np.ndarray]  #: Samples on the grid by column, each (n,), gaps bridged
    valid: np.ndarray  #: Where every channel was measured, shape (n,)
    #: Least step of quantised columns as they were logged; 0 where there is none.
    steps: dict[str, float]
    #: Standard deviation of white noise on the grid that averages as the logged samples do, by
    #: column, 0 where none shows; empty where the log is on the grid as it is.
    noise: dict[str, float]
    #: By how much commands reach native actuators before their time [s]; None for unknown.
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
        """Puts the needed columns of a recording on a uniform grid of a period [s], or of its own.

        Columns that end with "_command" are held between samples; NaN are missing samples.
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
                # Lost rows cost noise of their own.
                if off_grid or good.sum() <= (1.0 - SAME) * grid.size:
                    noise[column] = white
            valid &= known
        time, lead = recording.time[0] + grid, recording.command_lead
        return cls(name, period, time, columns, valid, steps, noise, lead)


@dataclass(frozen=True, eq=False)
class Clock:
    """The stamps of a recording, as its logger's clock meant them."""

    period: float  #: Usual time between two rows [s], free of jitter and lost rows
    stamps: np.ndarray  #: Shape (n,), s; those of a uniform clock that rounds are straightened
    rounding: float  #: Step to which stamps were rounded [s]; 0 where they were not, or evenly
    #: RMS of the stamps' departures from whole periods between neighbours, in periods.
    jitter: float
    lost: int  #: Rows that are missing between others
    #: Whether the period is known well; it is not where jitter and lost rows hide the beat.
    clear: bool

    @classmethod
    def of(cls, time: np.ndarray) -> "Clock":
        """Finds period, rounding and jitter of three time stamps or more [s]."""
        stamps, rounding = time, 0.0
        line, step = straight_line(np.arange(time.size), time), quantum(time - time[0])
        off, mean = float(np.abs(time - line).max()), float(line[1] - line[0])
        # A tick lies half a step from its stamp, and a little more from a line through stamps.
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
    """Jitter of stamps as that of a `Clock`, the number of each one's tick, and lost rows."""
    passed = np.diff(stamps) / period
    whole = np.maximum(np.rint(passed), 1.0)
    close = whole < 5
    jitter = float(rms((passed - whole)[close])) if close.any() else 0.0
    lost = max(0, round(float(stamps[-1] - stamps[0]) / period) + 1 - stamps.size)
    return jitter, np.append(0.0, np.cumsum(whole)), lost


def _beat(time: np.ndarray, guess: float) -> float:
    """Period of the strongest beat of stamps near a guess [s], 0 where none stands out."""
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
    """Time that one row takes: jitter averages out, and lost rows do not count.

    The mean of intervals within half of itself, found from the median on. Where it accounts for all
    rows from the first to the last, their number is the better measure.
    """
    intervals = np.diff(time)
    period = float(np.median(intervals))
    if np.abs(intervals - period).min() > 0.5 * period:  # Half are short, half are long.
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
    """Period of the grid for all recordings [s]: that of the slowest.

    Of recordings whose periods are the same up to their clocks, the one in the middle counts.
    """
    clocks = [Clock.of(recording.time) for recording in recordings.values()]
    clear = [c.period for c in clocks if c.clear] or [c.period for c in clocks]
    longest, slowest = max(c.period for c in clocks), max(clear)
    slowest = longest if longest > (1.0 + _UNCLEAR) * slowest else slowest
    same = [period for period in clear if period > (1.0 - SAME) * slowest]
    return median_high(same) if same else slowest


def readings_change(samples: np.ndarray, length: int) -> np.ndarray:
    """Mask of the samples around which a signal, (n,), has more than one value within so many.

    Elsewhere it rests on one reading: noise is below the converter's step and does not show,
    however long that lasts, on a machine of any size.
    """
    apart = maximum_filter1d(samples, length) - minimum_filter1d(samples, length)
    return apart > _FLOAT * np.abs(samples).max()


def quantum(samples: np.ndarray) -> float:
    """Least step of a quantised signal, (n,), 0 where it is not quantised or never moves.

    It is the largest step of which nearly all differences of neighbours are multiples: single
    values between two counts, or the rounding of floats, do not make it smaller.
    """
    largest = float(np.abs(samples).max(initial=0.0))
    moves = np.abs(np.diff(samples))
    moves = np.sort(moves[moves > _FLOAT * largest])
    if not moves.size:
        return 0.0
    rests = moves.size < samples.size - 1
    # Differences of differences: a fast signal may never move by a single count.
    apart = np.diff(moves)
    apart = apart[apart > max(_FLOAT * largest, 1e-6 * moves[-1])]
    shares = (0.0, 0.01, 0.03, 0.1, 0.25, 0.5)
    pools = [np.quantile(pool, shares, method="lower") for pool in (moves, apart) if pool.size]
    guesses = np.concatenate(pools).tolist()
    return max(_fitted_step(moves, guess, largest, rests=rests) for guess in guesses)


def _fitted_step(moves: np.ndarray, step: float, largest: float, *, rests: bool) -> float:
    """The step of which moves are multiples, near a first guess; 0 where there is none."""
    for most in (3, 10, 30, 100):
        count = np.rint(moves / step)
        some = (count > 0) & (count <= most)
        if not some.any():
            return 0.0
        # The median is deaf to the few moves that are no multiples.
        step = float(np.median(moves[some] / count[some]))
    share = moves[moves <= 100.5 * step] / step
    count = np.rint(share)
    rounding = 2.0 * np.finfo(np.float32).eps * largest / step
    multiple = (count > 0) & (np.abs(share - count) < SAME + rounding)
    # A steady motion moves by one amount as well, yet neither less nor more.
    varied = rests or (count != np.median(count)).mean() > 0.02
    whole = multiple.mean() > 0.8 and share.size >= 0.5 * moves.size
    return step if whole and varied else 0.0


@dataclass(eq=False)
class _Log:
    """One column as it was logged, without its missing samples, and the grid that it is put on.

    Times are told from the recording's first stamp on [s].
    """

    times: np.ndarray  # (n,)
    samples: np.ndarray  # (n,)
    own: float  # usual interval of the recording [s]
    grid: np.ndarray  # (count,)
    period: float  # of the grid [s]
    limits: Thresholds

    def __post_init__(self) -> None:
        self.step, self.spacing = quantum(self.samples), self.own
        if self.times.size >= 3:  # Some columns are logged less often than the rows.
            self.spacing = min(max(usual_interval(self.times), self.own), 5.0 * self.own)
        # Sample after each place of the grid, (count,).
        near = self.grid - _ON_GRID * self.period
        self.after = np.searchsorted(self.times, near).clip(1, self.times.size - 1)

    def _known(self, smooth: np.ndarray) -> np.ndarray:
        """Where values of the grid are known, (count,); `smooth` where their neighbours agree."""
        before, after = self.times[self.after - 1], self.times[self.after]
        outside = (self.grid < self.times[0]) | (self.grid > self.times[-1])
        width = np.where(outside, np.inf, after - before)
        reach = np.where(outside, 0.5 * max(self.period, self.spacing), _ON_GRID * self.period)
        on_stamp = np.minimum(np.abs(self.grid - before), np.abs(after - self.grid)) <= reach
        near = max(0.5 * NEIGHBOURS * self.spacing, 1.5 * self.period)
        far = max((NEIGHBOURS - 0.5) * self.spacing, self.limits.bin)
        return on_stamp | (width <= near) | (smooth & (width <= far))

    def averaged(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Samples averaged about each place of the grid, where they are known, and their noise.

        One that lies on the grid alone stays as it is.
        """
        grid, period, count = self.grid, self.period, self.grid.size
        place = np.floor(self.times / period + 0.5 - 1e-9).astype(np.int64).clip(0, count - 1)
        inside = np.abs(self.times - grid[place]) <= 0.5 * period * (1.0 + 1e-6)
        place, times, samples = place[inside], self.times[inside], self.samples[inside]
        number = np.bincount(place, minlength=count)
        held = np.maximum(number, 1)
        away = times - grid[place]
        away[np.abs(away) <= _ON_GRID * period] = 0.0
        if (number == 1).all() and not away.any():  # Long logs take no time and memory then.
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
        # Filters reach into gaps: what stands there must be tame.
        value = np.where(known, value, np.interp(grid, self.times, self.samples))
        # A mean over many places weighs each sample by what it gave to all of them.
        share = np.stack([number == 0, -early * (number > 0), -spread * (number > 0)], axis=1)
        given = np.einsum("kp,kpn->kn", share * known[:, None], fit.weights)
        weight = np.bincount(fit.neighbours.ravel(), given.ravel(), minlength=self.times.size)
        weight[inside] += known[place] / held[place]
        noise = scatter * float(np.sqrt((weight**2).sum() / max(int(known.sum()), 1)))
        return value, known, noise

    def held(self, *, lossy: bool) -> tuple[np.ndarray, np.ndarray]:
        """A held command's mean from each place of the grid to the next, and where it is known.

        Where ticks were lost it may have changed at each of them: they take what lies between. A
        long interval of a log that is not `lossy` is jitter.
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
        # Differences of a long integral: a command on the grid keeps its value to the last bit.
        at = np.searchsorted(times, grid + near, side="right") - 1
        stays = times[at + 1] >= grid + (1.0 - _ON_GRID) * period
        whole = stays & (np.abs(times[at] - grid) <= near)
        usual = np.quantile(np.abs(change) / ticks, 0.95)
        smooth = (np.abs(change) <= 3.0 * usual * ticks)[self.after - 1]
        return np.where(whole, values[at], mean), self._known(smooth)


class _Parabolas:
    """Parabolas through the `size` neighbours of each of `count` places of a log's grid."""

    def __init__(self, log: _Log) -> None:
        reach = max(1.5 * log.period, 0.5 * NEIGHBOURS * log.spacing)
        size = max(NEIGHBOURS, 2 * int(np.ceil(1.5 * log.period / log.spacing)) + 1)
        size = min(size, log.times.size)
        # The nearest samples on both sides, as many as there are, (count, size).
        first = np.searchsorted(log.times, log.grid) - size // 2
        self.neighbours = first.clip(0, log.times.size - size)[:, None] + np.arange(size)
        away = (log.times[self.neighbours] - log.grid[:, None]) / reach
        # Beyond a gap lies another motion.
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
        # Value, slope and half the second derivative at the place, each (count,), and how much each
        # neighbour gives to them, (count, 3, size).
        self.value, self.slope, self.bend = a + level, b / reach, c / reach**2
        self.weights = rows / np.array([1.0, reach, reach**2])[:, None]
        # Share of a sample's noise that the parabola follows near its centre.
        self.leverage = min(2.25 / size, 0.9)
