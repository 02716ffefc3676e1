"""Controllers that learn: what they gain, what they must not lose, and what makes them stop."""

import numpy as np
import pytest

from leglab import Run, RunSettings, run_scenario
from leglab.base.errors import LeglabError
from leglab.control import (
    ControllerSetup,
    Measurement,
    NominalMachine,
    ReferencePoint,
    make_controller,
)
from leglab.control.feedforward.motion import ReferenceMotion, SmoothingWindow, smoothing_kernel
from leglab.controllers.bsnn_arx import AdaptiveController
from leglab.runs.loop import Loop
from leglab.runs.metrics import sliding_rms

ADAPTIVE = ("bsnn_arx", "frozen", "arx")


def run(controller: str, scenario: str = "seal_wear", **settings) -> Run:
    options = {"model": "knee_bench", "duration": 16.0, **settings}
    return run_scenario(RunSettings(scenario=scenario, controller=controller, **options))


def rms(result: Run, start: float, end: float) -> float:
    """RMS tracking error [rad] from start to end [s]."""
    time = result.history.time
    return float(np.sqrt(np.mean(result.history.error[(time >= start) & (time < end)] ** 2)))


@pytest.fixture(scope="module")
def worn() -> dict[str, Run]:
    return {name: run(name) for name in ("pd", "static_feedforward", "frozen", "bsnn_arx")}


def test_nominal_machine_is_tracked_far_better_than_by_pd_and_by_its_calibration(worn):
    error = {name: rms(result, 5, 8) for name, result in worn.items()}
    assert error["bsnn_arx"] < error["pd"] / 10
    assert error["bsnn_arx"] < error["static_feedforward"] / 2


def test_frozen_is_the_adaptive_controller_until_the_change(worn):
    time = worn["frozen"].history.time
    before = time < 8.0
    np.testing.assert_array_equal(
        worn["frozen"].history.command[before], worn["bsnn_arx"].history.command[before]
    )


def test_worn_seals_are_learned(worn):
    assert rms(worn["frozen"], 13, 16) > 2 * rms(worn["frozen"], 5, 8)
    assert rms(worn["bsnn_arx"], 13, 16) < rms(worn["frozen"], 13, 16) / 3


def test_what_is_added_to_the_command_is_not_learned_as_the_machine(monkeypatch):
    """As an agent's residual does; a controller that is not told takes it for the machine."""

    def error(told: bool) -> float:
        with monkeypatch.context() as patch:
            if not told:
                patch.delattr(AdaptiveController, "sent")
            loop = Loop(RunSettings(scenario="nominal", controller="bsnn_arx", model="knee_bench"))
            found = []
            for k in range(2000):
                period = loop.observe()
                loop.act(period.command + 0.03 * np.sin(0.02 * k))
                loop.advance()
                found.append(float(loop.diagnostics()["model_error"][0]))
            loop.close()
        return float(np.sqrt(np.mean(np.square(found[1000:]))))

    assert error(told=True) < 0.5 * error(told=False)


def test_gains_that_open_learn_a_change_sooner_than_gains_that_do_not(worn):
    closed = run("bsnn_arx", controller_config={"change_ratio": 1e9, "memory": 1e9})
    assert rms(worn["bsnn_arx"], 10, 12) < 0.7 * rms(closed, 10, 12)


def test_same_seed_same_bits(worn):
    again = run("bsnn_arx")
    np.testing.assert_array_equal(again.history.command, worn["bsnn_arx"].history.command)


def test_window_gives_exact_derivatives_of_a_polynomial():
    timestep, window = 0.002, 21
    times = np.arange(40) * timestep
    coefficients = np.array([0.3, -1.2, 4.0, 30.0, -200.0])
    position = np.polynomial.polynomial.polyval(times, coefficients)
    smooth = SmoothingWindow(2, window, timestep)
    for value in position:
        assert smooth.full == (smooth._filled >= window)
        smooth.push(np.array([value]), np.array([2 * value]))
    found = smooth.middle()
    middle = times[-1 - window // 2]
    for order in range(4):
        exact = np.polynomial.Polynomial(coefficients).deriv(order)(middle)
        assert found[order, 0] == pytest.approx(exact, rel=1e-7)
    assert found[0, 1] == pytest.approx(2 * position[-1 - window // 2], rel=1e-12)


def test_smoothing_kernel_is_that_of_savitzky_and_golay():
    signal = pytest.importorskip("scipy.signal")
    kernel = smoothing_kernel(15, 0.01)
    for order in range(4):
        expected = signal.savgol_coeffs(15, 4, deriv=order, delta=0.01, use="dot")
        np.testing.assert_allclose(kernel[order], expected, rtol=1e-8, atol=1e-6)


def test_reference_is_moved_in_time_both_ways():
    timestep, lead, late = 0.001, 0.003, 0.002
    motion = ReferenceMotion(1, timestep, lead=lead, position_delay=late, velocity_delay=2 * late)

    def point(t: float) -> ReferencePoint:
        s, c = np.sin([3 * t]), np.cos([3 * t])
        return ReferencePoint(s, 3 * c, -9 * s)

    for k in range(100):
        later, seen = motion.take(point(k * timestep))
    now = 99 * timestep
    wanted = point(now + lead)
    np.testing.assert_allclose(later[:3], wanted, atol=1e-3)
    np.testing.assert_allclose(later[:2], wanted[:2], atol=1e-6)
    np.testing.assert_allclose(seen.position, point(now - late).position, atol=1e-6)
    np.testing.assert_allclose(seen.velocity, point(now - 2 * late).velocity, atol=1e-5)


class FakeMap:
    """Calibration v/5 of one joint, as `ValveMap`s have it."""

    position = np.linspace(-1.0, 1.0, 9)
    velocity = np.linspace(-5.0, 5.0, 11)
    command = np.tile(velocity / 10.0, (9, 1))


def controller(config=None) -> AdaptiveController:
    setup = ControllerSetup(
        joints=("joint_0", "joint_1"),
        control_period=0.002,
        machine=NominalMachine(
            direction=np.ones(2),
            position_gain=[1.0, 1.0],
            velocity_gain=[0.0, 0.0],
            valve_maps=[FakeMap, FakeMap],
            latency=0.001,
            velocity_delay=0.003,
        ),
    )
    return make_controller("bsnn_arx", setup, config)


def followed(k: int) -> tuple[Measurement, ReferencePoint]:
    """Measurement and reference of a period of a machine that follows exactly."""
    t = 0.002 * k
    phase = 3.0 * t + np.arange(2)
    point = ReferencePoint(0.5 * np.sin(phase), 1.5 * np.cos(phase), -4.5 * np.sin(phase))
    return Measurement(t, 0.5 * np.sin(phase - 0.003), point.velocity), point


def drive(made: AdaptiveController, periods: int, corrupt=lambda k, position: position):
    """Commands of a controller whose machine follows the reference exactly."""
    commands = []
    for k in range(periods):
        measurement, point = followed(k)
        measurement = measurement._replace(position=corrupt(k, measurement.position))
        if k == 0:
            made.reset(measurement)
        commands.append(made.command(measurement, point))
    return np.array(commands)


def learned(made: AdaptiveController, joint: int = 0) -> float:
    return made.adaptation.learner.diagnostics(joint)["learned"]


def test_feedforward_starts_as_the_calibration():
    made = controller()
    drive(made, 2)
    np.testing.assert_allclose(made.diagnostics()["feedforward"], 0.15 * np.cos([0, 1]), atol=0.01)


def test_a_failed_sensor_neither_teaches_nor_reaches_the_valve():
    made = controller()
    drive(made, 400)
    before = learned(made), made.adaptation.learner.parameters
    assert before[0] > 50

    def nan_from_start(k, position):
        return position if k < 30 else np.full_like(position, np.nan)

    made = controller()
    commands = drive(made, 400, corrupt=nan_from_start)
    assert np.isfinite(commands).all()
    assert learned(made) < 10
    assert np.isfinite(made.adaptation.learner.parameters).all()


def test_kept_samples_are_those_that_were_learned():
    made = controller()
    made.adaptation.reset()
    made.adaptation.keep(3)
    before, rows = made.adaptation.learner.parameters, []
    for k in range(400):
        measurement, point = followed(k)
        made.command(measurement, point)
        if made.adaptation.kept_count():
            (row,) = made.adaptation.kept()
            regressor, output, error = row[:, :-3], row[:, -3], row[:, -2]
            expected = output - np.einsum("jp,jp->j", regressor, before)
            np.testing.assert_allclose(error, expected, atol=1e-12)
            rows.append(row)
        before = made.adaptation.learner.parameters
    used = np.array(rows)[..., -1].sum(axis=0)
    # The first one only fills the history of the learner.
    assert used.tolist() == [1 + learned(made, 0), 1 + learned(made, 1)]
    # No more than asked for are kept, the first ones; none after a reset.
    for _ in range(20):
        made.command(measurement, point)
    assert made.adaptation.kept_count() == 3
    made.adaptation.reset()
    drive(made, 100)
    assert made.adaptation.kept_count() == 0


def test_standing_still_teaches_nothing():
    made = controller()
    rest = np.zeros(2)
    for k in range(300):
        measurement = Measurement(0.002 * k, rest, rest)
        if k == 0:
            made.reset(measurement)
        made.command(measurement, ReferencePoint(rest, rest, rest))
    assert learned(made) == 0


def test_saturated_commands_teach_nothing():
    made = controller({"position_gain": [1000.0, 1.0]})
    drive(made, 400, corrupt=lambda k, position: position + np.array([0.1, 0.0]))
    assert learned(made, 0) == 0
    assert learned(made, 1) > 50


def test_feedforward_is_limited_in_size_and_rate():
    made = controller({"limit": 0.1, "rate_limit": 0.2})
    made.reset(Measurement(0.0, np.zeros(2), np.zeros(2)))
    last = None
    for k in range(500):
        t = 0.002 * k
        point = ReferencePoint(*(np.full(2, x) for x in (0.0, 3 * np.sin(20 * t), 0.0)))
        made.command(Measurement(t, np.zeros(2), np.zeros(2)), point)
        now = made.diagnostics()["feedforward"]
        assert np.abs(now).max() <= 0.1 + 1e-12
        if last is not None and k > 1:
            assert np.abs(now - last).max() <= 0.2 * 0.002 + 1e-12
        last = now.copy()


def test_supervisor_returns_to_the_calibration_where_it_tracks_better():
    made = controller({"position_gain": [4.0, 4.0]})
    position, errors = np.array([0.0, 0.5 * np.sin(1.0)]), []
    for k in range(3000):
        measurement, point = followed(k)
        measurement = measurement._replace(position=position)
        if k == 0:
            made.reset(measurement)
        if k == 1000:
            spoilt = made.adaptation.learner.parameters
            spoilt[0] += 0.5  # joint 0 has learned nonsense
            made.adaptation.learner.parameters = spoilt
            made.adaptation.learner.freeze()
            assert not made.diagnostics()["fallback"].any()
        # The machine is as calibrated, v = 10 u, but for one that runs five percent faster.
        position = position + 0.002 * 10.5 * made.command(measurement, point)
        errors.append(position - point.position)
    assert made.diagnostics()["fallback"].tolist() == [1.0, 0.0]
    assert made.diagnostics()["feedforward"][0] == pytest.approx(0.1 * point.velocity[0], abs=0.02)
    spoilt_error, end = np.abs(errors[1000:1200]).max(axis=0), np.abs(errors[2500:]).max(axis=0)
    assert end[0] < spoilt_error[0] / 3


@pytest.mark.parametrize("settle_time", [0.4, 0.0])
def test_what_was_learned_lately_and_does_not_hold_is_not_used(settle_time):
    # The machine follows exactly: any flow beyond its motion is wrong.
    made = controller({"settle_time": settle_time, "supervised": False})
    adaptation, asked = made.adaptation, []
    for k in range(1100):
        measurement, point = followed(k)
        if k == 1000:
            before = made.diagnostics()["feedforward"].copy()
            spoilt = adaptation.learner.parameters
            spoilt[0] += 0.1
            adaptation.learner.parameters = spoilt
            adaptation.learner.set_gain(1e-12 * np.eye(spoilt.shape[1]), 0)
            adaptation.learner.hold_alarm(0)
        made.command(measurement, point)
        # The machine of the calibration: what is sent is what moves it.
        adaptation.sent(0.1 * point.velocity)
        asked.append(made.diagnostics()["feedforward"] - 0.1 * point.velocity)
    off = np.abs(np.array(asked)[:, 0])
    assert off[900:1000].max() < 0.002 < before.max()
    assert off[1010] > 0.02
    if settle_time:
        assert off[1080] < 0.5 * off[1010]
    else:
        assert off[1080] > 0.9 * off[1010]


def test_a_soft_machine_is_not_shaken_by_what_is_learned():
    settings = {"model": "leg", "severity": 0.15, "tolerance": 0.1, "seed": 1000, "vary": True}
    static, learning = (
        run(name, "air_in_oil", **settings).history for name in ("static_feedforward", "bsnn_arx")
    )
    worst, calibrated = (sliding_rms(h.time, h.error, 2.0) for h in (learning, static))
    assert (worst / calibrated)[learning.time >= 7.0].max() < 1.1


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"window": 20}, "odd"),
        ({"initial_gain": -1.0}, "greater than 0"),
        ({"limit": 2.0}, "less than or equal to 1"),
        ({"learning_gain": 1.0}, "learning_gain"),
    ],
)
def test_impossible_settings_are_refused(config, message):
    with pytest.raises(LeglabError, match=message):
        controller(config)
