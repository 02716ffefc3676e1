"""Screening: the size from which the fit of an effect starts."""

import numpy as np
import pytest

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.former.fitting import free_tangents
from leglab.diagnosis.former.screening import screen
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.studies.blind.faulty_bench import FaultyBench, references

VALVE = "knee_valve"


@pytest.fixture(scope="module")
def candidate():
    """What screening says of one effect on a bench that differs from its model in one value."""

    def screened(effect, parameter, value):
        motions = references(np.random.default_rng(5), duration=3.0)
        plant = FaultyBench(tuning={(VALVE, parameter): value})
        rng = np.random.default_rng(6)
        logs = {name: plant.record(motions[name], rng) for name in ("multisine", "steps")}
        problem = set_up("knee_bench", logs, (), DiagnosisSettings(effects=(effect,), threads=1))
        at = problem.linearise(Hypothesis(), problem.fitted)
        own = free_tangents(problem, at, ())
        (found,) = screen(problem, at, own, np.inf, started_best=True)
        return found

    return screened


@pytest.mark.parametrize("pressure", [15.3e6, 16.9e6, 17.1e6])
def test_a_size_between_two_trials_is_tried(candidate, pressure):
    """Trials of 15.04 and 17.6 MPa: the far one is 3 % off, and costs more than none at all."""
    found = candidate("supply_pressure", "supply_pressure", pressure)
    assert found.gain > 0.0
    assert found.values[0] == pytest.approx(pressure, rel=2e-3)


def test_the_right_side_is_tried_where_its_trial_goes_too_far(candidate):
    """15.04 MPa lies on the wrong side of the model's 16, and yet nearer than 17.6."""
    found = candidate("supply_pressure", "supply_pressure", 16.22e6)
    assert found.values[0] == pytest.approx(16.22e6, rel=2e-3)


@pytest.mark.parametrize("temperature", [33.0, 46.0, 54.0])
def test_a_fit_of_warm_oil_starts_near_its_temperature(candidate, temperature):
    """Viscosity bends: without a trial at 50 degC, steps to 46 and 54 would end further off."""
    found = candidate("oil_viscosity", "oil_temperature", temperature)
    assert found.gain > 0.0
    assert found.values[0] == pytest.approx(temperature, abs=1.0)
