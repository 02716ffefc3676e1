"""The search on a machine that is taken for exact: how it looks for a second effect."""

from types import SimpleNamespace

import pytest

from leglab.diagnosis import search, workflow
from leglab.diagnosis.thresholds import DEFAULT
from leglab.diagnosis.workflow import DiagnosisSettings, set_up
from tests.rigs import PENDULUM, Truth, record


@pytest.mark.parametrize(("worth", "count"), [(None, DEFAULT.pairs), (30.0, DEFAULT.rough_pairs)])
def test_more_pairs_are_fitted_where_the_model_is_taken_for_exact(monkeypatch, worth, count):
    """A pair of gross faults may be the fifth to first order."""
    assert DEFAULT.pairs >= 5 > DEFAULT.rough_pairs
    monkeypatch.setattr(search, "refit", lambda problem, at, keys, start: start)
    problem = SimpleNamespace(thresholds=DEFAULT, worth=worth)
    promising = [(place, frozenset({("payload", "shank")})) for place in range(20)]
    fits = search.fitted_pairs(problem, None, promising, lambda _: None)
    assert fits == list(range(count))


def test_the_best_pair_is_that_which_is_best_at_the_end_of_its_fit(monkeypatch):
    """A pair whose first fit is second may be the right one: the first fits end early."""
    first = [SimpleNamespace(cost=cost, hypothesis=cost) for cost in (30.0, 12.0, 11.0, 10.0)]
    ends = {10.0: 9.5, 11.0: 4.0, 12.0: 11.5, 30.0: 1.0}
    monkeypatch.setattr(search, "pairs", lambda *_: [])
    monkeypatch.setattr(search, "fitted_pairs", lambda *_: list(first))
    monkeypatch.setattr(search, "sharpen", lambda _, fit: SimpleNamespace(cost=ends[fit.cost]))
    monkeypatch.setattr(search, "as_pair", lambda _, fit: fit)
    problem = SimpleNamespace(
        thresholds=DEFAULT, linearise=lambda *_: None, about=lambda hypothesis: problem
    )
    _, pair = search.pair_search(problem, SimpleNamespace(candidates=()), None, lambda _: None)
    assert pair.cost == 4.0


def test_a_second_effect_is_screened_from_the_fit_and_from_the_first_effect_alone(monkeypatch):
    """What follows every fit may have gone far to make up for the effect that is missing."""
    logs = {
        kind: record(PENDULUM, kind, Truth(gear_loss=0.15, play=0.004), seed=seed, seconds=4.0)
        for seed, kind in enumerate(("multisine", "slow"))
    }
    settings = DiagnosisSettings(threads=1, rounds=2)
    problem = set_up(PENDULUM.model, logs, (), settings)
    begun = []

    def observed(problem, start, best, *rest, beside=None):
        left = float(problem.window_cost(best.hypothesis).mean())
        begun.append((left, start, best, beside))
        return search.search_round(problem, start, best, *rest, beside=beside)

    monkeypatch.setattr(workflow, "search_round", observed)
    workflow._exact_search(problem, settings, lambda _: None)
    first, second = begun[:2]
    assert first[3] is None
    left, start, best, beside = second
    assert left > DEFAULT.explained
    assert beside is best.hypothesis
    assert set(start) == best.free < set(beside)
