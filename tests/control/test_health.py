"""Slow wear that is followed: the line of its sizes, made-up samples, and the closed loop."""

from dataclasses import replace

import numpy as np
import pytest

from leglab import RunSettings, run_scenario
from leglab.base.errors import LeglabError
from leglab.causes.fault_names import ALL, UNKNOWN
from leglab.control.feedforward import health
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve
from leglab.control.feedforward.health import HealthConfiguration, HealthMonitor
from leglab.control.feedforward.wear_line import line_of

JOINTS, PARAMETERS, PERIOD, BLOCK = ("hip", "knee"), 6, 0.004, 20
CONFIG = HealthConfiguration(look=300, wait=200)
LOOK = CONFIG.look * PERIOD  # s


def curve(rng, fault, element=ALL, sizes=(1.0, 4.0, 9.0)):
    """A curve that is bent between its sizes, as a fault's is."""
    one, two = 0.1 * rng.standard_normal((2, len(JOINTS), PARAMETERS))
    share = (np.array(sizes) - sizes[0]) / (sizes[-1] - sizes[0])
    shifts = share[:, None, None] * one + (share**2)[:, None, None] * two
    if element != ALL:
        shifts[:, 1 - JOINTS.index(element)] = 0.0
    return FaultCurve(
        fault=fault, element=element, meaning="ratio", sizes=np.array(sizes), shifts=shifts
    )


def make_bank(rng):
    names = [("leak", ALL), ("leak", "hip"), ("leak", "knee"), ("rub", ALL), ("rub", "knee")]
    oil = [
        curve(rng, "cold_oil", sizes=(40.0, 20.0, 0.0)),
        curve(rng, "hot_oil", sizes=(40.0, 60.0, 80.0)),
    ]
    return FaultBank(curves=(*(curve(rng, *name) for name in names), *oil))


def stream(monitor, true, *, start=0.0, end=60.0, seed=1):
    """Feeds samples of a map `true(time)` in blocks; the learner's parameters are always right."""
    rng = np.random.default_rng(seed)
    for number in range(round(start / PERIOD / BLOCK), round(end / PERIOD / BLOCK)):
        time = (number + 1) * BLOCK * PERIOD
        parameters = true(time)
        regressor = rng.standard_normal((BLOCK, len(JOINTS), PARAMETERS))
        output = np.einsum("njp,jp->nj", regressor, parameters)
        output += 1e-2 * rng.standard_normal(output.shape)
        error = output - np.einsum("njp,jp->nj", regressor, parameters)
        parts = (regressor, output[..., None], error[..., None], np.ones((*error.shape, 1)))
        monitor.take(time, np.concatenate(parts, axis=-1), parameters)


def monitor_of(bank, config=CONFIG):
    return HealthMonitor(bank, JOINTS, config, sample_period=PERIOD)


def wear(curve, onset, rate):
    return lambda time: curve.shift(curve.sizes[0] + rate * max(time - onset, 0.0))


@pytest.mark.parametrize("number", range(5))
def test_slow_wear_is_named_with_its_rate_and_what_remains(number):
    rng = np.random.default_rng(10 + number)
    bank = make_bank(rng)
    worn, base = bank.curves[number], rng.standard_normal((len(JOINTS), PARAMETERS))
    growth = wear(worn, 10.0, 0.1)  # at 9, its end of life, after 90 s
    monitor = monitor_of(bank)
    stream(monitor, lambda time: base + growth(time))
    (trend,) = monitor.trends
    assert (trend.fault, trend.element) == (worn.fault, worn.element)
    assert not trend.condition
    assert trend.since == pytest.approx(10.0, abs=3 * LOOK)
    assert trend.time < 25.0
    assert trend.low < 1 + 0.1 * (trend.seen - 10.0) < trend.high
    assert trend.rate == pytest.approx(360.0, rel=0.1)
    assert trend.rate_low < 360.0 < trend.rate_high
    assert trend.end_of_life == 9.0
    assert trend.remaining == pytest.approx(90.0 - trend.seen, rel=0.1)
    assert trend.remaining_low < 90.0 - trend.seen < trend.remaining_high
    hit = [worn.element in (ALL, joint) for joint in JOINTS]
    np.testing.assert_array_equal(monitor.report["health_fault"] > 0, hit)
    assert np.all(np.isnan(monitor.report["health_remaining"]) != hit)


def test_the_history_of_looks_has_an_end_and_the_trend_stays(monkeypatch):
    bank = make_bank(np.random.default_rng(0))
    base = np.random.default_rng(1).standard_normal((len(JOINTS), PARAMETERS))
    growth = wear(bank.curves[0], 10.0, 0.1)
    told = []
    for most in (health.MOST_LOOKS, 24):
        monkeypatch.setattr(health, "MOST_LOOKS", most)
        monitor = monitor_of(bank)
        stream(monitor, lambda time: base + growth(time))
        assert monitor._history.count <= most
        told.append(monitor.trends[-1])
    whole, thinned = told
    assert (thinned.fault, thinned.element) == (whole.fault, whole.element)
    assert thinned.size == pytest.approx(whole.size, rel=0.02)
    assert thinned.rate == pytest.approx(whole.rate, rel=0.1)
    assert thinned.remaining == pytest.approx(whole.remaining, rel=0.15)
    assert thinned.since == pytest.approx(whole.since, abs=6.0)


def test_nothing_is_said_of_a_machine_that_stays_as_it_is():
    rng = np.random.default_rng(20)
    bank, base = make_bank(rng), rng.standard_normal((len(JOINTS), PARAMETERS))
    monitor = monitor_of(bank)
    stream(monitor, lambda time: base, end=120.0)
    assert monitor.trends == []


@pytest.mark.parametrize(("first", "last"), [(0.0, 30.0), (10.0, 75.0), (70.0, 45.0)])
def test_oil_that_warms_or_cools_is_a_condition_wherever_it_begins(first, last):
    rng = np.random.default_rng(21)
    bank, base = make_bank(rng), rng.standard_normal((len(JOINTS), PARAMETERS))
    cold, hot = bank.curves[-2:]

    def true(time):
        value = first + (last - first) * np.clip((time - 5.0) / 40.0, 0.0, 1.0)
        return base + (cold if value < 40.0 else hot).shift(value)

    monitor = monitor_of(bank)
    stream(monitor, true)
    assert {(trend.fault, trend.condition) for trend in monitor.trends} == {
        ("oil_temperature", True)
    }
    # The value where it began is found to a node of the bank: 20 degrees.
    assert monitor.trends[-1].size == pytest.approx(last, abs=12.0)
    assert monitor.trends[-1].remaining is None
    assert not np.any(monitor.report["health_fault"])


def test_oil_that_warms_one_cylinder_more_than_another_is_a_condition():
    rng = np.random.default_rng(25)
    bank, base = make_bank(rng), rng.standard_normal((len(JOINTS), PARAMETERS))
    cold, hot = bank.curves[-2:]

    def true(time):
        shifts = []
        for joint, last in enumerate((25.0, 70.0)):
            value = 20.0 + (last - 20.0) * np.clip((time - 5.0) / 40.0, 0.0, 1.0)
            shifts.append((cold if value < 40.0 else hot).shift(value)[joint])
        return base + np.array(shifts)

    monitor = monitor_of(bank)
    stream(monitor, true)
    assert {(trend.fault, trend.condition) for trend in monitor.trends} == {
        ("oil_temperature", True)
    }
    assert monitor.trends[-1].explained > 0.9


def test_wear_is_told_with_what_the_samples_do_not_tell_apart_from_it():
    """The machine is not the nominal one: more samples do not make a near rival less probable."""
    rng = np.random.default_rng(26)
    bank = make_bank(rng)
    worn = bank.curves[0]
    bend = 0.01 * rng.standard_normal(worn.shifts.shape[1:])
    near = worn.shifts + (worn.sizes[:, None, None] - 1.0) / 8.0 * bend
    rub = replace(worn, fault="rub", shifts=near)
    base, own = rng.standard_normal((2, len(JOINTS), PARAMETERS))
    growth = wear(worn, 10.0, 0.1)
    monitor = monitor_of(FaultBank(curves=(worn, rub, *bank.curves[1:3], *bank.curves[-2:])))
    stream(monitor, lambda t: base + growth(t) + 0.001 * max(t - 10.0, 0.0) * own, end=30.0)
    (trend,) = monitor.trends
    (rival,) = trend.rivals
    assert (trend.fault, rival.fault) == ("leak", "rub")
    assert trend.confidence == pytest.approx(0.67, abs=0.05)
    assert rival.confidence == pytest.approx(1.0 - trend.confidence, abs=0.01)
    assert f"67 %, or rub {rival.size:.3g}, 33 %" in trend.told()


def test_wear_must_explain_what_a_map_can_say_of_it():
    """Three quarters of the error are the fault's, and a map that says all must explain more."""
    rng = np.random.default_rng(26)
    bank = make_bank(rng)
    base, own = rng.standard_normal((2, len(JOINTS), PARAMETERS))
    growth, told = wear(bank.curves[0], 10.0, 0.1), []
    for explains in (0.9, 1.0):
        curves = (replace(bank.curves[0], explains=explains), *bank.curves[1:])
        config = CONFIG.model_copy(update={"explained": 0.8})
        monitor = monitor_of(FaultBank(curves=curves), config)
        stream(monitor, lambda t: base + growth(t) + 0.001 * max(t - 10.0, 0.0) * own, end=30.0)
        told.append({trend.fault for trend in monitor.trends})
    assert told == [{"leak"}, {UNKNOWN}]


def test_a_drift_that_the_bank_does_not_have_is_unknown():
    rng = np.random.default_rng(22)
    bank, base = make_bank(rng), rng.standard_normal((len(JOINTS), PARAMETERS))
    odd = rng.standard_normal((len(JOINTS), PARAMETERS))
    odd[0] = 0.0
    monitor = monitor_of(bank)
    stream(monitor, lambda time: base + 0.01 * max(time - 10.0, 0.0) * odd)
    trend = monitor.trends[-1]
    assert (trend.fault, trend.element, trend.size) == (UNKNOWN, "knee", None)
    assert monitor.report["health_fault"].tolist() == [0.0, -1.0]


def test_wear_goes_on_from_where_it_was_after_another_change_at_once():
    rng = np.random.default_rng(23)
    bank, base = make_bank(rng), rng.standard_normal((len(JOINTS), PARAMETERS))
    worn = bank.curves[2]
    growth, step = wear(worn, 10.0, 0.05), bank.curves[3].shift(6.0)

    def true(time):
        return base + growth(time) + (time > 40.0) * step

    monitor = monitor_of(bank)
    stream(monitor, true, end=40.0)
    monitor.renew()
    stream(monitor, true, start=40.0, end=80.0)
    (trend,) = monitor.trends
    assert (trend.fault, trend.element) == ("leak", "knee")
    assert trend.size == pytest.approx(1 + 0.05 * 70.0, rel=0.1)
    assert trend.seen > 79.0


def test_ninety_percent_intervals_of_what_remains_hold_it_nine_times_in_ten():
    time, rate, level, onset = np.arange(40.0), 0.2, 20.0, 9.5
    held = widths = 0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        size = 1 + rate * np.maximum(time - onset, 0.0) + 0.3 * rng.standard_normal(40)
        line = line_of(time, size, 1.0)
        best, low, high = line.reaches(level, 0.0)
        right = onset + (level - 1) / rate - time[-1]
        held += low <= right <= (np.inf if high is None else high)
        widths += high is not None and high - low < 3 * best
    assert 0.86 <= held / 400 <= 0.94
    assert widths > 200


def test_a_line_that_goes_nowhere_has_no_end():
    time = np.arange(30.0)
    rng = np.random.default_rng(1)
    line = line_of(time, 3.0 + 0.1 * rng.standard_normal(30), 1.0)
    assert line.reaches(9.0, 0.0)[2] is None
    falling = line_of(time, 5.0 - 0.1 * time + 0.1 * rng.standard_normal(30), 1.0)
    assert falling.reaches(9.0, 0.0)[0] is None
    assert line_of(time[:3], time[:3], 1.0) is None


def test_an_end_of_life_that_no_wear_comes_to_is_refused():
    bank = make_bank(np.random.default_rng(24))
    for ends, message in (
        ({"rust": 3.0}, "'rust' is no fault that wears; choose leak, rub"),
        ({"hot_oil": 90.0}, "'hot_oil' is no fault that wears"),
        ({"leak": 0.5}, "leak 0.5 is not allowed; 1 is healthy, worn out is beyond it towards 9"),
    ):
        with pytest.raises(LeglabError, match=message):
            monitor_of(bank, CONFIG.model_copy(update={"end_of_life": ends}))


def test_slow_wear_in_the_closed_loop_is_named_before_the_error_doubles():
    result = run_scenario(
        RunSettings(
            scenario="seal_wear",
            controller="bsnn_arx_bank",
            model="knee_bench",
            duration=120.0,
            ramp_duration=60.0,
            severity=2.5,
            controller_config={"health": {"look": 750, "end_of_life": {"seal_wear": 5.5}}},
        )
    )
    assert result.metrics["events"] == []
    trend = result.metrics["health"][-1]
    assert (trend["fault"], trend["element"]) == ("seal_wear", ALL)
    time, error = result.history.time, result.history.error[:, 0]

    def rms(start, end):
        return np.sqrt(np.mean(error[(time >= start) & (time < end)] ** 2))

    assert rms(trend["time"] - 2.4, trend["time"]) < 2 * rms(50.0, 60.0)
    assert 60.0 < trend["time"] < 90.0
    assert trend["low"] < 1 + 1.5 * (trend["seen"] - 60.0) / 60.0 < trend["high"]
    remaining = 60.0 + 180.0 - trend["seen"]
    assert trend["remaining_low"] < remaining < trend["remaining_high"]
    line = result.record.health[0].told()
    assert line.startswith("all cylinders: seal_wear")
    assert "an hour; at 5.5 in" in line
    assert set(np.unique(result.recording["knee_health_fault"])) == {0.0, 1.0}
