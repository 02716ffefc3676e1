"""The closed loop: determinism, changes, and everything a controller can do wrong."""

import numpy as np
import pytest

from leglab import RunSettings, run_scenario
from leglab.base.errors import LeglabError
from leglab.base.scenario import ParameterChange, Scenario
from leglab.machine.sensors import (
    SensorConfiguration,
    in_whole_steps,
    loop_timing,
    quantise,
)
from leglab.machine.simulation import Simulation, load_model
from leglab.runs.loop import Loop
from leglab.runs.preparation import Preparation


def settings(**changes) -> RunSettings:
    base = {"scenario": "seal_wear", "model": "knee_bench", "duration": 4.0}
    return RunSettings(**{**base, **changes})


def test_same_seed_same_bits_and_other_seed_other_bits():
    first, again, other = (run_scenario(settings(seed=seed)) for seed in (3, 3, 4))
    assert first.recording == again.recording
    assert first.recording != other.recording


def test_a_worn_seal_costs_tracking_and_is_recorded():
    run = run_scenario(settings(duration=8.0))
    before, after = run.metrics["phases"]
    assert (before["name"], after["name"]) == ("before", "after")
    assert after["rms_rad"]["knee"] > 1.05 * before["rms_rad"]["knee"]
    leakage = run.recording["knee_valve_internal_leakage"]
    assert set(np.unique(leakage)) == {1.7e-13, 1.7e-12}
    assert np.all((run.recording.time >= 4.0) == (leakage > 1e-12))


def test_a_ramp_is_followed():
    run = run_scenario(settings(duration=8.0, ramp_duration=2.0))
    assert [phase["name"] for phase in run.metrics["phases"]] == ["before", "during", "after"]
    time, leakage = run.recording.time, run.recording["knee_valve_internal_leakage"]
    expected = 1.7e-13 * (1 + 9 * np.clip((time - 4.0) / 2.0, 0, 1))
    np.testing.assert_allclose(leakage, expected, rtol=1e-9)


def test_the_energy_of_the_phases_is_that_of_the_recording():
    run = run_scenario(settings(duration=4.0))
    drawn = run.recording["knee_energy_supply"]
    phases = run.metrics["phases"]
    assert drawn[-1] - drawn[0] == pytest.approx(sum(p["energy_j"]["all"] for p in phases))
    # The knee needs tens to hundreds of watts: 160 bar times some l/min.
    assert 10 < phases[1]["energy_j"]["knee"] / 2.0 < 2000


def test_feedforward_beats_pd_on_the_nominal_machine():
    pd, feedforward = (
        run_scenario(settings(scenario="nominal", controller=name)).metrics["phases"][0]
        for name in ("pd", "static_feedforward")
    )
    assert feedforward["rms_rad"]["all"] < 0.2 * pd["rms_rad"]["all"]


def test_controllers_see_measurements_not_the_truth():
    run = run_scenario(settings(scenario="nominal"))
    measured, truth = run.recording["knee_position"], run.recording["knee_truth"]
    difference = measured - truth
    resolution = 2 * np.pi / 131072
    expected = np.hypot(2e-5, resolution / np.sqrt(12))
    assert np.std(difference) == pytest.approx(expected, rel=0.1)
    np.testing.assert_allclose(np.round(measured / resolution) * resolution, measured, atol=1e-12)


def test_replay_of_the_recorded_commands_gives_the_recorded_motion():
    run = run_scenario(settings(scenario="nominal", duration=1.0))
    simulation = Simulation(load_model("knee_bench"))
    from leglab.commissioning.calibration import settle

    settle(simulation)
    for command, position in zip(run.history.command, run.history.position, strict=True):
        assert simulation.position()[0] == position[0]
        simulation.data.ctrl[:] = command
        simulation.step(4)


class _Broken:
    def __init__(self, value):
        self.value = value

    def reset(self, measurement):
        pass

    def command(self, measurement, reference):
        return self.value if measurement.time >= 0.5 else np.zeros(1)

    def diagnostics(self):
        return {}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.array([np.nan]), "'broken' gave nan for joint 'knee' at 0.5 s"),
        (np.zeros(3), r"'broken' gave shape \(3,\) at 0.5 s"),
        (None, "'broken' gave NoneType at 0.5 s"),
    ],
)
def test_a_broken_controller_stops_the_run_and_the_record_is_kept(value, message):
    history = Loop(
        settings(scenario="nominal", controller="broken", duration=2.0), controller=_Broken(value)
    ).run()
    import re

    assert re.search(message, history.failure)
    assert history.time[-1] == pytest.approx(0.498)


def test_a_change_that_fits_no_element_is_refused():
    change = ParameterChange(parameter="lap", element="hip_*", value=2.0, start=0.1)
    scenario = Scenario(name="odd", duration=1.0, changes=(change,))
    with pytest.raises(LeglabError, match="'odd' changes 'lap' of 'hip_\\*'"):
        Loop(settings(), scenario=scenario)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": -1}, "seed -1 is negative"),
        ({"controller": "pdd"}, "unknown controller 'pdd'.*did you mean 'pd'"),
        ({"scenario": "seal_ware"}, "unknown scenario.*did you mean 'seal_wear'"),
        ({"reference": "moonwalk"}, "unknown reference"),
        ({"reference": "squat", "reference_config": {"depth": 2.5}}, "'knee' goes to.*range"),
        ({"reference": "walking_stride", "reference_config": {"period": 0.2}}, "'knee' moves at"),
        ({"sensors": {"control_period": 0.0012}}, "multiple of the model's timestep"),
        ({"sensors": {"latency": 0.003}}, "latency.*at most control_period"),
        ({"sensors": {"latancy": 0.003}}, "did you mean 'latency'"),
        ({"severity": 1e9}, "severity.*outside"),
        ({"duration": -1.0}, "duration -1.0 s is not allowed"),
        ({"timestep": 0.01}, "too long"),
        ({"controller_config": {"position_gain": [1.0, 2.0]}}, "'position_gain' has 2 values"),
    ],
)
def test_bad_settings_get_one_line(change, message):
    with pytest.raises(LeglabError, match=message) as caught:
        run_scenario(settings(**change))
    assert "\n" not in str(caught.value)


def test_timing_counts_steps():
    timing = loop_timing(SensorConfiguration(), 5e-4)
    assert (timing.to_sample, timing.to_command) == (2, 2)


@pytest.mark.parametrize(
    ("timestep", "expected"),
    [(1e-3, (2e-3, 1e-3)), (2e-3, (2e-3, 2e-3)), (5e-3, (5e-3, 5e-3)), (3e-4, (2.1e-3, 1.2e-3))],
)
def test_default_timing_is_rounded_up_to_whole_steps(timestep, expected):
    fitted = in_whole_steps(SensorConfiguration(), timestep)
    assert (fitted.control_period, fitted.latency) == pytest.approx(expected)
    loop_timing(fitted, timestep)
    asked = SensorConfiguration(control_period=2e-3, latency=1e-3)
    assert in_whole_steps(asked, timestep) is asked


def test_recorded_velocities_are_the_loop_s_filter_of_the_recorded_positions():
    recording = run_scenario(settings(duration=1.0)).recording
    sensors = SensorConfiguration()
    keep = np.exp(-2 * np.pi * sensors.velocity_cutoff * sensors.control_period)
    read, speed = recording["knee_position"], [0.0]
    for step in np.diff(read):
        speed.append(keep * speed[-1] + (1 - keep) * step / sensors.control_period)
    np.testing.assert_allclose(recording["knee_velocity"], speed, rtol=1e-9, atol=1e-9)
    assert recording.metadata["units"]["knee_velocity"] == "rad/s"


def test_quantise_rounds_to_counts():
    np.testing.assert_allclose(quantise(np.array([0.1]), 4), [0.0])
    np.testing.assert_allclose(quantise(np.array([1.5]), 4), [np.pi / 2])
    np.testing.assert_array_equal(quantise(np.array([0.1]), 0), [0.1])


def test_sensors_of_the_loop_and_of_the_recording_have_their_noise():
    sensors = {"position_noise": 1e-3, "encoder_counts": 0, "latency": 0.0}
    settings = RunSettings(scenario="nominal", model="knee_bench", duration=1.0, sensors=sensors)
    loop, heard = Loop(settings), []
    for _ in range(loop.count - 1):
        truth = loop.simulation.position()
        heard.append(loop.observe().measurement.position - truth)
        loop.act()
        loop.advance()
    loop.close()
    assert np.std(heard) == pytest.approx(1e-3, rel=0.15)
    run = run_scenario(settings)
    logged = run.recording["knee_position"] - run.history.position[:, 0]
    assert np.std(logged) == pytest.approx(1e-3, rel=0.15)


def test_a_specimen_has_bodies_of_its_own():
    preparation = Preparation(RunSettings(scenario="nominal", model="knee_bench", tolerance=0.1))
    machine, drawing = preparation.machine(), preparation.nominal.model
    has = drawing.body_mass > 0
    preparation.start(machine, 3, 0.1)
    first = machine.model.body_mass[has].copy()
    assert not np.isclose(first, drawing.body_mass[has], rtol=1e-3).any()
    preparation.start(machine, 4, 0.1)
    assert not np.isclose(first, machine.model.body_mass[has], rtol=1e-3).any()
    preparation.start(machine, 3)
    np.testing.assert_array_equal(machine.model.body_mass, drawing.body_mass)


@pytest.mark.parametrize("duration", [0.5, 3.0])  # Less and more than rows that are kept together.
def test_states_of_a_run_are_in_memory_once(duration):
    run = run_scenario(settings(scenario="nominal", duration=duration))
    spool = run.recording["knee_spool"]
    assert np.shares_memory(spool, run.history.states["knee_spool"])
    assert spool.base is None
    assert spool.shape == run.recording.time.shape
    assert not spool.flags.writeable


def test_where_the_joints_should_be_is_known_beyond_the_end():
    loop = Loop(settings(duration=0.01))
    for _ in range(loop.count + 2):
        point = loop.reference_now()
        np.testing.assert_array_equal(point.position, loop.step().reference.position)
    loop.close()


def test_a_time_step_that_never_ends_is_refused():
    for timestep in (1e-300, 5e-324, 1e-9):
        with pytest.raises(LeglabError, match="allowed: at least 2e-08 s, 100000 steps a control"):
            loop_timing(SensorConfiguration(), timestep)


@pytest.mark.parametrize("way", ["same arrays", "new arrays", "new dictionary", "more", "integers"])
def test_reports_are_recorded_however_a_controller_hands_them_out(way):
    loop = Loop(RunSettings(scenario="nominal", controller="pd", model="knee_bench", duration=0.2))
    number, told = np.zeros(1), {}

    def diagnostics():
        """The period's number and its square."""
        nonlocal told
        number[:] += 1.0
        if way == "new dictionary":
            told = {}
        late = number[0] > 50
        if way == "integers":
            told.update(one=np.array([int(number[0])]), two=int(number[0]) ** 2)
        elif not told or (way == "new arrays" and late):
            told.update(one=number.copy(), two=number**2)
        else:
            told["one"][:] = number
            told["two"][:] = number**2
        if way == "more" and late:
            told["three"] = number
        return told

    loop.controller.diagnostics = diagnostics
    kept = loop.run().diagnostics
    right = np.arange(1.0, len(kept["one"]) + 1)
    assert len(right) > 90
    np.testing.assert_array_equal(kept["one"][:, 0], right)
    np.testing.assert_array_equal(kept["two"][:, 0], right**2)
    if way == "more":
        np.testing.assert_array_equal(kept["three"][:, 0], np.where(right > 50, right, np.nan))
