"""A sketch of a problem for tests of the judging: costs are given, nothing is replayed."""

from types import SimpleNamespace

import numpy as np

from leglab.diagnosis import naming
from leglab.diagnosis.discrepancy import Discrepancy
from leglab.diagnosis.fitting import Fit
from leglab.diagnosis.hypothesis import Hypothesis, Library
from leglab.diagnosis.model import Machine
from leglab.diagnosis.residual import Linearisation
from leglab.diagnosis.result import Gap
from leglab.diagnosis.search import Contender, Round
from leglab.diagnosis.thresholds import DEFAULT
from leglab.diagnosis.windows import Channel
from leglab.diagnosis.workflow import Search
from tests.rigs import PENDULUM

OFFSET, VISCOUS = ("force_offset", "hinge"), ("viscous_friction", "hinge")
ASYMMETRIC, COULOMB = ("asymmetric_friction", "hinge"), ("coulomb_friction", "hinge")
WINDOWS, SIZE = 40, 30
HELD = np.arange(WINDOWS) >= 25


MACHINE = Machine(PENDULUM.model)
LIBRARY = Library(MACHINE)


def a_sketch(monkeypatch):
    """What a judge asks of a problem; `costs` by the set of effects that are there."""
    costs: dict = {}

    def cost(hypothesis):
        return np.broadcast_to(costs[frozenset(hypothesis)], WINDOWS).astype(float)

    no_width = {OFFSET: np.zeros(1), VISCOUS: np.zeros(1), ASYMMETRIC: np.zeros(6)}
    monkeypatch.setattr(naming, "intervals", lambda problem, fit, beside: no_width)
    problem = SimpleNamespace(
        machine=MACHINE,
        library=LIBRARY,
        thresholds=DEFAULT,
        channels=(Channel(column="hinge_position", joint="hinge"),),
        series=[],
        size=SIZE,
        held=HELD,
        judged=HELD,
        fitted=~HELD,
        noise=SimpleNamespace(discrepancy=None),
        costs=costs,
        window_cost=cost,
        worth=None,
        numbers=DEFAULT.rough_numbers,
        noise_levels=cost,
    )
    problem.trusting = lambda discrepancy: problem
    return problem


def a_fit(library, *keys, trials=4.0):
    """A fit with effects of so many trials' size."""
    values = {k: library.sites[k].nominal for k in keys}
    for key, value in values.items():
        value += trials * np.array([p.scale for p in library.sites[key].parameters])
    none = np.zeros((WINDOWS, SIZE))
    at = Linearisation(
        base=Hypothesis(values), residual=none, tangents=none, nuisances=(), chosen=~HELD
    )
    return Fit(free=frozenset(keys), cost=0.0, at=at)


def contender(library, key, cost):
    return Contender(key=key, fit=a_fit(library, key), cost=np.broadcast_to(cost, WINDOWS))


def a_round(contenders, base=10.0, threshold=0.0, tried=1):
    """A round of contenders out of so many effects that were tried."""
    base = np.broadcast_to(base, WINDOWS).astype(float)
    candidates = tuple(SimpleNamespace() for _ in range(tried))
    return Round(
        base=base, candidates=candidates, contenders=tuple(contenders), threshold=threshold
    )


def a_search(problem, named, contenders=(), specimen=None):
    return Search(
        problem=problem,
        baseline=a_fit(problem.library),
        fit=a_fit(problem.library, *named),
        named=tuple(named),
        rounds=(a_round(contenders),),
        specimen=specimen,
    )


def a_gap(**levels):
    given = {"before": 10.0, "baseline": 10.0, "after": 1.0, "held_out": ("c",), **levels}
    return Gap(**given)


def ripple(mean, size=0.3, seed=0):
    """Costs of windows that scatter."""
    scatter = np.random.default_rng(seed).normal(0.0, size, WINDOWS)
    return mean + scatter - scatter.mean()


def exact_verdict(problem, named, contenders=()):
    """What is said of a model that is taken for exact."""
    found = a_search(problem, named, contenders)
    return naming.judge_exact(found, np.random.default_rng(0))


def rough_ties(found, key):
    def weigh(own, rivals):
        return naming._by_posterior(found.problem, own, rivals)

    return naming._ties(found, key, weigh)


def memory(bins, reach):
    """Covariance that fades with the distance."""
    return np.exp(-np.abs(np.subtract.outer(np.arange(bins), np.arange(bins))) / reach)


def a_discrepancy(bins=12, reach=4.0):
    pattern = np.stack([memory(bins, reach), np.eye(bins)])
    variance = np.array([[1.0, 4.0], [9.0, 0.0]])
    return Discrepancy(directions=np.eye(2), pattern=pattern, variance=variance)
