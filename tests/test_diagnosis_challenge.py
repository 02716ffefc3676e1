"""A named set is challenged: effects that others make needless go, impostors are swapped."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from leglab.diagnosis import challenge
from leglab.diagnosis.fitting import refit
from leglab.diagnosis.hypothesis import Hypothesis
from leglab.diagnosis.judging import t_value
from leglab.diagnosis.nuisances import rough_nuisances
from leglab.diagnosis.search import Contender, Round
from leglab.diagnosis.thresholds import DEFAULT
from leglab.diagnosis.workflow import DiagnosisSettings, set_up
from tests.diagnosis_sketch import (
    ASYMMETRIC,
    COULOMB,
    HELD,
    LIBRARY,
    OFFSET,
    SIZE,
    VISCOUS,
    WINDOWS,
    a_fit,
    ripple,
)
from tests.rigs.rough import ROTOR, as_made, record_rough

SPRING = "spring_stiffness", "hinge"


@pytest.fixture
def sketch(monkeypatch):
    """Costs by the set of effects that are there, nothing is replayed or refined."""
    costs: dict = {}

    def fitted(problem, fit, free, start, **_):
        return a_fit(LIBRARY, *free)

    def window_cost(hypothesis):
        scatter = np.random.default_rng(0).normal(0.0, 0.02, WINDOWS)
        return costs[frozenset(hypothesis)] + scatter - scatter.mean()

    monkeypatch.setattr(challenge, "_refitted", fitted)
    monkeypatch.setattr(challenge, "finished", lambda problem, rival: rival)
    problem = SimpleNamespace(
        library=LIBRARY,
        thresholds=DEFAULT,
        size=SIZE,
        held=HELD,
        noise=SimpleNamespace(discrepancy=None),
        costs=costs,
        window_cost=window_cost,
        worth=None,
    )
    problem.with_defect_of = lambda hypothesis: problem
    return problem


def a_round(library, *keys):
    contenders = tuple(
        Contender(key=k, fit=a_fit(library, k), cost=np.full(WINDOWS, 5.0)) for k in keys
    )
    return Round(base=np.full(WINDOWS, 30.0), candidates=(), contenders=contenders, threshold=0.0)


def challenged(sketch, named, rounds):
    _, fit, kept, checks = challenge.challenged(
        sketch, a_fit(sketch.library, *named), named, rounds
    )
    assert fit.free == frozenset(kept)
    return kept, checks


def costs(sketch, table, other=20.0):
    """Costs of sets; all others of these effects cost more."""
    keys = (OFFSET, VISCOUS, COULOMB, SPRING)
    for code in range(16):
        chosen = frozenset(k for i, k in enumerate(keys) if code >> i & 1)
        sketch.costs[chosen] = other
    sketch.costs |= {frozenset(k): v for k, v in table.items()}


def test_an_effect_that_the_others_make_needless_goes(sketch):
    costs(sketch, {(OFFSET, VISCOUS): 1.0, (VISCOUS,): 1.02, (OFFSET,): 9.0})
    rounds = [a_round(sketch.library, OFFSET), a_round(sketch.library, VISCOUS)]
    kept, checks = challenged(sketch, [OFFSET, VISCOUS], rounds)
    assert kept == list(checks) == [VISCOUS]


def test_an_effect_that_nuisances_stand_in_for_stays(sketch):
    """Without it the errors are as small, and other parameters have gone far for that."""
    costs(sketch, {(OFFSET, VISCOUS): 1.0, (VISCOUS,): 1.02, (OFFSET,): 9.0})
    sketch.worth = 30.0
    sketch.departed = lambda hypothesis, free: 0.0 if OFFSET in free else 12.0
    rounds = [a_round(sketch.library, OFFSET), a_round(sketch.library, VISCOUS)]
    kept, checks = challenged(sketch, [OFFSET, VISCOUS], rounds)
    assert kept == list(checks) == [OFFSET, VISCOUS]


def test_the_least_needed_goes_first(sketch):
    """Either of two alike can go; with both gone all is lost."""
    costs(
        sketch,
        {
            (OFFSET, VISCOUS, COULOMB): 1.0,
            (OFFSET, VISCOUS): 1.05,
            (OFFSET, COULOMB): 1.01,
            (VISCOUS, COULOMB): 9.0,
        },
    )
    rounds = [a_round(sketch.library, k) for k in (OFFSET, VISCOUS, COULOMB)]
    kept, _ = challenged(sketch, [OFFSET, VISCOUS, COULOMB], rounds)
    assert kept == [OFFSET, COULOMB]


def test_an_early_impostor_is_swapped_for_its_rival(sketch):
    costs(sketch, {(OFFSET, VISCOUS): 3.0, (COULOMB, VISCOUS): 1.0})
    rounds = [a_round(sketch.library, OFFSET, COULOMB), a_round(sketch.library, VISCOUS)]
    kept, checks = challenged(sketch, [OFFSET, VISCOUS], rounds)
    assert kept == [COULOMB, VISCOUS]
    # What was named first stays on record as the rival.
    assert [c.key for c in checks[COULOMB]] == [COULOMB, OFFSET]


def test_a_first_fit_that_was_dropped_is_a_rival_of_an_early_effect_alone(sketch):
    """Alone it had no chance; beside what was found later it explains all."""
    costs(sketch, {(OFFSET, VISCOUS): 3.0, (COULOMB, VISCOUS): 1.0, (OFFSET, COULOMB): 0.5})
    dropped = ((COULOMB, a_fit(sketch.library, COULOMB)),)
    first, later = a_round(sketch.library, OFFSET), a_round(sketch.library, VISCOUS)
    kept, _ = challenged(sketch, [OFFSET, VISCOUS], [first, later])
    assert kept == [OFFSET, VISCOUS]
    kept, _ = challenged(sketch, [OFFSET, VISCOUS], [replace(first, dropped=dropped), later])
    assert kept == [COULOMB, VISCOUS]
    # In the last round it was fitted beside all the others, and lost.
    kept, _ = challenged(sketch, [OFFSET, VISCOUS], [first, replace(later, dropped=dropped)])
    assert kept == [OFFSET, VISCOUS]


def test_two_effects_that_imitate_one_are_replaced_by_it(sketch):
    costs(
        sketch,
        {
            (OFFSET, VISCOUS, SPRING): 1.0,
            (OFFSET, COULOMB, SPRING): 1.0,
            (COULOMB, VISCOUS, SPRING): 1.0,
            (COULOMB, SPRING): 1.0,
        },
    )
    rounds = [
        a_round(sketch.library, OFFSET),
        a_round(sketch.library, VISCOUS, COULOMB),
        a_round(sketch.library, SPRING),
    ]
    kept, _ = challenged(sketch, [OFFSET, VISCOUS, SPRING], rounds)
    assert kept == [COULOMB, SPRING]


def test_two_effects_are_not_replaced_by_one_of_more_numbers(sketch):
    """Dry friction and a small offset are as much friction by direction, which has four."""
    for key in (VISCOUS, COULOMB):
        named = (OFFSET, key, SPRING)
        sketch.costs |= {
            frozenset(named): 1.0,
            frozenset([OFFSET, ASYMMETRIC, SPRING]): 1.0,
            frozenset([ASYMMETRIC, key, SPRING]): 9.0,
            frozenset([ASYMMETRIC, SPRING]): 1.0,
            frozenset([OFFSET, ASYMMETRIC]): 9.0,
        }
        for one in named:
            sketch.costs[frozenset(named) - {one}] = 9.0
        first = a_round(sketch.library, key, ASYMMETRIC)
        rounds = [first, *(a_round(sketch.library, k) for k in (OFFSET, SPRING))]
        assert challenged(sketch, [key, OFFSET, SPRING], rounds)[0] == [key, OFFSET, SPRING]


def test_on_a_rough_machine_one_in_place_of_two_saves_a_number(sketch, monkeypatch):
    """Such machines have a little of everything: of as many numbers none is the simpler set."""
    costs(
        sketch,
        {
            (OFFSET, VISCOUS, SPRING): 1.0,
            (OFFSET, COULOMB, SPRING): 1.0,
            (COULOMB, SPRING): 1.0,
        },
    )
    sketch.noise.discrepancy = object()
    sketch.numbers = DEFAULT.rough_numbers
    rounds = [a_round(sketch.library, k) for k in (OFFSET, SPRING)]
    rounds.insert(1, a_round(sketch.library, VISCOUS, COULOMB))
    named = [OFFSET, VISCOUS, SPRING]
    assert challenged(sketch, named, rounds)[0] == [COULOMB, SPRING]
    counts = {frozenset(named): 3, frozenset([COULOMB, SPRING]): 3}
    monkeypatch.setattr(challenge, "parameters", lambda problem, fit: counts.get(fit.free, 3))
    assert challenged(sketch, named, rounds)[0] == named
    sketch.noise.discrepancy = None
    assert challenged(sketch, named, rounds)[0] == [COULOMB, SPRING]


def test_what_is_needed_stays_and_a_worse_rival_is_on_record(sketch):
    costs(sketch, {(OFFSET, VISCOUS): 1.0, (COULOMB, VISCOUS): 3.0, (OFFSET, COULOMB): 3.0})
    rounds = [a_round(sketch.library, OFFSET, COULOMB), a_round(sketch.library, VISCOUS)]
    kept, checks = challenged(sketch, [OFFSET, VISCOUS], rounds)
    assert kept == [OFFSET, VISCOUS]
    assert {k: [c.key for c in v] for k, v in checks.items()} == {
        OFFSET: [OFFSET, COULOMB],
        VISCOUS: [VISCOUS],
    }


def test_a_special_case_that_does_as_well_takes_the_place(sketch):
    """Beside what was still missing when it was named, the larger effect fitted better."""
    everything = (ASYMMETRIC, SPRING), (VISCOUS, SPRING)
    costs(sketch, {everything[0]: 1.0, everything[1]: 1.001})
    sketch.costs |= {frozenset([ASYMMETRIC]): 9.0, frozenset([ASYMMETRIC, VISCOUS]): 9.0}
    rounds = [a_round(sketch.library, ASYMMETRIC, VISCOUS), a_round(sketch.library, SPRING)]
    assert challenged(sketch, [ASYMMETRIC, SPRING], rounds)[0] == [VISCOUS, SPRING]
    assert challenged(sketch, [VISCOUS, SPRING], rounds)[0] == [VISCOUS, SPRING]
    sketch.costs[frozenset(everything[1])] = 2.0
    assert challenged(sketch, [ASYMMETRIC, SPRING], rounds)[0] == [ASYMMETRIC, SPRING]


def test_a_larger_effect_that_gains_surely_but_hardly_takes_no_place(sketch):
    """Further parameters always gain a little in most windows."""
    gain = ripple(0.01, size=0.002)
    costs(sketch, {(VISCOUS, SPRING): 1.0, (ASYMMETRIC, SPRING): 1.0 - gain})
    sketch.costs |= {frozenset([ASYMMETRIC]): 9.0, frozenset([ASYMMETRIC, VISCOUS]): 9.0}
    assert t_value(gain) > DEFAULT.significant
    rounds = [a_round(sketch.library, VISCOUS, ASYMMETRIC), a_round(sketch.library, SPRING)]
    kept, checks = challenged(sketch, [VISCOUS, SPRING], rounds)
    assert kept == list(checks) == [VISCOUS, SPRING]  # no checks: swapped to and fro


def test_a_rival_that_was_far_behind_while_others_were_missing_is_tried(sketch):
    """A weak drive fits a heavy rotor, until both have the friction that was missing as well."""
    costs(sketch, {(OFFSET, VISCOUS): 3.0, (COULOMB, VISCOUS): 1.0})
    far = a_round(sketch.library, OFFSET, COULOMB)
    far.contenders[1].cost[:] = 7.0
    kept, _ = challenged(sketch, [OFFSET, VISCOUS], [far, a_round(sketch.library, VISCOUS)])
    assert kept == [COULOMB, VISCOUS]


def test_a_rival_that_was_far_behind_beside_all_others_is_not_tried(sketch):
    costs(sketch, {(OFFSET, VISCOUS): 3.0, (OFFSET, COULOMB): 1.0})
    far = a_round(sketch.library, VISCOUS, COULOMB)
    far.contenders[1].cost[:] = 7.0
    kept, _ = challenged(sketch, [OFFSET, VISCOUS], [a_round(sketch.library, OFFSET), far])
    assert kept == [OFFSET, VISCOUS]


def test_a_rival_in_an_impostors_place_is_fitted_to_where_it_belongs():
    """A heavy rotor with a dragging bearing, at first an encoder that tells less, with some drag.

    Fitted with what follows from the start, inertia stops short, and a weak drive makes up for it.
    """
    made = as_made(ROTOR)
    inertia = ROTOR.armature[0] + ROTOR.links[0][2]
    made["armature"] += 0.8 * inertia
    made["damping"] *= 3.0
    (logs,) = record_rough(ROTOR, [made], seed=3, seconds=3.0)
    logs = {kind: logs[kind] for kind in ("multisine", "fast")}
    problem = set_up(ROTOR.model, logs, ("fast",), DiagnosisSettings(threads=1))
    library, limits = problem.library, problem.thresholds
    keys = {key[0]: key for key in library.sites}
    gain, drag, scale, armature = (
        keys[name] for name in ("actuator_gain", "viscous_friction", "encoder_scale", "armature")
    )
    follows = rough_nuisances(
        library, limits.rough_share, limits.rough_imperfect, limits.rough_tolerance
    )
    problem = problem.with_nuisances(follows, worth=limits.rough_numbers)
    impostor = Hypothesis({scale: np.array([1.0 / 1.8]), drag: np.array([3.0 / 1.8 * 0.05])})
    named = frozenset({scale, drag})
    at = problem.linearise(impostor, problem.fitted, named)
    impostor = refit(problem, at, named, start=impostor)
    assert impostor.hypothesis[scale][0] == pytest.approx(1.0 / 1.8, rel=0.05)
    start = impostor.hypothesis.without(scale).with_values(armature, np.array([0.02]))
    swapped = challenge.with_rival(problem, impostor, frozenset({armature, drag}), start)
    told = {n.key: (n.value(swapped.hypothesis) - n.nominal) / n.tolerance for n in follows}
    assert swapped.hypothesis[armature][0] == pytest.approx(made["armature"][0], rel=0.03)
    assert swapped.hypothesis[drag][0] == pytest.approx(0.15, rel=0.05)
    assert abs(told[gain]) < 0.5
