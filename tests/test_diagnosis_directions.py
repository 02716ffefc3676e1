"""Friction by direction has its name only where the directions differ."""

from types import SimpleNamespace

import numpy as np
import pytest

from leglab.diagnosis import challenge, directions, naming, rough
from leglab.diagnosis.fitting import refit
from leglab.diagnosis.hypothesis import Hypothesis
from leglab.diagnosis.search import as_contender
from leglab.diagnosis.thresholds import DEFAULT
from leglab.diagnosis.workflow import DiagnosisSettings, set_up
from tests.diagnosis_sketch import (
    ASYMMETRIC,
    COULOMB,
    LIBRARY,
    MACHINE,
    OFFSET,
    VISCOUS,
    WINDOWS,
    a_fit,
    a_round,
    a_sketch,
    contender,
)
from tests.rigs import SLIDE_AXIS, Truth, record
from tests.rigs.rough import ROTOR, as_made, machine, record_rough

KEY = ("asymmetric_friction", "shaft")


def fitted(**changed):
    """Friction by direction on a rotor with other friction than its model's."""
    values = as_made(ROTOR)
    for name, more in changed.items():
        values[name] = values[name] + more
    (logs,) = record_rough(ROTOR, [values], seed=0, seconds=3.0)
    settings = DiagnosisSettings(effects=(KEY[0],), threads=1)
    problem = set_up(ROTOR.model, {k: logs[k] for k in ("multisine", "slow")}, (), settings)
    at = problem.linearise(Hypothesis(), problem.fitted)
    problem = problem.trusting(problem.discrepancy(refit(problem, at, frozenset({KEY})).hypothesis))
    at = problem.linearise(Hypothesis(), problem.fitted)
    return problem, as_contender(problem, KEY, refit(problem, at, frozenset({KEY})))


@pytest.fixture(scope="module")
def both():
    """A breakaway peak that falls off with speed, which no number of the model has."""
    return fitted(coulomb=0.1, breakaway=1.5, stribeck=-0.7)


@pytest.fixture(scope="module")
def one_way():
    return fitted(forward=0.1, breakaway=0.3, stribeck=-0.7)


def test_directions_that_depart_alike_give_friction_by_direction_no_name(both, one_way):
    assert not directions.differs(*both)
    assert directions.differs(*one_way)


def test_a_fit_alike_moves_both_directions_by_the_same_amounts(both):
    problem, found = both
    fit = directions._alike(problem, found.fit, KEY)
    forward, backward = fit.hypothesis[KEY].reshape(2, 2).T
    np.testing.assert_allclose(forward, backward, rtol=1e-9)
    # They go on to where they fit best, from wherever they begin.
    start = fit.hypothesis.with_values(KEY, np.full(4, 0.02))
    again = refit(problem, fit.at, fit.free, start=start, iterations=8, fine=0.3, alike=(KEY,))
    np.testing.assert_allclose(again.hypothesis[KEY], fit.hypothesis[KEY], rtol=0.05, atol=2e-3)
    assert fit.cost < 1.1 * found.fit.cost


def test_directions_go_on_from_the_specimen_by_the_same_amounts(both):
    """A healthy machine may have more friction one way; what changed since is what counts."""
    problem, found = both
    specimen = Hypothesis({KEY: np.array([0.0, 0.01, 0.02, 0.0])})
    problem = problem.calibrated(specimen).trusting(problem.noise.discrepancy)
    fit = directions._alike(problem, found.fit, KEY)
    departed = fit.hypothesis[KEY] - problem.library.sites[KEY].nominal
    np.testing.assert_allclose(departed[0::2], departed[1::2], rtol=1e-9)
    assert np.abs(departed).max() > 0.01


def test_one_number_a_pair_is_counted_where_directions_depart_alike():
    site = LIBRARY.sites[ASYMMETRIC]
    np.testing.assert_array_equal(site.alike, [[1, 0], [1, 0], [0, 1], [0, 1]])
    scale = np.array([p.scale for p in site.parameters])
    for trials, alone, alike in (((5, 5, 5, 5), 4, 2), ((0, 0, 5, 5), 2, 1), ((0, 0, 0, 0), 1, 1)):
        values = site.nominal + scale * trials
        assert site.used(values, 0.15) == alone
        assert site.used(values, 0.15, alike=True) == alike
    plain = LIBRARY.sites[VISCOUS]
    np.testing.assert_array_equal(plain.alike, [[1]])


def test_an_effect_that_says_nothing_of_directions_stays(monkeypatch):
    one = contender(LIBRARY, COULOMB, 1.0)
    assert directions.differing(a_sketch(monkeypatch), [one]) == [one]


@pytest.mark.parametrize("leads", [True, False])
def test_the_others_are_judged_without_what_has_no_name(monkeypatch, leads):
    """Under the discrepancy that the best of them leaves, if it was the best that went."""
    sketch = a_sketch(monkeypatch)
    followed = []

    def settled(problem, contenders, floor):
        followed.append([c.key for c in contenders])
        return problem, contenders

    monkeypatch.setattr(rough, "_settled", settled)
    monkeypatch.setattr(rough, "total_cost", lambda problem, fit: np.ones(WINDOWS))
    monkeypatch.setattr(directions, "differs", lambda problem, one: one.key != ASYMMETRIC)
    order = (ASYMMETRIC, COULOMB, OFFSET) if leads else (COULOMB, ASYMMETRIC, OFFSET)
    tried = a_round([contender(LIBRARY, key, 1.0) for key in order])
    _, judged = rough.annealed(sketch, a_fit(LIBRARY), tried, None)
    assert [c.key for c in judged.contenders] == [COULOMB, OFFSET]
    assert followed == [list(order), [COULOMB, OFFSET]][: 1 + leads]
    # Nothing may be left.
    none = rough.annealed(sketch, a_fit(LIBRARY), a_round(tried.contenders[:1]), None)[1]
    assert [c.key for c in none.contenders] == ([] if leads else [COULOMB])


def test_on_an_exact_machine_special_cases_say_enough(monkeypatch):
    """Nothing is fitted anew: the sketch could not."""
    assert directions.differs(a_sketch(monkeypatch), contender(LIBRARY, ASYMMETRIC, 1.0))


@pytest.mark.parametrize(("differs", "kept"), [(True, ASYMMETRIC), (False, COULOMB)])
def test_no_name_is_swapped_for_one_whose_directions_depart_alike(monkeypatch, differs, kept):
    sketch = a_sketch(monkeypatch)
    scatter = np.random.default_rng(0).normal(0.0, 0.02, WINDOWS)
    costs = {COULOMB: 3.0 + scatter, ASYMMETRIC: 2.9 - scatter}
    monkeypatch.setattr(challenge, "with_rival", lambda p, f, free, s: a_fit(LIBRARY, *free))
    monkeypatch.setattr(challenge, "total_cost", lambda p, f: costs[min(f.free)])
    monkeypatch.setattr(challenge, "finished", lambda problem, rival: rival)
    monkeypatch.setattr(challenge, "differs", lambda problem, one: differs)
    monkeypatch.setattr(challenge, "earns", lambda *_: True)
    rounds = [a_round([contender(LIBRARY, k, c) for k, c in costs.items()])]
    better, _ = challenge._swapped(sketch, a_fit(LIBRARY, COULOMB), [COULOMB], rounds)
    assert (better[1] if better else [COULOMB]) == [kept]


def rough_problem(model, logs):
    settings = DiagnosisSettings(effects=(ASYMMETRIC[0], OFFSET[0], "cogging"), threads=1)
    problem = set_up(model, {k: logs[k] for k in ("multisine", "slow")}, (), settings)
    key = next(key for key in problem.library.sites if key[0] == ASYMMETRIC[0])
    at = problem.linearise(Hypothesis(), problem.fitted)
    fit = refit(problem, at, frozenset({key}))
    problem = problem.trusting(problem.discrepancy(fit.hypothesis))
    at = problem.linearise(Hypothesis(), problem.fitted)
    return problem, refit(problem, at, frozenset({key}), iterations=8), key


def test_dry_friction_and_a_constant_force_move_as_friction_by_direction_does():
    values = machine(ROTOR, np.random.default_rng(3))
    values["coulomb"] += 0.1
    values["force"] += 0.07
    (logs,) = record_rough(ROTOR, [values], seed=0, seconds=4.0)
    problem, fit, key = rough_problem(ROTOR.model, logs)
    found = fit.hypothesis[key]
    assert found[3] - found[2] == pytest.approx(0.14, abs=0.03)
    names, ratio = directions.pushed_instead(problem, fit, key)
    assert names == ("force_offset",)  # of these effects: other friction is not looked for
    assert ratio > 0.25
    beside = directions._alike(problem, fit, key, ("force_offset", "shaft"))
    assert beside.hypothesis["force_offset", "shaft"][0] == pytest.approx(0.07, rel=0.15)


def test_a_pair_of_directions_that_differs_is_a_further_number():
    site = LIBRARY.sites[ASYMMETRIC]
    scale = np.array([p.scale for p in site.parameters])
    for trials, pairs in (((5, 5, 5, 5), 0), ((5, 5, 0, 5), 1), ((1, 5, 2, 5), 2)):
        assert directions._differing_pairs(site, scale * trials, 0.15) == pairs


def test_what_grows_with_the_speed_in_one_direction_is_no_constant_force():
    kinds = ("multisine", "slow")
    truth = Truth(forward=30.0)
    logs = {k: record(SLIDE_AXIS, k, truth, seed=i, seconds=3.0) for i, k in enumerate(kinds)}
    problem, fit, key = rough_problem(SLIDE_AXIS.model, logs)
    assert directions.pushed_instead(problem, fit, key)[1] < 1e-3


def test_nothing_is_pushed_instead_of_what_says_nothing_of_directions(one_way):
    problem, found = one_way
    # No constant force is in its library.
    assert directions.pushed_instead(problem, found.fit, KEY) == ((), 0.0)
    sketch = SimpleNamespace(library=LIBRARY, machine=MACHINE, thresholds=DEFAULT)
    fit = a_fit(LIBRARY, VISCOUS)
    assert directions.pushed_instead(sketch, fit, VISCOUS) == ((), 0.0)


@pytest.mark.parametrize(
    ("stand_ins", "prior"), [("pushed_instead", 1 / 40), ("resisted_instead", 1.0)]
)
@pytest.mark.parametrize(("ratio", "told"), [(0.0, False), (0.2, False), (2.0, True)])
def test_several_that_move_alike_are_told_and_take_confidence_away(
    monkeypatch, stand_ins, prior, ratio, told
):
    """Two causes are as much less probable as there are effects; a load that drags is one."""
    sketch = a_sketch(monkeypatch)
    sketch.library = SimpleNamespace(searched=frozenset(range(40)))
    search = SimpleNamespace(problem=sketch, fit=None)
    for one in ("pushed_instead", "resisted_instead"):
        own = ((COULOMB[0],), ratio) if one == stand_ins else ((), 0.0)
        monkeypatch.setattr(naming, one, lambda *_, own=own: own)
    tied, probability = naming._or_several(search, ASYMMETRIC, ((), 0.9))
    assert tied == ((COULOMB[0],) if told else ())
    assert probability == pytest.approx(0.9 / (1 + 0.9 * ratio * prior))
    # A name that is told already is told once.
    assert naming._or_several(search, ASYMMETRIC, ((COULOMB[0],), 0.9))[0] == (COULOMB[0],)
