"""Plans of the structure search, their order, and the ranking of their results.

A nonlinear model is chosen only if it beats the linear models over held-out eighths of the records
(interpolation) and over held-out thirds (extrapolation).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leglab.identification.structure import library
from leglab.identification.structure.fit import SHORTEST, Array, Fit, Problem
from leglab.identification.structure.library import Orders

# Maximum samples that a fit simulates (sketch, full, final); more hardly change the parameters.
SKETCH, FULL, LAST = 4000, 12000, 100_000
MOST_TERMS, FEW_TERMS = 20, 5
MOST_CURVES = 4  # maximum number of curves of a state-space model
STATES_BUDGET = 3000  # samples simulated by state-space fits, which are slower than fits of lags
_STATES = (1, 2, 3, 4, 6)
STATES_STRENGTHS = (10.0, 100.0, 1000.0)
_KEPT = 3  # number of best structures of a stage that the next stage refines
_LINEAR = ((1, 1), (1, 2), (2, 2), (2, 3), (3, 3), (3, 4), (2, 6), (3, 6), (4, 6), (6, 6), (8, 9),
           (12, 12), (16, 16))  # fmt: skip
_BENT = ((1, 2), (2, 3), (3, 4), (3, 6), (4, 6))
# Minimum number of samples per parameter of a linear structure, which only limits the duration of
# the search: the prior and the held-out blocks prevent overfitting.
_SAMPLES = 5
_MOST_LAGS = 24  # maximum number of lags of all signals together in nonlinear models of lags
# Lengths of a stretch [samples], tried on held-out blocks: the best is about the machine's memory.
LENGTHS = (SHORTEST, 200, 600)
# Strengths of the prior. With white errors and parameters of about 1 the right strength is 1; but
# free-run errors are correlated, so that N samples inform like N/10 or N/100 independent samples.
_STRENGTHS = (1.0, 10.0, 100.0)
USUAL = 10.0
# Linear models, fitted to the free run, or to one-step predictions by least squares. The one-step
# fit is better if disturbances act on the machine rather than on its sensor.
LINEAR = ("linear", "one step")
STATES = "states"  # state-space models with curves
CONSTANT = "constant"
SIMPLE = (*LINEAR, CONSTANT)


@dataclass(frozen=True)
class Plan:
    """A model structure and the settings of its search.

    Attributes:
        kind: One of `SIMPLE`, a kind of the library, or `STATES`.
        orders: Lags; for a state-space model `outputs` is the number of states.
        length: Length of a stretch in fits of lags [samples].
        strength: Factor of the prior precision of the parameters.
        most: Maximum number of nonlinear features or curves.
        budget: Maximum number of samples that a fit simulates.
        sketch: Whether this is a cheap preselection over thirds, before a search in full.
    """

    kind: str
    orders: Orders
    length: int
    strength: float = USUAL
    most: int = 0
    budget: int = FULL
    sketch: bool = False


@dataclass(frozen=True)
class Candidate:
    """Result of a plan.

    Attributes:
        plan: The plan.
        fit: The model, fitted to all records.
        held_out: Mean squared error over each held-out eighth and each third of the records, as a
            share of the output's variance; for a sketch over the thirds only.
        path: Scores with 0, 1, 2, ... nonlinear features.
    """

    plan: Plan
    fit: Fit
    held_out: tuple[tuple[float, ...], ...]
    path: tuple[float, ...]

    @property
    def scores(self) -> tuple[float, ...]:
        """Geometric means of RMS errors over eighths and over thirds, in output deviations."""
        return tuple(map(score_of, self.held_out))

    @property
    def score(self) -> float:
        """Geometric mean of `scores`."""
        return mean_score(self.held_out)


def score_of(held_out: Sequence[float] | Array) -> float:
    """Returns the geometric mean of RMS errors from mean squared errors."""
    return float(np.exp(np.mean(np.log(held_out)) / 2))


def mean_score(held_out: Sequence[Sequence[float]]) -> float:
    """Returns the geometric mean of the scores of eighths and thirds."""
    return float(np.exp(np.mean([np.log(score_of(part)) for part in held_out])))


def longest(problem: Problem) -> int:
    """Returns the number of samples of the longest record."""
    return max(map(len, problem.records))


def _lengths(problem: Problem) -> list[int]:
    most = max(2, longest(problem) // 4)
    return list(dict.fromkeys(min(n, most) for n in LENGTHS))


def plans_linear(problem: Problem, lead: tuple[int, ...]) -> list[Plan]:
    """Returns the plans of linear structures and of a constant; `lead` has the inputs' delays."""
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
    """Returns plans of the best linear structures with other stretch lengths and priors."""
    return [
        replace(c.plan, length=length, strength=strength)
        for c in sorted(_of("linear", linear), key=_score)[:_KEPT]
        for length in _lengths(problem)
        for strength in _STRENGTHS
        if (length, strength) != (c.plan.length, c.plan.strength)
    ]


def plans_lags(problem: Problem, linear: Sequence[Candidate]) -> list[Plan]:
    """Returns plans of models of lags with at most `FEW_TERMS` nonlinear features."""
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
    """Returns the state-space models of the orders 1, 2, 3, 4 and 6, to be sketched."""
    lead = min(linear, key=_score).plan.orders.delays
    return [
        Plan(STATES, Orders(n, 0, delays), 0, _STRENGTHS[-1], MOST_CURVES, STATES_BUDGET, True)
        for n in _STATES
        for delays in dict.fromkeys((lead, (0,) * len(lead)))
    ]


def plans_full(candidates: Sequence[Candidate]) -> list[Plan]:
    """Returns the best plans as full searches; models of lags get more samples and features."""
    best = [c.plan for c in sorted(candidates, key=_score)[:_KEPT]]
    return [
        replace(plan, sketch=False)
        if plan.kind == STATES
        else replace(plan, most=MOST_TERMS, budget=FULL)
        for plan in best
        if plan.sketch or plan.kind != STATES
    ]


def plans_varied(problem: Problem, bent: Sequence[Candidate]) -> list[Plan]:
    """Returns variants of the best state-space and lag models, or of one that beats the other."""
    families = (_of(STATES, bent), [c for c in bent if c.plan.kind != STATES])
    best = [min(family, key=_score) for family in families if family]
    plans = []
    for one in best:
        if not any(_beats(other, one) for other in best if other is not one):
            plans += _variants(problem, one.plan)
    known = {candidate.plan for candidate in bent}
    return [plan for plan in dict.fromkeys(plans) if plan not in known]


def _variants(problem: Problem, plan: Plan) -> list[Plan]:
    """Returns plans of the structure with other stretch lengths, priors and numbers of splines."""
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


def chosen_first(linear: Sequence[Candidate], bent: Sequence[Candidate]) -> list[Candidate]:
    """Sorts candidates by score; candidates that do not beat all simpler candidates come last.

    To beat is to be better over the eighths, by more than a standard error, and over the thirds. A
    linear model has to beat the constant, a nonlinear model all linear models; a state-space model
    also the nonlinear models of lags with fewer parameters, and vice versa.
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
    if len(eighths) != len(its_eighths):  # models with more lags may have one block fewer
        return score_of(eighths) < score_of(its_eighths)
    gain = np.log(its_eighths) - np.log(eighths)
    return bool(gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)))
