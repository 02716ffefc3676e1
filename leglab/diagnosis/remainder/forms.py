"""Which variables a balance's remainder depends on, and of which form: additive or periodic."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from leglab.diagnosis.balance.balances import Balance
from leglab.diagnosis.remainder.splines import Blocks, basis, project, roughness

# Knots by variable; those of velocity and command lie dense about zero.
_KNOTS = {"position": 24, "velocity": 11, "load": 7, "command": 11}
_DENSE = ("velocity", "command")
# Width of the dense part, as a share of the largest magnitude.
_WIDTH = 0.1
# Share of the samples beyond either end of the knots.
_TAIL = 0.002
# Blocks of neighbouring windows for cross-validation [s].
_BLOCK = 1.0
# Smoothness: relative weights of the roughness that are tried.
_SMOOTHING = 10.0 ** np.arange(-7.0, 3.0)
# A variable must take off this share of what is left, and of what was there ...
_WORTHWHILE = (0.05, 0.02)
# ... with this t value over blocks.
_SIGNIFICANT = 2.5
# A position part is periodic if sines do as well as a spline, but for this share of its gain.
_AS_GOOD = 0.03
# Periods that are looked for, as shares of the range; harmonics.
_PERIODS = (0.05, 1.15)
_HARMONICS = (1, 2, 3)
# With so many free coefficients anything is periodic, unless it repeats at least so often.
_REPEATS = (0.0, 1.3, 1.8)
# Outliers are weighted down beyond so many robust standard deviations (Huber 1964).
_HUBER = 2.5
# Knots of the spline that stands for sines, a period.
_KNOTS_A_PERIOD = 14


@dataclass(frozen=True, kw_only=True, eq=False)
class Term:
    """Additive term of one variable before its size is known.

    Attributes:
        variable: "position", "velocity", "load" or "command".
        knots: Shape (knots,).
        columns: Its B-splines summed over windows, times the gain: (windows, knots + 2).
        penalty: Roughness.
        smoothing: Weight of the roughness, relative to the columns' size.
    """

    variable: str
    knots: np.ndarray
    columns: np.ndarray
    penalty: np.ndarray
    smoothing: float = 1e-3

    @property
    def count(self) -> int:
        """Number of coefficients."""
        return self.columns.shape[1]


@dataclass(frozen=True, kw_only=True, eq=False)
class Form:
    """Form of one balance's remainder, with a first estimate.

    The unknowns are the coefficients of the terms one after another. With a period those of the
    position are: constant, cosine and sine of each harmonic, length of the period.

    Attributes:
        balance: The windows it was fitted to.
        variables: Of the terms, in the order in which they were chosen.
        knots: By variable.
        harmonics: Number of harmonics; 0 for no period.
        values: Estimate, (unknowns,).
        information: Inverse covariance that the balance alone gives, (unknowns, unknowns).
        smoothness: Inverse covariance of the penalty alone, likewise.
        gain: Share of the balance's squares that it explains in cross-validation.
        left: Standard deviation of what it leaves.
        memory: Correlation between neighbouring windows of what it leaves.
    """

    balance: Balance
    variables: tuple[str, ...]
    knots: dict[str, np.ndarray]
    harmonics: int
    values: np.ndarray
    information: np.ndarray
    smoothness: np.ndarray
    gain: float
    left: float
    memory: float

    def coefficients(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """Coefficients of the splines by variable from values of the unknowns."""
        out = {}
        place = 0
        for variable in self.variables:
            knots = self.knots[variable]
            if variable == "position" and self.harmonics:
                count = 2 + 2 * self.harmonics
                part = values[place : place + count]
                grid = np.linspace(knots[0], knots[-1], 12 * knots.size)
                wave = sines(grid, part[-1], self.harmonics, self._middle) @ part[:-1]
                out[variable] = project(knots, wave, grid)
            else:
                count = knots.size + 2
                out[variable] = values[place : place + count]
            place += count
        return out

    @property
    def covariance(self) -> np.ndarray:
        """Of the estimate, (unknowns, unknowns)."""
        total = self.information + self.smoothness
        scale = 1.0 / np.sqrt(np.maximum(np.diag(total), 1e-300))
        both = np.outer(scale, scale)
        return np.asarray(np.linalg.pinv(total * both, rcond=1e-12, hermitian=True) * both)

    @property
    def _middle(self) -> float:
        knots = self.knots["position"]
        return float(0.5 * (knots[0] + knots[-1]))

    @property
    def period(self) -> tuple[float, float] | None:
        """Length of the period as estimated, and its standard deviation."""
        place = self.period_place
        if place is None:
            return None
        return float(self.values[place]), float(np.sqrt(self.covariance[place, place]))

    @property
    def period_place(self) -> int | None:
        """Place of the period's length among the unknowns."""
        if not self.harmonics:
            return None
        place = 0
        for variable in self.variables:
            if variable == "position":
                return place + 1 + 2 * self.harmonics
            place += self.knots[variable].size + 2
        return None


def sines(x: np.ndarray, period: float, harmonics: int, middle: float) -> np.ndarray:
    """Constant, then cosine and sine of each harmonic, (n, 1 + 2 harmonics)."""
    angle = 2.0 * np.pi * (x - middle) / period
    columns = [np.ones_like(x)]
    for k in range(1, harmonics + 1):
        columns += [np.cos(k * angle), np.sin(k * angle)]
    return np.stack(columns, axis=-1)


def usable(balance: Balance, fitted: Sequence[int]) -> np.ndarray:
    """Windows of fitted recordings in which the joint moves, (windows,)."""
    return balance.moving & np.isin(balance.recording, list(fitted))


def choose_form(balance: Balance, *, driven_by_oil: bool) -> Form | None:
    """Forward selection of variables by cross-validation over blocks; None where nothing helps.

    Args:
        balance: Windows that may be used.
        driven_by_oil: Whether a cylinder moves the joint: its command is no force.
    """
    if len(balance.lacking) < 60:
        return None
    block = _blocks(balance)
    candidates = _candidates(balance, driven_by_oil)
    if not candidates:
        return None
    weight = _robust_weights(balance, candidates, block)
    sums = Blocks.of(_design(candidates), balance.gained, weight, block)
    null = sums.squares
    chosen: list[Term] = []
    left = null
    while len(chosen) < len(candidates):
        best: tuple[float, list[Term], np.ndarray] | None = None
        for candidate in candidates:
            if candidate.variable in [t.variable for t in chosen]:
                continue
            terms = [*chosen, candidate]
            terms, errors = _smoothed(_part_of(sums, candidates, terms), terms, weight)
            if best is None or errors.sum() < best[0]:
                best = float(errors.sum()), terms, errors
        if best is None or not _pays(left - best[2], left, null):
            break
        chosen, left = best[1], best[2]
    if not chosen:
        return None
    harmonics, period = 0, 0.0
    if "position" in [t.variable for t in chosen] and not balance.oil:
        others = [t for t in chosen if t.variable != "position"]
        alone = null
        if others:
            alone = _smoothed(_part_of(sums, candidates, others), others, weight)[1]
        harmonics, period = _periodic(balance, chosen, weight, block, left, alone)
    return _estimated(balance, chosen, harmonics, period, weight, block, left, null)


def _part_of(sums: Blocks, candidates: Sequence[Term], terms: Sequence[Term]) -> Blocks:
    """The sums of some of the candidates, in their order."""
    ends = np.cumsum([c.count for c in candidates])
    places = {c.variable: range(e - c.count, e) for c, e in zip(candidates, ends, strict=True)}
    return sums.only([i for t in terms for i in places[t.variable]])


def _blocks(balance: Balance) -> np.ndarray:
    within = np.floor(balance.time / _BLOCK).astype(int)
    return np.asarray(balance.recording * (within.max() + 1) + within - within.min())


def _knots(variable: str, x: np.ndarray) -> np.ndarray | None:
    low, high = np.quantile(x, [_TAIL, 1.0 - _TAIL]).tolist()
    if not high - low > 1e-9 * max(abs(low), abs(high), 1e-9):
        return None
    count = _KNOTS[variable]
    if variable in _DENSE and low < 0.0 < high:
        width = _WIDTH * max(-low, high)
        ends = np.arcsinh(np.array([low, high]) / width)
        knots = width * np.sinh(np.linspace(float(ends[0]), float(ends[-1]), count))
        knots[[0, -1]] = low, high
        return np.asarray(knots)
    return np.linspace(low, high, count)


def _columns(balance: Balance, variable: str, knots: np.ndarray) -> np.ndarray:
    """B-splines times gain, mean over each window, (windows, knots + 2)."""
    x = balance.inputs[variable]
    full = basis(knots, x.ravel()).reshape(*x.shape, -1)
    return np.asarray((full * balance.gain[:, :, None]).mean(axis=1))


def _candidates(balance: Balance, driven_by_oil: bool) -> list[Term]:
    out = []
    inputs = balance.inputs
    for variable in inputs:
        if variable == "command" and not balance.oil:
            x, load = inputs["command"].ravel(), inputs["load"].ravel()
            same = load.std() > 0 and abs(np.corrcoef(x, load)[0, 1]) > 0.999
            if driven_by_oil or same or x.std() == 0.0:
                continue
        if variable == "load" and inputs["load"].std() == 0.0:
            continue
        knots = _knots(variable, inputs[variable].ravel())
        if knots is not None:
            columns = _columns(balance, variable, knots)
            out.append(
                Term(variable=variable, knots=knots, columns=columns, penalty=roughness(knots))
            )
    return out


def _penalty(terms: Sequence[Term], weight: np.ndarray) -> np.ndarray:
    total = sum(t.count for t in terms)
    out = np.zeros((total, total))
    place = 0
    for t in terms:
        size = float(weight @ (t.columns**2).sum(axis=1))
        own = slice(place, place + t.count)
        out[own, own] = t.smoothing * size * t.penalty + 1e-6 * size * np.eye(t.count) / t.count
        place += t.count
    return out


def _design(terms: Sequence[Term]) -> np.ndarray:
    return np.concatenate([t.columns for t in terms], axis=1)


def _robust_weights(balance: Balance, candidates: list[Term], block: np.ndarray) -> np.ndarray:
    """Weights of windows under the sum of all candidates, (windows,)."""
    design = _design(candidates)
    weight = np.ones(len(design))
    if balance.oil:  # what opens the valve little says little, and errors grow with the gain
        size = np.abs(balance.gain).mean(axis=1)
        weight = 1.0 / (size**2 + (0.1 * np.median(size)) ** 2)
    start = weight.copy()
    for _ in range(4):
        sums = Blocks.of(design, balance.gained, weight, block)
        rest = balance.gained - design @ sums.solve(_penalty(candidates, weight))
        scaled = np.abs(rest) * np.sqrt(start)
        level = 1.4826 * float(np.median(scaled)) + 1e-300
        weight = start * np.minimum(1.0, _HUBER * level / np.maximum(scaled, 1e-300))
    return weight


def _smoothed(sums: Blocks, terms: list[Term], weight: np.ndarray) -> tuple[list[Term], np.ndarray]:
    """The terms with the last one's smoothing by cross-validation, and errors of all blocks."""
    tried = []
    for smoothing in _SMOOTHING.tolist():
        one = [*terms[:-1], replace(terms[-1], smoothing=smoothing)]
        tried.append((one, sums.validated(_penalty(one, weight))))
    best = min(tried, key=lambda t: float(t[1].sum()))[1]

    def as_good(errors: np.ndarray) -> bool:
        lost = errors - best
        return bool(lost.sum() <= float(lost.std(ddof=1)) * np.sqrt(lost.size))

    # The smoothest within one standard error of the best (Breiman et al. 1984).
    return next(t for t in reversed(tried) if as_good(t[1]))


def _pays(saved: np.ndarray, left: np.ndarray, null: np.ndarray) -> bool:
    """Whether errors that are saved in blocks, (blocks,), are worthwhile and beyond chance."""
    spread = float(saved.std(ddof=1)) * np.sqrt(saved.size)
    of_left, of_all = _WORTHWHILE
    total = float(saved.sum())
    return (
        total > _SIGNIFICANT * spread
        and total > of_left * float(left.sum())
        and total > of_all * float(null.sum())
    )


def _periodic(
    balance: Balance,
    chosen: list[Term],
    weight: np.ndarray,
    block: np.ndarray,
    left: np.ndarray,
    alone: np.ndarray,
) -> tuple[int, float]:
    """Number of harmonics and period by which sines do as well as the position's spline, or 0.

    Args:
        balance: The windows.
        chosen: Terms with a spline of the position.
        weight: Of windows.
        block: Of windows.
        left: Errors of blocks in cross-validation with that spline.
        alone: Without it.
    """
    others = [t for t in chosen if t.variable != "position"]
    own = next(t for t in chosen if t.variable == "position")
    ends = own.knots[[0, -1]]
    span, middle = float(np.ptp(ends)), float(ends.mean())
    x = np.clip(balance.inputs["position"], *ends)
    rest = _design(others) if others else np.zeros((weight.size, 0))
    smooth = _penalty(others, weight) if others else np.zeros((0, 0))
    # What the others explain is taken out of target and sines (Frisch and Waugh 1933).
    root = np.sqrt(weight)[:, None]
    fixed = (rest * root).T @ (rest * root) + smooth
    fixed += 1e-10 * (np.trace(fixed) if others else 0.0) / max(len(fixed), 1) * np.eye(len(fixed))
    inverse = np.linalg.inv(fixed)

    def out_of(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        across = (rest * root).T @ columns
        return across, inverse @ across

    target = balance.gained[:, None] * root
    of_target = out_of(target)
    most = float((target.T @ target - of_target[0].T @ of_target[1])[0, 0])

    def averaged(columns: np.ndarray) -> np.ndarray:
        return np.asarray((columns * balance.gain[:, :, None]).mean(axis=1))

    def misfit(frequency: float, harmonics: int) -> float:
        waves = averaged(sines(x, 1.0 / frequency, harmonics, middle)) * root
        across, of_waves = out_of(waves)
        matrix = waves.T @ waves - across.T @ of_waves
        right = (waves.T @ target - of_waves.T @ of_target[0])[:, 0]
        matrix += 1e-10 * np.trace(matrix) / len(matrix) * np.eye(len(matrix))
        return most - float(right @ np.linalg.solve(matrix, right))

    def validated(columns: np.ndarray) -> float:
        own = averaged(columns)
        design = np.concatenate([rest, own], axis=1)
        penalty = diagonal_blocks([smooth, np.zeros((own.shape[1],) * 2)])
        return float(Blocks.of(design, balance.gained, weight, block).validated(penalty).sum())

    frequencies = np.arange(1.0 / _PERIODS[1], 1.0 / _PERIODS[0], 0.1) / span
    cubic = validated(((x - middle) / span)[:, :, None] ** np.arange(4))
    allowed = float(left.sum()) + _AS_GOOD * float((alone - left).sum())
    allowed = min(allowed, cubic)
    for harmonics, repeats in zip(_HARMONICS, _REPEATS, strict=True):
        tried = frequencies[frequencies * span >= repeats]
        costs = np.array([misfit(f, harmonics) for f in tried])
        # Half the frequency with every second harmonic is the same: the highest that does it.
        room = 0.02 * max(float(alone.sum()) - costs.min(), 0.0)
        near = np.flatnonzero(costs <= costs.min() + room)
        best: tuple[float, float] = (np.inf, 0.0)
        for start in sorted({int(near[-1]), int(np.argmin(costs))}, reverse=True):
            low, high = tried[max(start - 1, 0)], tried[min(start + 1, costs.size - 1)]
            found = minimize_scalar(
                misfit, bounds=(low, high), args=(harmonics,), method="bounded",
                options={"xatol": 1e-4 * low},
            )  # fmt: skip
            errors = validated(sines(x, 1.0 / found.x, harmonics, middle))
            if errors < 0.97 * best[0]:
                best = errors, 1.0 / float(found.x)
        if best[0] <= allowed:
            return harmonics, best[1]
    return 0, 0.0


def _estimated(
    balance: Balance,
    chosen: list[Term],
    harmonics: int,
    period: float,
    weight: np.ndarray,
    block: np.ndarray,
    left: np.ndarray,
    null: np.ndarray,
) -> Form:
    """Final estimate with its covariance."""
    knots = {t.variable: t.knots for t in chosen}
    columns, penalties = [], []
    smooth = _penalty(chosen, weight)
    place = 0
    middle = 0.0
    x = balance.inputs["position"]
    for t in chosen:
        own = slice(place, place + t.count)
        place += t.count
        if t.variable == "position" and harmonics:
            ends = t.knots[[0, -1]]
            middle = float(ends.mean())
            inside = np.clip(x, *ends)
            waves = sines(inside, period, harmonics, middle)
            columns.append((waves * balance.gain[:, :, None]).mean(axis=1))
            penalties.append(np.zeros((waves.shape[-1],) * 2))
            count = max(8, int(np.ceil(_KNOTS_A_PERIOD * harmonics * np.ptp(ends) / period)) + 1)
            knots["position"] = np.linspace(float(ends[0]), float(ends[-1]), count)
        else:
            columns.append(t.columns)
            penalties.append(smooth[own, own])
    design = np.concatenate(columns, axis=1)
    penalty = diagonal_blocks(penalties)
    sums = Blocks.of(design, balance.gained, weight, block)
    estimate = sums.solve(penalty)
    rest = balance.gained - design @ estimate
    if harmonics:
        # The period is one more unknown: d/dP of the waves at the estimate.
        place = 0
        for t, width in zip(chosen, (c.shape[1] for c in columns), strict=True):
            if t.variable == "position":
                break
            place += width
        place += 1 + 2 * harmonics
        inside = np.clip(x, knots["position"][0], knots["position"][-1])
        amplitude = estimate[place - 1 - 2 * harmonics : place]
        step = 1e-4 * period
        moved = [
            (sines(inside, period + s, harmonics, middle) @ amplitude * balance.gain).mean(axis=1)
            for s in (-step, step)
        ]
        slope = (moved[1] - moved[0]) / (2.0 * step)
        design = np.insert(design, place, slope, axis=1)
        estimate = np.insert(estimate, place, period)
        penalty = np.insert(np.insert(penalty, place, 0.0, axis=0), place, 0.0, axis=1)
    variance = float(weight @ rest**2 / weight.sum())
    memory = _neighbours(rest * np.sqrt(weight), balance)
    # Neighbouring windows that err alike count for fewer (Bartlett 1935).
    inflated = variance * (1.0 + memory) / max(1.0 - memory, 0.1)
    variances = inflated * weight.mean()
    return Form(
        balance=balance,
        variables=tuple(t.variable for t in chosen),
        knots=knots,
        harmonics=harmonics,
        values=estimate,
        information=(design * weight[:, None]).T @ design / variances,
        smoothness=penalty / variances,
        gain=1.0 - float(left.sum()) / float(null.sum()),
        left=float(1.4826 * np.median(np.abs(rest))),
        memory=memory,
    )


def _neighbours(rest: np.ndarray, balance: Balance) -> float:
    """Correlation of neighbouring windows, in [0, 1]."""
    step = np.median(np.diff(balance.time)[np.diff(balance.recording) == 0])
    together = (np.diff(balance.recording) == 0) & (np.diff(balance.time) < 1.5 * step)
    limit = 4.0 * np.median(np.abs(rest)) + 1e-300
    calm = np.clip(rest, -limit, limit)
    a, b = calm[:-1][together], calm[1:][together]
    if a.size < 10 or a.std() == 0.0 or b.std() == 0.0:
        return 0.0
    return float(np.clip(np.corrcoef(a, b)[0, 1], 0.0, 0.95))


def diagonal_blocks(blocks: Sequence[np.ndarray]) -> np.ndarray:
    """A square matrix with square blocks along its diagonal."""
    total = sum(len(b) for b in blocks)
    out = np.zeros((total, total))
    place = 0
    for b in blocks:
        out[place : place + len(b), place : place + len(b)] = b
        place += len(b)
    return out
