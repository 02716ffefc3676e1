"""Priors of what differs between good machines, beside errors that are few numbers.

The errors of a rough machine are thousands of numbers in a fit, and worth some thirty. Counted one
by one they carried every nuisance to the end of its box, and faults with them.
"""

from dataclasses import replace

import numpy as np
import pytest

from leglab.diagnosis import improve
from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.former.fitting import Fit, FreeTangents, profiled, refit
from leglab.diagnosis.former.nuisances import rough_nuisances, within_tolerance
from leglab.diagnosis.former.search import total_cost
from leglab.diagnosis.search.pipeline import DiagnosisSettings, Search, set_up
from leglab.diagnosis.plant.model import Change, Machine
from tests.rigs import PENDULUM, Truth, record

GAIN = ("actuator_gain", "drive")


@pytest.fixture(scope="module")
def weak():
    """A motor that has lost a sixth of its torque, under a model whose error is counted in."""
    kinds = ("multisine", "fast")
    # All that it moves and overcomes is a fifth more instead.
    more = {name: 1.2 * getattr(PENDULUM, name) for name in ("load", "motor", "pull", "viscous")}
    rig = replace(PENDULUM, **more)
    logs = {k: record(rig, k, Truth(), seed=i, seconds=3.0) for i, k in enumerate(kinds)}
    settings = DiagnosisSettings(effects=("actuator_gain",), threads=1)
    problem = set_up(PENDULUM.model, logs, (), settings)
    return problem.trusting(problem.discrepancy(Hypothesis()))


def fitted(problem) -> Fit:
    at = problem.linearise(Hypothesis(), problem.fitted)
    return refit(problem, at, frozenset(), iterations=8, tolerance=1e-6)


def departed(fit):
    (nuisance,) = fit.at.nuisances
    return (nuisance.value(fit.hypothesis) - nuisance.nominal) / nuisance.tolerance


def test_a_nuisance_goes_as_far_as_errors_worth_few_numbers_carry_it(weak):
    each = fitted(weak.with_nuisances(weak.nuisances))
    few = weak.with_nuisances(weak.nuisances, worth=5.0)
    fit = fitted(few)
    # Replays and forces along the measured motion are worth as much each.
    weight = few.size * few.fitted.sum() / 10.0
    assert few.prior_weight(few.fitted) == pytest.approx(weight)
    assert weak.prior_weight(weak.fitted) == 1.0
    assert departed(each) == pytest.approx(-4.0, abs=0.2)  # the end of its box
    assert -3.0 < departed(fit) < -0.3
    # And it is at the least of chi-square and weighted prior.
    (nuisance,) = fit.at.nuisances

    def cost(eta):
        moved = few.moved(Hypothesis(), (nuisance,), np.array([eta]))
        return few.cost(few.residual(moved, few.fitted), weight * eta**2)

    assert fit.cost == pytest.approx(cost(departed(fit)))
    assert fit.cost < min(cost(departed(fit) - 0.2), cost(departed(fit) + 0.2))


def test_what_an_effect_gains_to_first_order_counts_priors_alike(weak):
    few = weak.with_nuisances(weak.nuisances, worth=30.0)
    none = np.zeros(0)
    own = FreeTangents(columns=np.zeros((few.fitted.sum(), few.size, 0)), lower=none, upper=none)
    for problem in (weak, few):
        at = problem.linearise(Hypothesis(), problem.fitted)
        weight = problem.prior_weight(problem.fitted)
        tried = [
            problem.cost(at.residual + eta * at.tangents[:, :, 0], weight * eta**2)
            for eta in np.linspace(-4.0, 4.0, 801)
        ]
        # Reweighted three times, not to the end.
        assert profiled(problem, at, own)[1] == pytest.approx(min(tried), rel=0.03)


def test_the_cost_of_a_fit_has_its_departures(weak):
    few = weak.with_nuisances(weak.nuisances, worth=30.0)
    fit = fitted(few)
    plain = few.window_cost(fit.hypothesis)
    # The likelihood of n numbers of mean square c and the prior: c^(-n/2) exp(-d^2/2).
    whole = total_cost(few, fit) ** (-0.5 * few.worth)
    np.testing.assert_allclose(
        whole / plain ** (-0.5 * few.worth), np.exp(-0.5 * departed(fit) ** 2)
    )
    np.testing.assert_array_equal(total_cost(weak, fit), plain)
    assert few.calibrated(Hypothesis()).worth is None


def test_a_model_that_is_to_be_used_is_recalibrated_as_far_as_replays_ask_for(weak):
    few = weak.with_nuisances(weak.nuisances, worth=3.0)
    fit = fitted(few)
    found = Search(problem=few, baseline=fit, fit=fit, named=(), rounds=())
    problem, hypothesis = improve._recalibrated(found, ())
    told, free = (
        p.noise_levels(h).mean() for p, h in ((few, fit.hypothesis), (problem, hypothesis))
    )
    assert free < 0.7 * told
    # An effect that has a name keeps the value that was told; its nuisance is that effect itself.
    named = replace(fit, free=frozenset({GAIN}))
    found = replace(found, fit=named, named=(GAIN,))
    _, hypothesis = improve._recalibrated(found, (GAIN,))
    assert hypothesis[GAIN] == fit.hypothesis[GAIN]


def test_shapes_that_no_diagnosis_names_follow_on_a_rough_machine():
    machine = Machine("knee_bench")
    library = Library(machine)
    tolerance = {(n.key[0], n.index): n.tolerance for n in within_tolerance(library)}
    found = {(n.key[0], n.index): n for n in rough_nuisances(library, 0.3, 0.7, 2.0)}
    for name, count in (("metering_edges", 1), ("friction_curve", 2)):
        site = library.sites[name, "knee_valve"]
        for i in range(count):
            assert found[name, i].tolerance == pytest.approx(site.parameters[i].scale)
    for known, width in tolerance.items():
        assert found[known].tolerance == pytest.approx(2.0 * width)
    # No machine is without delay and hysteresis; a lap may be as drawn.
    for name, share in (("command_delay", 0.7), ("valve_hysteresis", 0.7), ("valve_deadband", 0.3)):
        (parameter,) = library.sites[name, "knee_valve"].parameters
        assert found[name, 0].tolerance == pytest.approx(share * parameter.scale)


def test_effects_that_lower_the_same_parameter_end_where_the_plugin_does():
    machine = Machine("knee_bench")
    for name, most, least in (
        ("stribeck_velocity", 10.0, 0.05),  # must be more than zero
        ("stribeck_exponent", 20.0, 0.0),
        ("viscous", 1e6, 0.0),
    ):
        row = machine.base.elements["knee_valve"][1].parameters[name]
        own = machine.parameter("knee_valve", name)
        for differences, end in (
            ((-0.6 * own, -0.6 * own), row.minimum + least * own),
            ((1e7, 1e7), most),
            ((0.2 * own, -0.1 * own), 1.1 * own),
        ):
            change = Change(machine)
            for difference in differences:
                change.add_parameter("knee_valve", name, difference)
            assert change.parameter("knee_valve", name) == pytest.approx(end)


def test_before_its_onset_an_effect_is_as_a_good_machine_has_it():
    """Friction of good machines scatters: before it changes it is not the model's."""
    key, offset = ("viscous_friction", "hinge"), ("force_offset", "hinge")
    logs = {k: record(PENDULUM, k, Truth(), seed=0, seconds=3.0) for k in ("multisine", "slow")}
    problem = set_up(PENDULUM.model, logs, (), DiagnosisSettings(threads=1))
    site = problem.library.sites[key]
    good = Hypothesis({key: 1.3 * site.nominal, offset: np.array([0.02])})
    onsets = np.array([1.5, np.inf])
    begun = good.changed(key, 3.0 * site.nominal, onsets)
    start, recording = problem.replay.start, problem.replay.recording
    before = start + problem.replay.window < onsets[recording]
    after = start >= onsets[recording]
    for hypothesis in (begun, begun.with_values(offset, good[offset])):
        found = problem.residual(hypothesis)
        throughout = good.with_values(key, 3.0 * site.nominal)
        np.testing.assert_array_equal(found[before], problem.residual(good)[before])
        np.testing.assert_array_equal(found[after], problem.residual(throughout)[after])
    # What was never there is absent before, and without an onset nothing is.
    absent = begun.without(key).changed(key, site.nominal, onsets).not_begun(key)
    assert key not in absent
    assert begun.with_onset(key, None).not_begun(key) == good.without(key)
    assert begun.not_begun(key)[key] == good[key]
