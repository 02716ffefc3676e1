"""Form (variables, additive or periodic) of the remainder: what effects leave of a balance."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import minimize_scalar

from leglab.base.scale import deviation
from leglab.diagnosis.balance.balances import Balance
from leglab.diagnosis.remainder.part import Part, Periodicity
from leglab.diagnosis.remainder.splines import CubicSpline, basis, nearest, roughness
from leglab.diagnosis.thresholds import DEFAULT, Thresholds


@dataclass(frozen=True, kw_only=True, eq=False)
class Term:
    """Additive term of a remainder in one variable, before its coefficients are estimated."""

    variable: str
    knots: np.ndarray  #: Knots of its spline, shape (knots,)
    columns: np.ndarray  #: d(a window's mean residual)/d(unknown), (windows, unknowns)
    penalty: np.ndarray  #: Matrix of the roughness, (unknowns, unknowns)
    #: d(spline coefficient)/d(unknown), (knots + 2, unknowns); None if the coefficients are the
    #: unknowns. The unknowns of sines are a constant, the amplitudes of cosine and sine of each
    #: harmonic and, in a `Form`, the change of the period.
    shape: np.ndarray | None = None
    smoothing: float = 0.0  #: Weight of the roughness, relative to the columns' squares

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return self.columns.shape[1]


class Form:
    """Variables and functions that describe one balance's remainder, with a first estimate.

    The unknowns of all terms are concatenated. A term of sines is the last term, `period` is its
    period (None without sines), and the last unknown is the change of this period. `gain` is the
    share of the balance's squared residual that the form explains in cross-validation.

    Attributes:
        values: Estimate, (unknowns,).
        precision: Inverse covariance, including the smoothness penalty, (unknowns, unknowns).
    """

    def __init__(
        self, fits: "_Fits", terms: tuple[Term, ...], period: float | None, gain: float
    ) -> None:
        self.balance, self.period, self.gain = fits.balance, period, gain
        values = fits.solved(terms)
        rest = fits.target - fits.design(terms) @ values
        # Correlated neighbouring windows count as fewer independent windows (Bartlett 1935).
        memory = _neighbours(rest * np.sqrt(fits.weight), fits.balance)
        variance = float(fits.weight @ rest**2) / fits.target.size
        variance *= (1.0 + memory) / max(1.0 - memory, 0.1)
        if period is not None:
            *others, own = terms
            harmonics, waves = (own.count - 1) // 2, values[-own.count :]
            terms = (*others, fits.sines(own, period, harmonics, waves))
            values = np.append(values, 0.0)
        design = fits.design(terms)
        precision = (design * fits.weight[:, None]).T @ design + fits.penalty(terms)
        self.terms, self.values, self.precision = terms, values, precision / variance

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the estimate, (unknowns, unknowns)."""
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self.precision), 1e-300))
        both = np.outer(scale, scale)
        return np.asarray(np.linalg.pinv(self.precision * both, rcond=1e-12, hermitian=True) * both)

    def part(self, values: np.ndarray) -> Part:
        """Returns the learned part for values of the unknowns."""
        splines, period = {}, None
        pieces = np.split(values, np.cumsum([term.count for term in self.terms])[:-1])
        for term, own in zip(self.terms, pieces, strict=True):
            coefficients = own if term.shape is None else term.shape @ own
            splines[term.variable] = CubicSpline(knots=term.knots, coefficients=coefficients)
        if self.period is not None:
            length, half = self.period + values[-1], 1.96 * np.sqrt(self.covariance[-1, -1])
            period = Periodicity(
                length=float(length),
                interval=(float(length - half), float(length + half)),
                amplitudes=tuple(np.hypot(*pieces[-1][1:-1].reshape(-1, 2).T).tolist()),
            )
        return Part(
            element=self.balance.element,
            joint=self.balance.joint,
            actuator=self.balance.actuator,
            oil=self.balance.oil,
            terms=splines,
            period=period,
        )


def choose_form(
    balance: Balance, *, driven_by_oil: bool, limits: Thresholds = DEFAULT
) -> Form | None:
    """Adds variables one by one by cross-validation over blocks of time; None if none helps.

    If a cylinder drives the joint, its command is not a force and is therefore not tried.
    """
    if len(balance.lacking) < limits.learned_windows:
        return None
    candidates = _candidates(balance, driven_by_oil)
    fits = _Fits(balance, candidates)
    null = left = fits.errors(())
    chosen: tuple[Term, ...] = ()
    while candidates:
        tried = [fits.smoothed(chosen, term) for term in candidates]
        terms, errors = min(tried, key=lambda t: float(t[1].sum()))
        if not worthwhile(left - errors, float(left.sum()), limits):
            break
        chosen, left = terms, errors
        candidates = [t for t in candidates if t.variable != terms[-1].variable]
    if not chosen:
        return None
    period = None
    if "position" in [term.variable for term in chosen] and not balance.oil:
        chosen, period = _periodic(fits, chosen, left, limits)
    return Form(fits, chosen, period, gain=1.0 - float(left.sum()) / float(null.sum()))


def _candidates(balance: Balance, driven_by_oil: bool) -> list[Term]:
    """Returns a candidate term for each variable that varies in the data."""
    found = []
    for variable, x in balance.inputs.items():
        if variable == "command" and not balance.oil:
            load = balance.inputs["load"]
            same = load.std() * x.std() > 0.0 and np.corrcoef(x.flat, load.flat)[0, 1] ** 2 > 0.998
            if driven_by_oil or same:
                continue
        knots = _knots(variable, x)
        if knots is not None:
            columns, rough = _mean(balance, basis(knots, x)), roughness(knots)
            found.append(Term(variable=variable, knots=knots, columns=columns, penalty=rough))
    return found


def _knots(variable: str, x: np.ndarray) -> np.ndarray | None:
    """Returns knots over the range of the variable's data; None if the data are constant.

    Friction and valve flow change most near zero, so knots of velocity and command are dense there:
    their spacing is even up to a tenth of the largest value and grows exponentially beyond.
    """
    low, high = np.quantile(x, [0.002, 0.998]).tolist()
    if not high - low > 1e-9 * max(abs(low), abs(high), 1e-9):
        return None
    count = {"position": 24, "load": 7}.get(variable, 11)
    if variable not in ("velocity", "command") or not low < 0.0 < high:
        return np.linspace(low, high, count)
    width = 0.1 * max(-low, high)
    first, last = np.arcsinh(np.array([low, high]) / width).tolist()
    knots = width * np.sinh(np.linspace(first, last, count))
    knots[[0, -1]] = low, high
    return np.asarray(knots)


def _mean(balance: Balance, functions: np.ndarray) -> np.ndarray:
    """Averages functions of the samples, times the gain, over each window, (windows, functions)."""
    return np.asarray((functions * balance.gain[:, :, None]).mean(axis=1))


def worthwhile(saved: np.ndarray, misfit: float, limits: Thresholds) -> bool:
    """Tests whether the errors removed are significant and not a minor share of `misfit`."""
    total = float(saved.sum())
    return total > limits.beyond_chance * _chance(saved) and total > limits.worthwhile * misfit


def _chance(values: np.ndarray) -> float:
    """Computes the standard error of the sum of values."""
    return float(values.std(ddof=1)) * np.sqrt(values.size)


class _Fits:
    """Robustly weighted fits of terms to one balance, and the fits' errors in cross-validation.

    A fit of all candidate terms together determines which windows are outliers.
    """

    def __init__(self, balance: Balance, candidates: Sequence[Term]) -> None:
        self.balance, self.target = balance, balance.gained
        # Errors within a second are correlated, so blocks for cross-validation last a second.
        second = np.floor(balance.time - balance.time.min()).astype(int)
        block = balance.recording * (second.max() + 1) + second
        self.blocks = [np.flatnonzero(block == k) for k in np.unique(block)]
        base = np.ones(self.target.size)
        if balance.oil:  # errors grow with the gain, which is small near a closed valve
            size = np.abs(balance.gain).mean(axis=1)
            base = 1.0 / (size**2 + (0.1 * np.median(size)) ** 2)
        self.weight = base
        terms = [replace(term, smoothing=1e-3) for term in candidates]
        for _ in range(4):  # Outliers weigh less (Huber 1964).
            scaled = np.abs(self.target - self.design(terms) @ self.solved(terms)) * np.sqrt(base)
            level = 2.5 * deviation(scaled) + 1e-300
            self.weight = base * np.minimum(1.0, level / np.maximum(scaled, 1e-300))

    def design(self, terms: Sequence[Term]) -> np.ndarray:
        """Concatenates the derivatives `columns` of all terms, (windows, unknowns)."""
        return np.concatenate([np.zeros((self.target.size, 0)), *(t.columns for t in terms)], 1)

    def penalty(self, terms: Sequence[Term]) -> np.ndarray:
        """Computes the roughness penalty of all terms and a small ridge, (unknowns, unknowns)."""
        blocks = [np.zeros((0, 0))]
        for term in terms:
            size = float(self.weight @ (term.columns**2).sum(axis=1))
            ridge = 1e-6 * np.eye(term.count) / term.count
            blocks.append(size * (term.smoothing * term.penalty + ridge))
        return np.asarray(block_diag(*blocks))

    def sums(self, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray]:
        """Computes X'WX, (blocks, unknowns, unknowns), and X'Wy, (blocks, unknowns), of terms."""
        design = self.design(terms)
        weighted = design * self.weight[:, None]
        matrices = np.stack([weighted[r].T @ design[r] for r in self.blocks])
        return matrices, np.stack([weighted[r].T @ self.target[r] for r in self.blocks])

    def solved(self, terms: Sequence[Term]) -> np.ndarray:
        """Computes the penalised estimate of the unknowns."""
        return _solved(*self.sums(terms), self.penalty(terms))

    def errors(
        self, terms: Sequence[Term], sums: tuple[np.ndarray, np.ndarray] | None = None
    ) -> np.ndarray:
        """Computes squared errors of blocks of time in fivefold cross-validation, (blocks,)."""
        matrices, rights = sums or self.sums(terms)
        penalty = self.penalty(terms)
        out = np.array([self.weight[r] @ self.target[r] ** 2 for r in self.blocks])
        fold = np.arange(out.size) % 5
        for k in range(5):
            own = fold == k
            x = _solved(matrices[~own], rights[~own], penalty)
            out[own] += np.einsum("i,bij,j->b", x, matrices[own], x) - 2.0 * rights[own] @ x
        return np.maximum(out, 0.0)

    def smoothed(self, chosen: tuple[Term, ...], new: Term) -> tuple[tuple[Term, ...], np.ndarray]:
        """Adds a term, smoothed by cross-validation; returns all terms and the blocks' errors."""
        sums = self.sums((*chosen, new))
        tried = []
        # Weights of the roughness, from no smoothing to almost a straight line.
        for smoothing in (10.0 ** np.arange(-7.0, 3.0)).tolist():
            terms = (*chosen, replace(new, smoothing=smoothing))
            tried.append((terms, self.errors(terms, sums)))
        best = min(tried, key=lambda t: float(t[1].sum()))[1]
        # The smoothest term within one standard error of the least error (Breiman et al. 1984).
        return next(t for t in reversed(tried) if (t[1] - best).sum() <= _chance(t[1] - best))

    def sines(
        self, own: Term, period: float, harmonics: int, amplitudes: np.ndarray | None = None
    ) -> Term:
        """Replaces the position's spline by sines; adds d/d(period) if `amplitudes` are passed."""
        low, high = own.knots[0], own.knots[-1]

        def waves(x: np.ndarray) -> np.ndarray:
            x = np.clip(x, low, high) - 0.5 * (low + high)
            columns = sines(x, period, harmonics)
            if amplitudes is None:
                return columns
            step = 1e-4 * period
            there, back = (sines(x, period + s, harmonics) for s in (step, -step))
            slope = (there - back) @ amplitudes / (2.0 * step)
            return np.concatenate([columns, slope[..., None]], axis=-1)

        # With this number of knots a cubic spline approximates a sine to a thousandth.
        knots = np.linspace(low, high, max(8, int(np.ceil(14 * harmonics * (high - low) / period))))
        grid = np.linspace(low, high, 12 * knots.size)
        shape = nearest(knots, grid, waves(grid))
        columns = _mean(self.balance, waves(self.balance.inputs["position"]))
        none = np.zeros((columns.shape[1],) * 2)
        return replace(own, knots=knots, columns=columns, penalty=none, shape=shape, smoothing=0.0)


def _solved(matrices: np.ndarray, rights: np.ndarray, penalty: np.ndarray) -> np.ndarray:
    """Solves for the unknowns, with a penalty, from the matrices X'WX and X'Wy of all blocks."""
    matrix = matrices.sum(axis=0) + penalty
    ridge = 1e-10 * np.trace(matrix) / max(len(matrix), 1) + 1e-300
    return np.linalg.solve(matrix + ridge * np.eye(len(matrix)), rights.sum(axis=0))


def sines(x: np.ndarray, period: float, harmonics: int) -> np.ndarray:
    """Computes a constant, then cosine and sine of each harmonic, (..., 1 + 2 harmonics)."""
    angle = 2.0 * np.pi / period * x[..., None] * np.arange(1, harmonics + 1)
    waves = np.stack([np.cos(angle), np.sin(angle)], axis=-1).reshape(*x.shape, -1)
    return np.concatenate([np.ones((*x.shape, 1)), waves], axis=-1)


def _periodic(
    fits: _Fits, chosen: tuple[Term, ...], left: np.ndarray, limits: Thresholds
) -> tuple[tuple[Term, ...], float | None]:
    """Replaces the position's spline by sines if sines fit as well; returns terms and period.

    `left` are the blocks' errors in cross-validation with the spline.
    """
    others = tuple(term for term in chosen if term.variable != "position")
    (own,) = (term for term in chosen if term.variable == "position")
    span, middle = float(np.ptp(own.knots)), float(own.knots[[0, -1]].mean())
    x = np.clip(fits.balance.inputs["position"], *own.knots[[0, -1]]) - middle
    # The other terms are projected out of target and sines (Frisch and Waugh 1933).
    root = np.sqrt(fits.weight)[:, None]
    smooth = np.linalg.cholesky(fits.penalty(others)).T
    known = np.linalg.qr(np.concatenate([fits.design(others) * root, smooth]))[0]

    def beside(columns: np.ndarray) -> np.ndarray:
        full = np.concatenate([columns * root, np.zeros((len(smooth), columns.shape[1]))])
        return np.asarray(full - known @ (known.T @ full))

    target = beside(fits.target[:, None])[:, 0]

    def misfit(frequency: float, harmonics: int) -> float:
        waves = beside(_mean(fits.balance, sines(x, 1.0 / frequency, harmonics)))
        found = np.linalg.lstsq(waves, target, rcond=None)[0]
        return float(np.sum((target - waves @ found) ** 2))

    alone = float(fits.errors(others).sum())
    # Sines may fit a little worse than the spline, but not worse than a cubic polynomial.
    powers = _mean(fits.balance, (x / span)[:, :, None] ** np.arange(4))
    cubic = replace(own, columns=powers, penalty=np.zeros((4, 4)), smoothing=0.0)
    room = limits.worthwhile * (alone - float(left.sum()))
    allowed = min(float(left.sum()) + room, float(fits.errors((*others, cubic)).sum()))
    # Periods from a little more than the range to a twentieth of it. Overtones fit any curve over
    # one period, so forms with overtones have to repeat within the range.
    frequencies = np.arange(0.87, 20.0, 0.1) / span
    for harmonics, repeats in ((1, 0.0), (2, 1.3), (3, 1.8)):
        tried = frequencies[frequencies * span >= repeats]
        costs = np.array([misfit(f, harmonics) for f in tried])
        # Half the true frequency fits as well by its even harmonics, so the highest is tried first.
        least = costs.min()
        near = np.flatnonzero(costs <= least + limits.worthwhile * max(alone - least, 0.0))
        best = np.inf, chosen, 0.0
        for start in sorted({int(near[-1]), int(np.argmin(costs))}, reverse=True):
            low, high = tried[max(start - 1, 0)], tried[min(start + 1, costs.size - 1)]
            found = minimize_scalar(
                misfit, bounds=(low, high), args=(harmonics,), method="bounded",
                options={"xatol": 1e-4 * low},
            )  # fmt: skip
            terms = (*others, fits.sines(own, 1.0 / found.x, harmonics))
            errors = float(fits.errors(terms).sum())
            if errors < (1.0 - limits.worthwhile) * best[0]:
                best = errors, terms, 1.0 / float(found.x)
        if best[0] <= allowed:
            return best[1], best[2]
    return chosen, None


def _neighbours(rest: np.ndarray, balance: Balance) -> float:
    """Computes the correlation of neighbouring windows' errors `rest`, clipped to [0, 0.95]."""
    step = np.median(np.diff(balance.time)[np.diff(balance.recording) == 0])
    together = (np.diff(balance.recording) == 0) & (np.diff(balance.time) < 1.5 * step)
    limit = 4.0 * np.median(np.abs(rest)) + 1e-300
    calm = np.clip(rest, -limit, limit)
    a, b = calm[:-1][together], calm[1:][together]
    if a.size < 10 or a.std() == 0.0 or b.std() == 0.0:
        return 0.0
    return float(np.clip(np.corrcoef(a, b)[0, 1], 0.0, 0.95))
