"""Choice of a structure by the free run over blocks that no fit has seen.

A structure is scored by the mean logarithm of its error over the blocks, each simulated in one go
by a model that was chosen and fitted on the others. So neither lags nor the number of features can
be fitted to the block. The mean of logarithms keeps a single block that exceeds the range of the
others from deciding. Eighths test interpolation, thirds extrapolation; a nonlinear model is taken
only if it is better than the linear ones in both.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from leglab.identification.spline_state_space import StateSpace
from leglab.identification.structure import library
from leglab.identification.structure.fit import (
    ITERATIONS,
    LEAST_SHARE,
    SHORTEST,
    Array,
    Features,
    Fit,
    Further,
    Problem,
    Simulator,
    Stretch,
    fit,
    one_step,
    prior,
    solve,
    startable,
)
from leglab.identification.structure.library import Orders
from leglab.identification.structure.states import StatePath, refitted

BLOCKS = (8, 3)
# Simulated samples of a fit. Parameters hardly depend on more; the last fit has all up to LAST.
SKETCH, FULL, LAST = 4000, 12000, 100_000
_LEAD_IN = 10_000  # samples of a free run before the block that is scored
_OVERLAP = 4  # stretches that contain a sample
_TRIED = 3  # features of the largest promise that are fitted, of which the best is taken
_GLANCE, _STEPS = 3, 10  # iterations of their fits, and further ones of the best
_WORTH = 0.997  # a feature that leaves more of the RMS error of the fit ends a path
# A path ends after _PATIENCE features in a row that leave more than this share of the score; the
# last of them are not taken.
_PATIENCE, _PROGRESS = 3, 0.99
MOST_TERMS, FEW_TERMS = 20, 5
MOST_CURVES = 4  # of a state-space model
STATES_BUDGET = 3000  # samples of its fits, which cost more than those of lags
_STATES = (1, 2, 3, 4, 6)
STATES_STRENGTHS = (10.0, 100.0, 1000.0)
_KEPT = 3  # structures of the first search that are searched in full
_LINEAR = ((1, 1), (1, 2), (2, 2), (2, 3), (3, 3), (3, 4), (2, 6), (3, 6), (4, 6), (6, 6), (8, 9),
           (12, 12), (16, 16))  # fmt: skip
_BENT = ((1, 2), (2, 3), (3, 4), (3, 6), (4, 6))
# Samples per parameter of a linear structure, at least: it bounds the time of the search; the prior
# and the unseen blocks decide above it.
_SAMPLES = 5
_MOST_LAGS = 24  # of all signals, from which terms are made
_DELAYS = (0, 1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 25, 32)
# Samples of a stretch; the best length is the memory of the machine, which the blocks decide.
_LENGTHS = (SHORTEST, 200, 600)
# Precision of the prior. With white errors and parameters of about one it would be one; errors of
# a free run are correlated, which makes N samples worth a tenth or a hundredth.
_STRENGTHS = (1.0, 10.0, 100.0)
_USUAL = 10.0
# Linear models, by the free run or by least squares of one step, which is better where the machine
# is disturbed rather than its sensor.
LINEAR = ("linear", "one step")
STATES = "states"  # state-space models with curves
CONSTANT = "constant"
SIMPLE = (*LINEAR, CONSTANT)


Table = tuple[tuple[float, ...], ...]
Each = Callable[..., Iterable]  # `map`, or one that has threads


@dataclass(frozen=True)
class Plan:
    """A structure that is searched.

    Attributes:
        kind: Of `SIMPLE`, of the library, or `STATES`.
        orders: Its lags; of a state-space model outputs are its states.
        length: Samples of a stretch of its fits.
        strength: Of the prior of its parameters.
        most: Features beyond the linear ones.
        budget: Samples that a fit simulates.
        sketch: Whether it only finds out, on thirds, if the structure is worth more.
    """

    kind: str
    orders: Orders
    length: int
    strength: float = _USUAL
    most: int = 0
    budget: int = FULL
    sketch: bool = False


@dataclass(frozen=True)
class Candidate:
    """Result of a plan.

    Attributes:
        plan: The plan.
        fit: The model, fitted to all records.
        held_out: Mean square of the error over each eighth, and each third, of the records, as a
            share of the output's variance; of a sketch over each third.
        path: Score at each number of features.
    """

    plan: Plan
    fit: Fit
    held_out: tuple[tuple[float, ...], ...]
    path: tuple[float, ...]

    @property
    def scores(self) -> tuple[float, ...]:
        """RMS error over eighths and thirds, geometric mean, in deviations of the output."""
        return tuple(map(score_of, self.held_out))

    @property
    def score(self) -> float:
        """Geometric mean of both."""
        return _mean_score(self.held_out)


def score_of(held_out: Sequence[float] | Array) -> float:
    """Geometric mean of RMS errors, from their squares."""
    return float(np.exp(np.mean(np.log(held_out)) / 2))


def _mean_score(held_out: Sequence[Sequence[float]]) -> float:
    return float(np.exp(np.mean([np.log(score_of(part)) for part in held_out])))


def blocks(problem: Problem, depth: int, count: int) -> list[Stretch]:
    """About so many blocks of all records, which are held out in turn."""
    out = []
    total = sum(map(len, problem.records))
    for k, record in enumerate(problem.records):
        pieces = max(1, round(count * len(record) / total))
        usable = np.flatnonzero(startable(record, depth))
        if len(usable) < 2 * pieces:
            continue
        edges = usable[np.linspace(0, len(usable) - 1, pieces + 1).astype(int)]
        edges[-1] = len(record)
        out += [Stretch(k, int(a), int(b - a)) for a, b in pairwise(edges)]
    return out


def lead_in(problem: Problem, block: Stretch, depth: int) -> int:
    """Sample at which the free run begins whose error is that of a block."""
    usable = np.flatnonzero(startable(problem.records[block.record], depth))
    return int(usable[np.searchsorted(usable, max(0, block.start - _LEAD_IN))])


def stretches(
    problem: Problem, depth: int, length: int, budget: int, without: Stretch | None = None
) -> list[Stretch]:
    """Stretches of a fit, outside of a block that is held out."""
    out: list[Stretch] = []
    while not out and length > 1:
        for k, record in enumerate(problem.records):
            size = min(length, len(record) - depth)
            if size < 1:
                continue
            usable = startable(record, depth)
            for start in range(depth, len(record) - size + 1, max(1, size // _OVERLAP)):
                if usable[start] and not _touches(Stretch(k, start, size), without, depth):
                    out.append(Stretch(k, start, size))
        length //= 2
    total = sum(s.length for s in out)
    if total <= budget:
        return out
    keep = max(2, int(len(out) * budget / total))
    return [out[i] for i in np.unique(np.linspace(0, len(out) - 1, keep).round().astype(int))]


def _touches(stretch: Stretch, block: Stretch | None, depth: int) -> bool:
    return (
        block is not None
        and block.record == stretch.record
        and stretch.start + stretch.length > block.start
        and stretch.start - depth < block.start + block.length
    )


class Path:
    """Models that grow by the feature that promises to explain most of the free run's error."""

    def __init__(
        self,
        problem: Problem,
        start: Fit,
        further: Further,
        own: list[Stretch],
        strength: float,
    ) -> None:
        self._problem, self._further, self._stretches = problem, further, own
        self._strength = strength
        self.fit, self.ended = start, False

    def grow(self) -> None:
        """Takes one more feature, or ends where none is worth it."""
        self.ended = self.ended or not self._further.features
        if self.ended:
            return
        gains = promises(self._problem, self.fit, self._further, self._stretches, self._strength)
        best: tuple[Fit, int] | None = None
        for k in np.argsort(-gains, kind="stable")[:_TRIED]:
            theta = np.append(self.fit.theta, np.zeros(self._further.blocks[k].count))
            features = (*self.fit.features, self._further.features[k])
            tried = self._fitted(features, theta, _GLANCE)
            if best is None or tried.error < best[0].error:
                best = tried, int(k)
        if best is not None:
            best = self._fitted(best[0].features, best[0].theta, _STEPS), best[1]
        if best is None or best[0].error > _WORTH * self.fit.error:
            self.ended = True
            return
        self.fit, taken = best
        self._further = self._further.without(taken)

    def _fitted(self, features: Features, theta: Array, iterations: int) -> Fit:
        own = self._problem.lagged(features).features
        return fit(self._problem, own, theta, self._stretches, self._strength, iterations)


def promises(
    problem: Problem, now: Fit, further: Further, own: Sequence[Stretch], strength: float
) -> Array:
    """Computes the share of the squared error that each feature explains in addition to the model.

    To first order: with the sensitivities D of a feature, those J of the model, and the errors r,
    the gain is b' G^-1 b with G = D'D - D'J (J'J)^-1 J'D and b = D'r - D'J (J'J)^-1 J'r.
    """
    settings = problem.lagged(now.features)
    simulator = Simulator(settings, problem.records, further.blocks)
    found = simulator.sums(now.theta, own, sensitivities=True)
    scale = max(found.error, LEAST_SHARE)
    p = len(now.theta)
    share = strength / problem.count
    form = share * prior(settings.features, settings.blocks)
    hessian = found.products[:p] / scale + form
    downhill = found.gradient[:p] / scale - form @ now.theta
    cross = found.products[p:] / scale
    inner = solve(hessian, np.column_stack([cross.T, downhill]))
    left = found.gradient[p:] / scale - cross @ inner[:, -1]
    sizes = np.array([block.count for block in further.blocks])
    ends, corners = np.cumsum(sizes), np.cumsum(sizes * (sizes + 1) // 2)
    beside = np.einsum("ij,ji->i", cross, inner[:, :-1])  # diagonal of D'J (J'J)^-1 J'D
    gains = np.zeros(len(sizes))
    single = sizes == 1
    at = ends[single] - 1
    gram = found.squares[corners[single] - 1] / scale + share - beside[at]
    # Rounding may leave less than the prior.
    gains[single] = left[at] ** 2 / np.maximum(gram, share)
    for k in np.flatnonzero(~single):
        n = sizes[k]
        rows = slice(ends[k] - n, ends[k])
        block = np.zeros((n, n))
        block[np.tril_indices(n)] = (
            found.squares[corners[k] - n * (n + 1) // 2 : corners[k]] / scale
        )
        block += np.tril(block, -1).T
        block += share * prior(further.features[k : k + 1], further.blocks[k : k + 1])
        block -= cross[rows] @ inner[:, :-1][:, rows]
        gains[k] = left[rows] @ solve(block, left[rows])
    return np.where(np.isfinite(gains), gains, 0.0)


def searched(problem: Problem, plan: Plan, each: Each = map) -> Candidate:
    """Carries out a plan: paths in step with each block held out, then one on all records.

    Args:
        problem: Records and signals.
        plan: The plan.
        each: Applies a function to the blocks, as `map` does.
    """
    if plan.sketch and plan.kind == STATES:
        return _sketched(problem, plan, each)
    depth, begun = _beginning(problem, plan)
    held = Held(problem, depth, _counts(plan))
    flat = list(each(begun, held.all))
    grown: list[list[Fit]] = []  # fits without each block, by size

    def sizes() -> Iterator[Table]:
        while True:
            grown.append([path.fit for path in flat])
            yield held.errors(grown[-1])
            if all(path.ended for path in flat):
                return
            list(each(lambda path: path.grow(), flat))

    table, tried = _table(sizes(), plan.most)
    whole = begun(None)
    for _ in range(len(table) - 1):
        whole.grow()
    best = whole.fit
    if plan.kind == STATES:
        best = _best_minimum(problem, plan, best, grown[len(table) - 1])
    return Candidate(plan, best, table[-1], tried)


def _best_minimum(problem: Problem, plan: Plan, first: Fit, others: Sequence[Fit]) -> Fit:
    """The first fit, unless one that begins at another is likelier by more than a nat.

    The strength of the prior says how many samples tell as much as one independent error.
    """
    fits = [refitted(problem, one, plan.strength, plan.budget) for one in others]
    best = min(fits, key=lambda one: one.error)
    gained = 2 * np.log(first.error / max(best.error, LEAST_SHARE))
    return best if gained * problem.count / plan.strength > 1 else first


def _counts(plan: Plan) -> tuple[int, ...]:
    return BLOCKS[-1:] if plan.sketch else BLOCKS


def _beginning(
    problem: Problem, plan: Plan
) -> tuple[int, Callable[[Stretch | None], Path | StatePath]]:
    """Samples that a model needs to start, and its path with a block held out."""
    orders = plan.orders
    if plan.kind == STATES:
        structure = StateSpace(states=orders.outputs, delays=orders.delays)
        depth = problem.model((structure,)).lags
        return depth, lambda b: StatePath(problem, structure, plan.strength, plan.budget, b)
    linear = orders.linear(problem)
    makers = {**library.KINDS, **library.REFINED}.get(plan.kind)
    further = Further(problem.template, makers(problem, orders) if makers else ())
    depth = problem.model(linear).lags + 1  # that of a change, too

    def begun(block: Stretch | None) -> Path:
        own = stretches(problem, depth, plan.length, plan.budget, block)
        iterations = ITERATIONS if plan.kind != "one step" else 0
        theta = one_step(problem, linear, block)
        start = fit(problem, linear, theta, own, plan.strength, iterations)
        return Path(problem, start, further, own, plan.strength)

    return depth, begun


def _sketched(problem: Problem, plan: Plan, each: Each) -> Candidate:
    """A path on all records, fitted anew at each size with each block held out.

    The fits without a block begin at that with it and take a tenth of the time. They still know a
    little of the block, so this ranks state-space models among each other and nothing else.
    """
    structure = StateSpace(states=plan.orders.outputs, delays=plan.orders.delays)
    held = Held(problem, problem.model((structure,)).lags, _counts(plan))
    path = StatePath(problem, structure, plan.strength, plan.budget)

    def sizes() -> Iterator[Table]:
        while not path.ended:
            yield held.errors(list(each(path.without, held.all)))
            path.grow()

    table, tried = _table(sizes(), plan.most)
    return Candidate(plan, path.fit, table[-1], tried)


class Held:
    """Blocks that are held out: eighths and thirds of all records, or others."""

    def __init__(self, problem: Problem, depth: int, counts: tuple[int, ...] = BLOCKS) -> None:
        self._problem = problem
        parts = [blocks(problem, depth, count) for count in counts]
        self.all = [block for part in parts for block in part]
        self._firsts = [lead_in(problem, block, depth) for block in self.all]
        self._ends = np.cumsum([len(part) for part in parts])

    def errors(self, fits: Sequence[Fit]) -> Table:
        """Mean square of the error over each block, of the model that was fitted without it."""
        found = [
            self._problem.error_of(*one) for one in zip(fits, self.all, self._firsts, strict=True)
        ]
        starts = [0, *self._ends[:-1]]
        return tuple(tuple(found[a:b]) for a, b in zip(starts, self._ends, strict=True))


def _table(sizes: Iterator[Table], most: int) -> tuple[list[Table], tuple[float, ...]]:
    """Errors up to the smallest number of features that is nearly the best, and scores of all."""
    table: list[Table] = []
    scores: list[float] = []
    best, since = np.inf, 0
    for errors in sizes:
        table.append(errors)
        scores.append(_mean_score(errors))
        since = 0 if scores[-1] < _PROGRESS * best else since + 1
        best = min(best, scores[-1])
        if len(table) > most or since >= _PATIENCE:
            break
    size = next(k for k, score in enumerate(scores) if score * _PROGRESS <= min(scores))
    return table[: size + 1], tuple(scores)


def delays(problem: Problem) -> tuple[int, ...]:
    """Delay of each input, by the free run of a second-order linear model."""
    allowed = [d for d in _DELAYS if d <= _longest(problem) // 20]
    found = [0] * len(problem.template.inputs)
    for j in range(len(found)):
        errors = []
        for d in allowed:
            orders = Orders(2, 3, (*found[:j], d, *found[j + 1 :]))
            features = orders.linear(problem)
            own = stretches(problem, problem.model(features).lags, _LENGTHS[1], SKETCH)
            start = one_step(problem, features)
            errors.append(fit(problem, features, start, own, _USUAL).error)
        # The shortest of nearly equal ones: a delay that is too long cannot be made up for.
        least = min(errors)
        found[j] = next(d for d, e in zip(allowed, errors, strict=True) if e <= 1.01 * least)
    return tuple(found)


def _longest(problem: Problem) -> int:
    return max(map(len, problem.records))


def _lengths(problem: Problem) -> list[int]:
    most = max(2, _longest(problem) // 4)
    return list(dict.fromkeys(min(n, most) for n in _LENGTHS))


def plans_linear(problem: Problem, lead: tuple[int, ...]) -> list[Plan]:
    """Linear structures, and the constant that they have to beat."""
    lengths = _lengths(problem)
    return [
        Plan(CONSTANT, Orders(0, 0, lead), lengths[0]),
    ] + [
        Plan(kind, Orders(ny, nu, delays_), lengths[len(lengths) // 2])
        for kind in LINEAR
        for ny, nu in _LINEAR
        for delays_ in dict.fromkeys((lead, (0,) * len(lead)))
        # The smallest structure is always tried, also with few samples and many inputs.
        if (ny, nu) == _LINEAR[0] or ny + nu * len(lead) <= problem.count // _SAMPLES
    ]


def plans_tuned(problem: Problem, linear: Sequence[Candidate]) -> list[Plan]:
    """The best linear structures, with other stretches and priors."""
    return [
        replace(c.plan, length=length, strength=strength)
        for c in sorted(_of("linear", linear), key=_score)[:_KEPT]
        for length in _lengths(problem)
        for strength in _STRENGTHS
        if (length, strength) != (c.plan.length, c.plan.strength)
    ]


def plans_lags(problem: Problem, linear: Sequence[Candidate]) -> list[Plan]:
    """Structures of lags with a few nonlinear features."""
    best = [min(_of(kind, linear), key=_score).plan for kind in LINEAR]
    inputs = len(problem.template.inputs)
    orders = [p.orders for p in best if p.orders.outputs + inputs * p.orders.inputs <= _MOST_LAGS]
    for ny, nu in _BENT:
        most = max(1, (_MOST_LAGS - ny) // inputs)
        orders.append(Orders(ny, min(nu, most), best[0].orders.delays))
    return [
        Plan(kind, one, best[0].length, most=FEW_TERMS, budget=SKETCH)
        for one in dict.fromkeys(orders)
        for kind in library.KINDS
    ]


def plans_states(linear: Sequence[Candidate]) -> list[Plan]:
    """State-space models of all orders."""
    lead = min(linear, key=_score).plan.orders.delays
    return [
        Plan(STATES, Orders(n, 0, delays), 0, _STRENGTHS[-1], MOST_CURVES, STATES_BUDGET, True)
        for n in _STATES
        for delays in dict.fromkeys((lead, (0,) * len(lead)))
    ]


def plans_full(candidates: Sequence[Candidate]) -> list[Plan]:
    """The best once more: sketches in earnest, lags with all samples and many features."""
    best = [c.plan for c in sorted(candidates, key=_score)[:_KEPT]]
    return [
        replace(plan, sketch=False)
        if plan.kind == STATES
        else replace(plan, most=MOST_TERMS, budget=FULL)
        for plan in best
        if plan.sketch or plan.kind != STATES
    ]


def plans_varied(problem: Problem, bent: Sequence[Candidate]) -> list[Plan]:
    """The best of lags and the best state-space model, unless the other beats it, varied."""
    families = (_of(STATES, bent), [c for c in bent if c.plan.kind != STATES])
    best = [min(family, key=_score) for family in families if family]
    plans = []
    for one in best:
        if not any(_beats(other, one) for other in best if other is not one):
            plans += _variants(problem, one.plan)
    known = {candidate.plan for candidate in bent}
    return [plan for plan in dict.fromkeys(plans) if plan not in known]


def _variants(problem: Problem, plan: Plan) -> list[Plan]:
    """The same structure with other stretches, then priors and finer curves."""
    if plan.kind == STATES:
        return [replace(plan, strength=s) for s in STATES_STRENGTHS]
    kinds = [plan.kind, *(library.REFINED if plan.kind == "curves" else ())]
    most = {plan.kind: MOST_TERMS}
    return [replace(plan, length=n) for n in _lengths(problem)] + [
        replace(plan, kind=k, strength=s, most=most.get(k, FEW_TERMS))
        for k in kinds
        for s in _STRENGTHS
    ]


def _score(candidate: Candidate) -> float:
    return candidate.score


def _of(kind: str, candidates: Sequence[Candidate]) -> list[Candidate]:
    return [c for c in candidates if c.plan.kind == kind]


# Told after each structure: how many are done, how many there will be in this stage, the stage.
Progress = Callable[[int, int, str], None]


def search(
    problem: Problem,
    *,
    jobs: int = 1,
    progress: Progress | None = None,
    kept: Mapping[Plan, Candidate] | None = None,
    keep: Callable[[Candidate], None] | None = None,
) -> list[Candidate]:
    """All candidates, the chosen one first.

    Args:
        problem: Records and signals.
        jobs: Structures at a time; the result does not depend on it.
        progress: Told after each structure.
        kept: Results of an interrupted search.
        keep: Called with each new result.
    """
    known = dict(kept or {})

    def made(stage: str, plans: Iterable[Plan]) -> list[Candidate]:
        wanted = list(plans)
        done = []
        # Blocks have threads of their own: the last structure of a stage is not left to one.
        pool, inner = ThreadPoolExecutor(jobs), ThreadPoolExecutor(jobs)
        try:
            results = pool.map(lambda p: known.get(p) or searched(problem, p, inner.map), wanted)
            for number, candidate in enumerate(results, 1):
                if candidate.plan not in known and keep is not None:
                    keep(candidate)
                if progress is not None:
                    progress(number, len(wanted), stage)
                done.append(candidate)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            inner.shutdown(cancel_futures=True)
            pool.shutdown()
        return done

    linear = made("linear models", plans_linear(problem, delays(problem)))
    linear += made("linear models, tuned", plans_tuned(problem, linear))
    sketched = made("state-space models", plans_states(linear))
    bent = made("best state-space models", plans_full(sketched))
    bent += made("models of lags", plans_lags(problem, linear))
    bent += made("best models of lags", plans_full(bent))
    bent += made("best model, varied", plans_varied(problem, bent))
    return chosen_first(linear, bent)


def chosen_first(linear: Sequence[Candidate], bent: Sequence[Candidate]) -> list[Candidate]:
    """Sorts candidates by score; those that do not beat every simpler one come last.

    A linear model has to beat the constant, a nonlinear one every linear one: by more than a
    standard error over the eighths, and over the thirds. A state-space model has to beat those of
    lags that have fewer parameters, and the other way round.
    """
    constant, simple = _of(CONSTANT, linear), list(linear)

    def rank(candidate: Candidate) -> tuple[bool, float]:
        kind, size = candidate.plan.kind, len(candidate.fit.theta)
        if kind == CONSTANT:
            return False, candidate.score
        others = [c for c in bent if (c.plan.kind == STATES) != (kind == STATES)]
        smaller = [c for c in others if len(c.fit.theta) < size]
        rivals = constant if kind in LINEAR else [*simple, *smaller]
        return not all(_beats(candidate, rival) for rival in rivals), candidate.score

    return sorted([*linear, *bent], key=rank)


def _beats(candidate: Candidate, rival: Candidate) -> bool:
    (eighths, thirds), (its_eighths, its_thirds) = candidate.held_out, rival.held_out
    if score_of(thirds) >= score_of(its_thirds):
        return False
    if len(eighths) != len(its_eighths):  # other lags may leave one block fewer
        return score_of(eighths) < score_of(its_eighths)
    gain = np.log(its_eighths) - np.log(eighths)
    return bool(gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)))
