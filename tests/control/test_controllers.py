"""Every controller by name; the laws that can be checked in closed form."""

import tomllib
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

import leglab.controllers
import leglab.models
from leglab import RunSettings, run_scenario
from leglab.commissioning.calibration import ValveMap
from leglab.commissioning.gains_file import stored_name
from leglab.commissioning.pd_gains import (
    PD,
    SPEEDS,
    joint_plant,
    sampled_plant,
    stored_gains,
    tune,
)
from leglab.control import (
    ControllerSetup,
    Measurement,
    NominalMachine,
    ReferencePoint,
    controller_names,
    make_controller,
)
from leglab.controllers.static_feedforward import ValveMapTable
from leglab.machine.sensors import SensorConfiguration, velocity_filter_coefficient
from leglab.machine.simulation import Simulation, load_model
from leglab.runs.preparation import Preparation


@pytest.mark.parametrize("name", controller_names())
def test_every_controller_runs_and_stays_within_range(name):
    run = run_scenario(
        RunSettings(scenario="nominal", controller=name, model="knee_bench", duration=2.0)
    )
    assert run.metrics["completed"]
    assert np.abs(run.history.error).max() < 0.6
    assert np.abs(run.history.command).max() <= 1.0


def test_pd_law():
    setup = ControllerSetup(
        joints=("a", "b"), control_period=0.002, machine=NominalMachine(direction=[1.0, -1.0])
    )
    pd = make_controller("pd", setup, {"position_gain": [2.0, 3.0], "velocity_gain": [0.1, 0.2]})
    measurement = Measurement(0.0, np.array([0.1, 0.2]), np.array([1.0, 2.0]))
    point = ReferencePoint(np.array([0.3, 0.5]), np.array([1.5, 2.5]), np.zeros(2))
    pd.reset(measurement)
    np.testing.assert_allclose(
        pd.command(measurement, point), [2 * 0.2 + 0.1 * 0.5, -(3 * 0.3 + 0.2 * 0.5)]
    )


def test_pid_does_not_wind_up_while_the_command_saturates():
    setup = ControllerSetup(
        joints=("a",), control_period=0.01, machine=NominalMachine(direction=[1.0])
    )
    gains = {"position_gain": [10.0], "velocity_gain": [0.0]}
    pid = make_controller("pid", setup, {**gains, "integral_time": 0.5, "limit": 0.4})
    rest = np.zeros(1)
    measurement = Measurement(0.0, rest, rest)

    def integral_after(error, periods=1):
        for _ in range(periods):
            pid.command(measurement, ReferencePoint(np.array([error]), rest, rest))
        return float(pid.diagnostics()["integral"][0])

    pid.reset(measurement)
    assert integral_after(1.0, 500) == 0.0  # a command of 10
    assert integral_after(0.05) == pytest.approx(0.01 / 0.5 * 10 * 0.05)
    assert integral_after(0.05, 100) == pytest.approx(0.4)  # its limit
    assert integral_after(-0.05) == pytest.approx(0.4 - 0.01)


def test_valve_map_table_is_bilinear():
    random = np.random.default_rng(0)
    fractions = np.array([-1.0, -0.3, -0.1, 0.0, 0.1, 0.3, 1.0])
    maps = [
        ValveMap(
            position=np.linspace(low, low + 1, 5),
            velocity=speed * fractions,
            command=random.normal(size=(5, 7)),
        )
        for low, speed in ((0.0, 3.0), (-1.0, 8.0))
    ]
    table = ValveMapTable(maps)
    for _ in range(200):
        q = np.array([random.uniform(0, 1), random.uniform(-1, 0)])
        v = np.array([random.uniform(-3, 3), random.uniform(-8, 8)])
        expected = [
            RegularGridInterpolator((m.position, m.velocity), m.command)([[a, b]])[0]
            for m, a, b in zip(maps, q, v, strict=True)
        ]
        np.testing.assert_allclose(table(q, v), expected, rtol=1e-12, atol=1e-14)
    edge = table(np.array([9.0, -9.0]), np.array([9.0, -9.0]))
    np.testing.assert_allclose(edge, [maps[0].command[-1, -1], maps[1].command[0, 0]])


def stability(simulation: Simulation, joint: int, kp: float, kv: float) -> tuple[float, float]:
    """Smallest margins [dB], [deg] in the present pose, by python-control's own routine."""
    sensors = SensorConfiguration()
    period = sensors.control_period
    alpha = velocity_filter_coefficient(period, sensors.velocity_cutoff)
    law = kp + kv * alpha / period * control.tf([1, -1], [1, -(1 - alpha)], period)
    worst = [np.inf, np.inf]
    for speed in SPEEDS:
        plant = sampled_plant(joint_plant(simulation, joint, speed), period, sensors.latency)
        sign = float(np.sign(simulation.levers()[joint]))
        loop = control.ss(law) * (sign * plant)
        gains, phases, *_ = control.stability_margins(loop, returnall=True)
        up = [20 * np.log10(g) for g in gains if g > 1]
        worst = [min([worst[0], *up]), min([worst[1], *np.abs(phases)])]
        assert not [g for g in gains if 0.01 < g < 1], "unstable already"
    return worst[0], worst[1]


@pytest.mark.parametrize("model", ["knee_bench", "leg"])
def test_stored_gains_keep_their_margins(model):
    sensors = SensorConfiguration()
    simulation = Simulation(load_model(model))
    gains = stored_gains(model, simulation, sensors)
    assert gains is not None
    for joint, (kp, kv) in enumerate(gains):
        decibel, degree = stability(simulation, joint, kp, kv)
        assert decibel >= 5.99, simulation.joints[joint]
        assert degree >= 44.9, simulation.joints[joint]


def test_gains_of_a_model_without_stored_ones_are_tuned_at_the_timestep_of_the_run(tmp_path):
    text = (Path(leglab.models.__path__[0]) / "knee_bench.xml").read_text()
    model = tmp_path / "coarse.xml"  # which MuJoCo does not load at its own timestep
    model.write_text(text.replace('timestep="0.0005"', 'timestep="0.004"'))
    settings = RunSettings(scenario="nominal", model=str(model), timestep=5e-4)
    machine = Preparation(settings).controller_setup.machine
    stored = stored_gains("knee_bench", Simulation(load_model("knee_bench")), SensorConfiguration())
    assert list(zip(machine.position_gain, machine.velocity_gain, strict=True)) == stored


def test_tuning_one_model_keeps_the_stored_gains_of_the_others(tmp_path):
    file = tmp_path / "gains.toml"
    file.write_text(PD.path.read_text())
    before = tomllib.loads(file.read_text())
    replace(PD, path=file).store({"own/arm.xml": {**before["knee_bench"]}})
    after = tomllib.loads(file.read_text())
    assert after == {**before, "own/arm.xml": before["knee_bench"]}


def test_stored_gains_are_those_of_the_model_not_of_its_path(tmp_path):
    model, file = tmp_path / "bench.xml", tmp_path / "gains.toml"
    model.write_text((Path(leglab.models.__path__[0]) / "knee_bench.xml").read_text())
    simulation, sensors = Simulation(load_model(model)), SensorConfiguration()
    file.write_text("")
    gains = replace(PD, path=file)
    rows = PD.rows("knee_bench", simulation, sensors)
    table = tomllib.loads(PD.path.read_text())["knee_bench"]
    gains.store({stored_name(str(model)): table})
    assert gains.rows(str(model), simulation, sensors) == rows
    copy = tmp_path / "elsewhere" / "bench.xml"
    copy.parent.mkdir()
    copy.write_text(model.read_text())
    assert gains.rows(str(copy), simulation, sensors) == rows
    model.write_text(model.read_text() + "<!-- edited -->")
    assert gains.rows(str(model), simulation, sensors) is None


def test_stored_gains_are_what_tuning_gives_and_more_would_break_a_margin():
    sensors = SensorConfiguration()
    simulation = Simulation(load_model("knee_bench"))
    gains = tune(simulation, 0, sensors=sensors)
    simulation.reset()
    stored = gains["position"], gains["velocity"]
    assert stored_gains("knee_bench", simulation, sensors) == [stored]
    assert min(gains["gain_margin_db"] - 6.0, gains["phase_margin_deg"] - 45.0) < 0.2
