"""The model-based controller: its equations, its estimates, its bounds, and what it is worth."""

import math

import mujoco
import numpy as np
import pytest

from leglab import Run, RunSettings, run_scenario
from leglab.base.errors import LeglabError
from leglab.commissioning.backstepping_gains import (
    BACKSTEPPING,
    SENSITIVITY,
    BacksteppingGains,
    JointLoop,
)
from leglab.commissioning.nominal import NominalDynamics, nominal_cylinders
from leglab.commissioning.setup import controller_setup
from leglab.control import Measurement, ReferencePoint, make_controller
from leglab.control.backstepping.cylinder import Bristles, CylinderModel
from leglab.control.backstepping.error_observer import ErrorObserver
from leglab.control.backstepping.least_squares import BoundedLeastSquares
from leglab.machine.cylinder import Cylinder
from leglab.machine.sensors import SensorConfiguration
from leglab.machine.simulation import Simulation, load_model

NAME = "adaptive_backstepping"


def run(controller: str = NAME, scenario: str = "seal_wear", **settings) -> Run:
    options = {"model": "knee_bench", "duration": 12.0, **settings}
    return run_scenario(RunSettings(scenario=scenario, controller=controller, **options))


def rms(result: Run, start: float, end: float) -> float:
    """RMS tracking error [rad] from start to end [s]."""
    time = result.history.time
    return float(np.sqrt(np.mean(result.history.error[(time >= start) & (time < end)] ** 2)))


def mean(result: Run, name: str, start: float, end: float) -> np.ndarray:
    time = result.history.time
    return result.history.diagnostics[name][(time >= start) & (time < end)].mean(axis=0)


@pytest.fixture(scope="module")
def leg() -> Simulation:
    return Simulation(load_model("leg"))


@pytest.fixture(scope="module")
def worn() -> Run:
    return run()


def test_spool_of_a_flow_is_what_the_plugin_needs_for_it(leg):
    data = nominal_cylinders(leg)
    model = CylinderModel(data)
    speed = np.array([0.1, -0.05, 0.2, -0.3, 0.01, -0.002])
    steady = []
    for actuator, v in zip(leg.actuators, speed, strict=True):
        sheet = {**leg.cylinder_parameters(actuator), "coulomb": 0.0, "static": 0.0, "viscous": 0.0}
        steady.append(Cylinder(sheet).steady_state(float(v), 300.0))
    pressure = np.array([[s.pressure_a for s in steady], [s.pressure_b for s in steady]])
    piston = model.geometry(leg.position())[1]
    chambers = model.chambers(pressure, 16e6, piston)
    leakage = np.stack([data.internal_leakage, 0 * speed, 0 * speed])
    rate = model.rate_for(speed, pressure, leakage, chambers)
    spool = model.spool_for(rate, chambers, data.lap)
    np.testing.assert_allclose(spool, [s.spool for s in steady], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(model.rate_of(spool, chambers, data.lap), rate, rtol=1e-5)


def test_geometry_is_that_of_the_model(leg):
    data = nominal_cylinders(leg)
    model = CylinderModel(data)
    simulation = Simulation(load_model("leg"))
    low, high = simulation.joint_range().T
    position = low + 0.37 * (high - low)
    simulation.data.qpos[simulation.qpos_index] = position
    mujoco.mj_forward(simulation.model, simulation.data)
    lever, _ = model.geometry(position)
    np.testing.assert_allclose(lever, simulation.levers(), rtol=2e-3)


def test_inverse_dynamics_accelerate_the_machine_as_asked(leg):
    dynamics = NominalDynamics(leg)
    rng = np.random.default_rng(0)
    q = leg.position() + 0.05 * rng.normal(size=6)
    v, a = rng.normal(size=6), 5 * rng.normal(size=6)
    torque = dynamics(q, v, a)
    simulation = Simulation(load_model("leg"))
    data = simulation.data
    data.qpos[simulation.qpos_index], data.qvel[simulation.dof_index] = q, v
    # No oil pressure and no seals: what is left are the applied torques.
    simulation.set_pressures(np.zeros(6), np.zeros(6))
    for actuator in simulation.actuators:
        for name in ("viscous", "coulomb", "static", "sigma_0", "sigma_1"):
            simulation.set_parameter(actuator, name, 0.0)
    data.qfrc_applied[simulation.dof_index] = torque
    mujoco.mj_forward(simulation.model, data)
    np.testing.assert_allclose(data.qacc[simulation.dof_index], a, rtol=1e-6, atol=1e-6)


def test_observer_finds_unknown_force_and_flow():
    frequency, period, delay = np.array([200.0]), 2e-3, 1.9e-3
    observer = ErrorObserver(
        frequency=frequency,
        damping=np.array([5.0]),
        period=period,
        delay=delay,
        noise=np.array([[1e-6], [1e-6]]),
        drift=np.array([[1e-5], [1e-2]]),
    )
    phi, eta, fine = 3e-5, 4e-3, 100
    e = de = p = 0.0
    observer.start(np.zeros(1), np.zeros(1))
    for _ in range(1000):  # the error dynamics themselves, with a force and a flow lost
        observer.predict(np.array([e]), np.array([p]))
        v = 10.0 * e + 0.2 * de - 50.0 * (p - phi) + eta
        observer.sent(np.array([v]))
        for _ in range(fine):
            h = period / fine
            de += h * (-(200.0**2) * (p - phi) - 5.0 * de)
            p += h * (v + de - eta)
            e += h * de
    assert observer.state[0, 3] == pytest.approx(phi, rel=0.02)
    assert observer.state[0, 4] == pytest.approx(eta, rel=0.02)


def test_bristles_build_up_and_slide():
    data = nominal_cylinders(Simulation(load_model("knee_bench")))
    bristles = Bristles(data)
    for _ in range(200):
        force = bristles.advance(np.array([0.5]), 1e-3)
    assert force[0] == pytest.approx(1.0, abs=1e-3)
    # 10 um back: still on the way from +1, about sigma_0 x/F_c times two nearer to -1.
    after = bristles.advance(np.array([-0.01]), 1e-3)
    level = 1 + 0.5 * math.exp(-((0.01 / 0.014) ** 2))
    expected = -level + (1 + level) * math.exp(-2e6 * 1e-5 / 100 / level)
    assert after[0] == pytest.approx(expected, rel=1e-3)


def estimator(**settings) -> BoundedLeastSquares:
    options = {
        "start": np.zeros((2, 1)),
        "scale": np.ones((2, 1)),
        "lower": np.full((2, 1), -3.0),
        "upper": np.full((2, 1), 3.0),
        "forgetting_factor": 0.98,
        "noise": np.array([0.01]),
        "dead_zone": 0.5,
        **settings,
    }
    return BoundedLeastSquares(**options)


def feed(estimator: BoundedLeastSquares, true: np.ndarray, count: int = 400) -> np.ndarray:
    rng = np.random.default_rng(0)
    for _ in range(count):
        row = rng.normal(size=(2, 1))
        residual = row[:, 0] @ (true - estimator.values[:, 0])
        estimator.update(row, np.array([residual]), np.array([True]))
    return estimator.values[:, 0]


def test_least_squares_find_parameters_and_keep_their_bounds():
    np.testing.assert_allclose(feed(estimator(), np.array([1.5, -2.0])), [1.5, -2.0], atol=0.02)
    beyond = feed(estimator(), np.array([5.0, -2.0]))
    assert beyond[0] == 3.0


def test_least_squares_learn_nothing_within_the_dead_zone_and_from_nan():
    small = estimator(dead_zone=1.0)
    row = np.ones((2, 1))
    small.update(row, np.array([0.009]), np.array([True]))
    small.update(row, np.array([np.nan]), np.array([True]))
    small.update(row, np.array([1.0]), np.array([False]))
    np.testing.assert_array_equal(small.values, np.zeros((2, 1)))


@pytest.mark.parametrize(("model", "joint"), [("knee_bench", 0), ("leg", 0), ("leg", 3)])
def test_stored_gains_keep_their_margins(model, joint):
    simulation, sensors = Simulation(load_model(model)), SensorConfiguration()
    gains = BACKSTEPPING.gains(model, simulation, sensors)
    one = BacksteppingGains(
        **{
            name: getattr(gains, name)[joint : joint + 1]
            for name in ("position_gain", "force_damping", "force_drift", "flow_drift")
        }
    )
    response, peak = JointLoop(simulation, joint, sensors).judge(one)
    assert math.isfinite(response)
    assert peak <= 1.01 * SENSITIVITY


def test_nominal_machine_is_tracked_far_better_than_by_pd_and_by_its_calibration(worn):
    error = {
        name: rms(run(name, duration=8.0, scenario="nominal"), 2, 8)
        for name in ("pd", "static_feedforward")
    }
    assert rms(worn, 2, 6) < error["pd"] / 50
    assert rms(worn, 2, 6) < error["static_feedforward"] / 5


def test_leakage_is_found_after_seal_wear(worn):
    nominal = 1.7e-13
    assert mean(worn, "internal_leakage", 4, 6)[0] == pytest.approx(nominal, rel=0.5)
    assert mean(worn, "internal_leakage", 9, 12)[0] == pytest.approx(10 * nominal, rel=0.1)
    assert mean(worn, "lap", 9, 12)[0] == pytest.approx(0.02, abs=0.005)


@pytest.mark.slow("more runs")
def test_adaptation_pays_after_seal_wear(worn):
    assert rms(worn, 9, 12) < 0.6 * rms(run(controller_config={"adapt": False}), 9, 12)


def test_same_seed_same_bits():
    first, second = (run(duration=2.0).history.command for _ in range(2))
    np.testing.assert_array_equal(first, second)


_more = pytest.mark.slow("more faults")


@pytest.mark.parametrize(
    "scenario",
    [
        "sensor_dropout",
        "valve_wear",
        pytest.param("encoder_shift", marks=_more),
        pytest.param("slow_valve", marks=_more),
    ],
)
def test_no_blow_up_and_parameters_within_bounds(scenario):
    result = run(scenario=scenario, duration=8.0)
    assert result.metrics["completed"]
    assert np.abs(result.history.error[:1900]).max() < 0.01
    assert np.abs(result.history.error).max() < 0.6
    reported = result.history.diagnostics
    assert all(np.isfinite(values).all() for values in reported.values())
    assert (np.abs(reported["null"]) <= 0.1).all()
    assert (reported["lap"] >= 0).all()
    assert (reported["lap"] <= 0.15).all()
    for name in ("internal_leakage", "external_leakage_a", "external_leakage_b", "coulomb"):
        assert (reported[name] >= 0).all()


def knee():
    simulation = Simulation(load_model("knee_bench"))
    return controller_setup(simulation, "knee_bench", SensorConfiguration())


def test_lost_sensors_do_not_reach_the_valve():
    controller = make_controller(NAME, knee())
    one = np.ones(1)
    good = Measurement(0.0, 0.9 * one, 0 * one, 6e6 * one, 9.8e6 * one, 16e6)
    bad = Measurement(0.002, np.nan * one, np.nan * one, np.nan * one, np.inf * one, math.nan)
    point = ReferencePoint(0.9 * one, 0 * one, 0 * one)
    controller.reset(good)
    for measurement in (good, bad, bad, good):
        command = controller.command(measurement, point)
        assert np.isfinite(command).all()
        assert np.abs(command).max() <= 1.0


def test_what_is_missing_is_named():
    controller = make_controller(NAME, knee())
    one = np.ones(1)
    with pytest.raises(LeglabError, match="needs measured pressures"):
        controller.reset(Measurement(0.0, one, one))
    with pytest.raises(LeglabError, match="'position_gain' has 2 values"):
        make_controller(NAME, knee(), {"position_gain": (1.0, 2.0)})
    with pytest.raises(LeglabError, match="dead_zone"):
        make_controller(NAME, knee(), {"dead_zone": -1.0})
    with pytest.raises(LeglabError, match="setting of controller 'adaptive_backstepping'"):
        make_controller(NAME, knee(), {"deadzone": 1.0})
