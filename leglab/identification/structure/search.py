"""Choice of a structure by cross-validation of the free run over held-out blocks.

The score of a structure is the mean logarithm of its errors over the blocks. Each block is
simulated in one free run by a model that was selected and fitted without the block. Logarithms keep
one block with a large error from deciding the choice. Eighths of the records test interpolation,
thirds extrapolation; a nonlinear model has to be better than the linear models in both.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from leglab.identification.spline_state_space import StateSpace
from leglab.identification.structure import library
from leglab.identification.structure.blocks import BLOCKS, Held, Table, stretches
from leglab.identification.structure.fit import (
    ITERATIONS,
    LEAST_SHARE,
    Fit,
    Further,
    Problem,
    Stretch,
    fit,
    one_step,
)
from leglab.identification.structure.lags import LagPath
from leglab.identification.structure.library import Orders
from leglab.identification.structure.plans import (
    LENGTHS,
    SKETCH,
    STATES,
    USUAL,
    Candidate,
    Plan,
    chosen_first,
    longest,
    mean_score,
    plans_full,
    plans_lags,
    plans_linear,
    plans_states,
    plans_tuned,
    plans_varied,
)
from leglab.identification.structure.states import StatePath, refitted

# A forward selection ends after _PATIENCE features in a row of which none lowers the best score to
# _PROGRESS times that score; these features are dropped.
_PATIENCE, _PROGRESS = 3, 0.99
_DELAYS = (0, 1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 25, 32)
_STAGES = 7  # number of stages of a search, for the progress
Each = Callable[..., Iterable]  # the function `map`, or the method `map` of a thread pool


def searched(problem: Problem, plan: Plan, each: Each = map) -> Candidate:
    """Selects and fits features: without each held-out block in turn, then on all records.

    Args:
        problem: Records and signals.
        plan: Structure to search.
        each: Function `map` by which the held-out blocks are processed.
    """
    if plan.sketch and plan.kind == STATES:
        return _sketched(problem, plan, each)
    depth, selection = _selection(problem, plan)
    held = Held(problem, depth, _counts(plan))
    paths = list(each(selection, held.all))
    grown: list[list[Fit]] = []  # [number of added features][held-out block]

    def sizes() -> Iterator[Table]:
        while True:
            grown.append([path.fit for path in paths])
            yield held.errors(grown[-1])
            if all(path.ended for path in paths):
                return
            list(each(lambda path: path.grow(), paths))

    table, tried = _table(sizes(), plan.most)
    whole = selection(None)
    for _ in range(len(table) - 1):
        whole.grow()
    best = whole.fit
    if plan.kind == STATES:
        best = _best_minimum(problem, plan, best, grown[len(table) - 1])
    return Candidate(plan, best, table[-1], tried)


def _best_minimum(problem: Problem, plan: Plan, first: Fit, others: Sequence[Fit]) -> Fit:
    """Returns the fit `first`, or the best refit from `others` if it is likelier by over one nat.

    The likelihood counts `plan.strength` samples, whose errors are correlated, as one.
    """
    fits = [refitted(problem, other, plan.strength, plan.budget) for other in others]
    best = min(fits, key=lambda fit: fit.error)
    gained = 2 * np.log(first.error / max(best.error, LEAST_SHARE))
    return best if gained * problem.count / plan.strength > 1 else first


def _counts(plan: Plan) -> tuple[int, ...]:
    return BLOCKS[-1:] if plan.sketch else BLOCKS


def _selection(
    problem: Problem, plan: Plan
) -> tuple[int, Callable[[Stretch | None], LagPath | StatePath]]:
    """Returns the number of samples before a free run, and a function that starts a selection."""
    orders = plan.orders
    if plan.kind == STATES:
        structure = StateSpace(states=orders.outputs, delays=orders.delays)
        depth = problem.model((structure,)).lags
        return depth, lambda b: StatePath(problem, structure, plan.strength, plan.budget, b)
    linear = orders.linear(problem)
    makers = {**library.KINDS, **library.REFINED}.get(plan.kind)
    further = Further(problem.template, makers(problem, orders) if makers else ())
    depth = problem.model(linear).lags + 1  # a change x(t - k) - x(t - k - 1) needs one lag more

    def start(block: Stretch | None) -> LagPath:
        rest = stretches(problem, depth, plan.length, plan.budget, block)
        iterations = ITERATIONS if plan.kind != "one step" else 0
        theta = one_step(problem, linear, block)
        first = fit(problem, linear, theta, rest, plan.strength, iterations)
        return LagPath(problem, first, further, rest, plan.strength)

    return depth, start


def _sketched(problem: Problem, plan: Plan, each: Each) -> Candidate:
    """Adds curves on all records and, after each curve, refits without each held-out block.

    Starting from the fit to all records, which includes the block, a refit takes a tenth of the
    time. But it leaks information of the block, so the scores only rank state-space models.
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


def _table(sizes: Iterator[Table], most: int) -> tuple[list[Table], tuple[float, ...]]:
    """Returns errors up to the smallest model scored within 1 % of the best, and all scores."""
    table: list[Table] = []
    scores: list[float] = []
    best, since = np.inf, 0
    for errors in sizes:
        table.append(errors)
        scores.append(mean_score(errors))
        since = 0 if scores[-1] < _PROGRESS * best else since + 1
        best = min(best, scores[-1])
        if len(table) > most or since >= _PATIENCE:
            break
    size = next(k for k, score in enumerate(scores) if score * _PROGRESS <= min(scores))
    return table[: size + 1], tuple(scores)


def delays(problem: Problem) -> tuple[int, ...]:
    """Estimates each input's delay as the one with the least error of a second-order model."""
    allowed = [d for d in _DELAYS if d <= longest(problem) // 20]
    out = [0] * len(problem.template.inputs)
    for j in range(len(out)):
        errors = []
        for d in allowed:
            orders = Orders(2, 3, (*out[:j], d, *out[j + 1 :]))
            features = orders.linear(problem)
            samples = stretches(problem, problem.model(features).lags, LENGTHS[1], SKETCH)
            start = one_step(problem, features)
            errors.append(fit(problem, features, start, samples, USUAL).error)
        # Lags can replace a delay that is too short, but not shorten one that is too long: so the
        # shortest delay whose error is within 1 % of the least error is taken.
        least = min(errors)
        out[j] = next(d for d, e in zip(allowed, errors, strict=True) if e <= 1.01 * least)
    return tuple(out)


# Function called after each structure: number done, total number and name of the present stage.
Progress = Callable[[int, int, str], None]


def search(
    problem: Problem,
    *,
    jobs: int = 1,
    progress: Progress | None = None,
    kept: Mapping[Plan, Candidate] | None = None,
    keep: Callable[[Candidate], None] | None = None,
) -> list[Candidate]:
    """Searches all structures; returns the candidates, the chosen one first.

    Args:
        problem: Records and signals.
        jobs: Number of threads; the result does not depend on it.
        progress: Function called after each structure.
        kept: Results of an interrupted search, which are not computed again.
        keep: Function called with each new result.
    """
    known, stages = dict(kept or {}), []

    def results(stage: str, plans: Iterable[Plan]) -> list[Candidate]:
        todo = list(plans)
        stages.append(stage)
        done = []
        # Fits without a block run in a second pool: a stage's last structures occupy all threads.
        pool, inner = ThreadPoolExecutor(jobs), ThreadPoolExecutor(jobs)
        try:
            candidates = pool.map(lambda p: known.get(p) or searched(problem, p, inner.map), todo)
            for number, candidate in enumerate(candidates, 1):
                if candidate.plan not in known and keep is not None:
                    keep(candidate)
                if progress is not None:
                    progress(number, len(todo), f"{stage} ({len(stages)} of {_STAGES})")
                done.append(candidate)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            inner.shutdown(cancel_futures=True)
            pool.shutdown()
        return done

    linear = results("linear models", plans_linear(problem, delays(problem)))
    linear += results("linear models, tuned", plans_tuned(problem, linear))
    sketched = results("state-space models", plans_states(linear))
    bent = results("best state-space models", plans_full(sketched))
    bent += results("models of lags", plans_lags(problem, linear))
    bent += results("best models of lags", plans_full(bent))
    bent += results("best model, varied", plans_varied(problem, bent))
    return chosen_first(linear, bent)
