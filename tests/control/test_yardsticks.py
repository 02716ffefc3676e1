"""What adaptive control is measured against: the oracle, and machines off their drawing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from leglab import Run, RunSettings, run_scenario
from leglab.base.errors import LeglabError, SimulationError
from leglab.base.scenario import get_scenario
from leglab.control import make_controller
from leglab.machine.changes import vary_bodies, vary_parameters
from leglab.machine.simulation import Simulation, load_model
from leglab.runs.inversion import exact_commands
from leglab.runs.loop import Loop


def run(controller: str, **settings) -> Run:
    options = {"scenario": "seal_wear", "model": "knee_bench", "duration": 12.0, **settings}
    return run_scenario(RunSettings(controller=controller, **options))


def rms(result: Run, start: float, end: float) -> float:
    time = result.history.time
    return float(np.sqrt(np.mean(result.history.error[(time >= start) & (time < end)] ** 2)))


def test_oracle_knows_both_machines_from_the_first_stride_on():
    oracle, frozen, static = (run(name) for name in ("oracle", "frozen", "static_feedforward"))
    assert rms(oracle, 2, 6) < rms(static, 2, 6) / 4
    assert rms(oracle, 7, 12) < rms(frozen, 7, 12) / 10
    # Nothing is learned: the second stride on a machine is like the fourth.
    assert rms(oracle, 7.2, 8.4) == pytest.approx(rms(oracle, 9.6, 10.8), rel=0.05)


def end_error(history) -> float:
    """RMS in the last four strides [mrad]."""
    time = history.time
    return 1e3 * float(np.sqrt(np.mean(history.error[time > time[-1] - 4.8] ** 2)))


@pytest.mark.parametrize(
    "model", ["knee_bench", pytest.param("leg", marks=pytest.mark.slow("minutes of the leg"))]
)
def test_the_oracle_learns_from_what_its_controller_measured(model):
    """Recordings a latency older or younger give it a worse map: nothing is left to align."""
    settings = RunSettings(scenario="supply_drop", controller="oracle", model=model)
    loop = Loop(settings)
    setup = loop._setup
    latency = setup.machine.latency
    runs = setup.foreknowledge.bench_runs()

    def error(shift: float) -> float:
        def shifted():
            return [
                replace(run, position=CubicSpline(run.time, run.position)(run.time + shift))
                for run in runs
            ]

        knowing = replace(setup.foreknowledge, bench_runs=shifted)
        oracle = make_controller("oracle", replace(setup, foreknowledge=knowing), {})
        return end_error(Loop(settings, controller=oracle).run())

    aligned = error(0.0)
    assert aligned == end_error(loop.run())
    assert error(latency) > 1.5 * aligned
    assert error(-latency) > 1.5 * aligned


@pytest.mark.parametrize("scenario", ["nominal", "supply_drop", "friction_rise", "hot_oil"])
def test_the_oracle_is_a_bound_for_the_map_that_is_learned(scenario):
    bounds, learned = (
        end_error(run(name, scenario=scenario, duration=20.0).history)
        for name in ("oracle", "bsnn_arx")
    )
    assert bounds <= learned


@pytest.mark.slow("many runs")
def test_the_exact_inverse_leaves_what_sensors_and_valves_do():
    errors = {
        name: end_error(run(name, duration=20.0).history) for name in ("exact_inverse", "oracle")
    }
    assert errors["exact_inverse"] < errors["oracle"] / 5
    assert errors["exact_inverse"] < 0.1


def test_commands_are_found_for_a_plant_known_in_closed_form():
    """A gain with a lag and a feedback: the commands are those of the plant turned round."""
    period, lag, gain, feedback = 0.002, 0.01, 3.0, 5.0
    time = np.arange(5000) * period
    wanted = np.column_stack([np.sin(2 * time) + 0.3 * np.sin(7 * time), np.cos(3 * time)])
    wanted *= 0.4 * (1 - np.exp(-(time**2)))[:, None]

    def try_out(commands):
        position, speed = np.zeros(2), np.zeros(2)
        errors, feedbacks = np.empty_like(wanted), np.empty_like(wanted)
        for k in range(len(time)):
            errors[k] = wanted[k] - position
            feedbacks[k] = feedback * errors[k]
            speed += period / lag * (gain * (commands[k] + feedbacks[k]) - speed)
            position = position + period * speed
        return errors, feedbacks

    slope = np.full_like(wanted, 1 / gain)
    found = exact_commands(try_out, slope, np.zeros_like(wanted), period)
    error, back = try_out(found)
    inside = slice(250, -250)
    assert np.sqrt(np.mean(error[inside] ** 2)) < 1e-4
    rate = np.gradient(wanted, period, axis=0)
    exact = (rate + lag * np.gradient(rate, period, axis=0)) / gain
    np.testing.assert_allclose((found + back)[inside], exact[inside], atol=0.02)


def test_a_bench_that_fails_is_said(monkeypatch):
    def fails(self, *_):
        raise SimulationError("the knee blew up")

    monkeypatch.setattr(Simulation, "check", fails)
    with pytest.raises(LeglabError, match="the knee blew up"):
        Loop(RunSettings(scenario="seal_wear", controller="oracle", model="knee_bench", seed=91))


def test_scenario_of_a_machine_that_has_changed_before():
    scenario = get_scenario("seal_wear", ramp_duration=2.0)
    changed = scenario.changed_from_start()
    assert [c.start for c in changed.changes] == [0.0]
    nominal = 2e-13
    assert changed.value_at(0.0, "internal_leakage", "knee_valve", nominal) == pytest.approx(
        scenario.value_at(19.0, "internal_leakage", "knee_valve", nominal)
    )


def test_specimens_differ_by_the_tolerance_and_only_in_what_is_made():
    drawing = load_model("leg", visual=False)
    names = ("rated_flow", "internal_leakage", "viscous")
    ratios = []
    for seed in range(30):
        simulation = Simulation(drawing)
        base = {(a, n): simulation.parameter(a, n) for a in simulation.actuators for n in names}
        bore = [simulation.parameter(a, "bore") for a in simulation.actuators]
        vary_parameters(simulation, 0.1, seed)
        assert [simulation.parameter(a, "bore") for a in simulation.actuators] == bore
        ratios += [simulation.parameter(*key) / value for key, value in base.items()]
        for actuator in simulation.actuators:
            sheet = simulation.cylinder_parameters(actuator)
            assert sheet["static"] >= sheet["coulomb"]
    logs = np.log(ratios)
    assert len(set(ratios)) == len(ratios)
    assert np.std(logs) == pytest.approx(0.1, rel=0.15)
    assert abs(np.mean(logs)) < 0.02

    specimen = load_model("leg", visual=False)
    vary_bodies(specimen, 0.1, 3)
    moving = drawing.body_mass > 0
    ratio = specimen.body_mass[moving] / drawing.body_mass[moving]
    assert 0.03 < np.std(np.log(ratio)) < 0.2
    np.testing.assert_allclose(
        specimen.body_inertia[moving] / drawing.body_inertia[moving], ratio[:, None].repeat(3, 1)
    )
    # What MuJoCo derives from the masses has followed.
    assert not np.allclose(specimen.dof_invweight0, drawing.dof_invweight0)


def test_a_specimen_is_the_seeds_and_the_controller_knows_the_drawing_alone():
    one, again = (run("static_feedforward", tolerance=0.1, seed=2, duration=3.0) for _ in range(2))
    np.testing.assert_array_equal(one.history.position, again.history.position)
    plain = run("static_feedforward", seed=2, duration=3.0)
    assert rms(one, 1, 3) != pytest.approx(rms(plain, 1, 3), rel=0.02)
    first = one.history.diagnostics["feedforward"][0], plain.history.diagnostics["feedforward"][0]
    np.testing.assert_array_equal(*first)


@pytest.mark.parametrize("tolerance", [-0.1, 0.5, float("nan")])
def test_impossible_tolerances_are_refused(tolerance):
    with pytest.raises(LeglabError, match=r"tolerance .* is outside \[0, 0.3\]"):
        run("pd", tolerance=tolerance)
