"""Corrections by name have to predict: in closed loop on a bench that shares no code with leglab.

No other test runs the bank where its simulation is not the machine.
"""

from dataclasses import replace

import numpy as np
import pytest

import leglab.runs.fault_simulation as making
from leglab import RunSettings
from leglab.base.scenario import Scenario, get_scenario
from leglab.causes.table import CAUSES, kind_of
from leglab.runs.loop import Loop
from rigs.closed_loop import bench_loop, bench_settings, run_bench
from rigs.rough_bench import exact_specimen

CHANGE = 10.0  # s
HEALTHY = exact_specimen(1)
EDGES = ("lap_pa", "lap_at", "lap_pb", "lap_bt")
LAP = HEALTHY.changed(**{edge: HEALTHY[edge] + 0.03 for edge in EDGES})
SEALS = HEALTHY.changed(internal_leakage=25.0 * HEALTHY["internal_leakage"])


def settings_of(controller, after=3.0, **config):
    return bench_settings(
        HEALTHY, controller, duration=CHANGE + after, seed=1, controller_config=config
    )


def errors(controller, changed, windows, **config):
    """RMS error [rad] in windows after the change."""
    settings = settings_of(controller, windows[-1][1], **config)
    return rms(run_bench(settings, [(0.0, HEALTHY), (CHANGE, changed)]), windows)


def rms(history, windows, change=CHANGE):
    assert not history.failure
    after = history.time - change
    parts = [history.error[(after >= a) & (after < b)] for a, b in windows]
    return np.array([np.sqrt(np.mean(part**2)) for part in parts])


def test_a_change_that_the_bank_has_not_costs_little():
    windows = [(0.6, 1.2), (1.2, 2.4)]
    base = errors("bsnn_arx", LAP, windows)
    bank = errors("bsnn_arx_bank", LAP, windows, left_out=kind_of("valve_deadband"))
    assert (bank < 1.4 * base).all()


@pytest.mark.slow("half a minute")
def test_a_play_that_would_eat_the_command_is_not_found(monkeypatch):
    """Of a slow squat, whose commands move by less than the widths that are tried."""
    monkeypatch.setattr(making, "_banks", {})
    monkeypatch.setattr(making, "CAUSES", {"": CAUSES["valve_null_shift"]})
    monkeypatch.setattr(making, "_write", lambda *_: None)
    monkeypatch.setattr(making, "_read", lambda *_: None)
    change = 22.0  # a squat takes 3 s, and the first six are not judged
    shift = get_scenario("valve_null_shift", duration=change + 5.0, severity=0.035).changes
    changes = tuple(replace(each, start=change) for each in shift)
    scenario = Scenario(name="squat", duration=change + 5.0, reference="squat", changes=changes)

    def error(controller):
        settings = RunSettings(
            scenario="nominal",
            model="leg_rail",
            reference="squat",
            controller=controller,
            tolerance=0.1,
            seed=1000,
        )
        history = Loop(settings, scenario=scenario).run()
        return rms(history, [(0.6, 1.2), (1.2, 2.4), (2.4, 5.0)], change)

    assert (error("bsnn_arx_bank") < 1.2 * error("bsnn_arx")).all()


def test_a_change_that_the_bank_has_gains():
    windows = [(0.3, 0.6), (0.6, 1.2)]
    base, bank = (errors(name, SEALS, windows) for name in ("bsnn_arx", "bsnn_arx_bank"))
    assert (bank < 0.5 * base).all()


def test_a_map_that_predicts_badly_is_out_at_once_and_for_good():
    """The bench stays as it is; a map that is wrong everywhere joins, sure of itself."""
    loop = bench_loop(settings_of("bsnn_arx"), [(0.0, HEALTHY)])
    adaptation, shares = loop.controller.adaptation, []
    command = loop.controller.command

    def joined(measurement, reference):
        if measurement.time >= CHANGE and not adaptation.contenders:
            wrong = adaptation.learner.copy()
            wrong.parameters = wrong.parameters + 0.1
            adaptation.propose(wrong, odds=40.0, error=1.0)
        if adaptation.contenders:
            shares.append(adaptation.shares())
        return command(measurement, reference)

    loop.controller.command = joined
    history = loop.run()
    shares = np.array(shares)
    assert shares[0, 1] > 0.9
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)
    out = np.flatnonzero(shares[:, 1] == 0.0)
    assert out[0] * 0.002 < 0.05
    assert (shares[out[0] :, 1] == 0.0).all()
    late = history.time > CHANGE + 1.0
    assert np.abs(history.error[late]).max() < 5e-3


def test_a_map_that_won_goes_on_alone():
    loop = bench_loop(settings_of("bsnn_arx"), [(0.0, HEALTHY)])
    adaptation = loop.controller.adaptation
    loop.run()
    other = adaptation.learner.copy()
    other.parameters = other.parameters + 1e-3
    adaptation.propose(other, odds=9.0, error=1.0)
    np.testing.assert_allclose(adaptation.shares(), [0.1, 0.9])
    adaptation.settle(1)
    np.testing.assert_array_equal(adaptation.learner.parameters, other.parameters)
    assert adaptation.shares().tolist() == [1.0]


@pytest.mark.parametrize("controller", ["bsnn_arx", "bsnn_arx_bank"])
def test_the_same_bench_moves_alike_twice(controller):
    first, second = (errors(controller, SEALS, [(0.0, 3.0)]) for _ in range(2))
    assert first.tolist() == second.tolist()


def test_a_valve_whose_overlap_grew_tracks_like_a_healthy_one():
    """Inside the calibrated overlap no map of flows can tell which command is needed."""
    windows = [(-5.0, 0.0), (1.2, 2.4), (4.0, 6.0)]
    base, bank = (errors(name, LAP, windows) for name in ("bsnn_arx", "bsnn_arx_bank"))
    assert bank[1] < 0.8 * base[1]
    assert bank[2] < 1.3 * bank[0] < 0.8 * base[2]


def test_hysteresis_is_found_and_undone():
    """One map of motion has no memory: `bsnn_arx` keeps ten times as much error for good."""
    changed = HEALTHY.changed(hysteresis=0.055)
    windows = [(1.2, 2.4), (5.0, 6.0)]
    base, bank = (errors(name, changed, windows) for name in ("bsnn_arx", "bsnn_arx_bank"))
    assert (bank < (0.4, 0.15) * base).all()
    settings = settings_of("bsnn_arx_bank", after=6.0)
    loop = bench_loop(settings, [(0.0, HEALTHY), (CHANGE, changed)])
    loop.run()
    assert loop.controller.adaptation.valves[0, 2] == pytest.approx(0.055, abs=0.003)


def test_no_hysteresis_is_found_where_there_is_none():
    loop = bench_loop(settings_of("bsnn_arx_bank"), [(0.0, HEALTHY), (CHANGE, SEALS)])
    loop.run()
    adaptation = loop.controller.adaptation
    adaptation.settle(int(np.argmax(adaptation.shares())))
    assert not adaptation.valves.any()
