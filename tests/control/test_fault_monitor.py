"""Changes that are noticed and named: on made-up samples, and in the closed loop."""

from dataclasses import replace

import numpy as np
import pytest

from leglab import RunSettings, run_scenario
from leglab.base.errors import LeglabError
from leglab.base.scenario import get_scenario
from leglab.causes.fault_names import ALL, UNKNOWN
from leglab.control import Measurement, ReferencePoint, make_controller
from leglab.control.feedforward.fault_bank import FaultBank
from leglab.control.feedforward.fault_monitor import FaultMonitor
from leglab.runs.loop import Loop
from leglab.runs.preparation import prepared
from tests.helpers.learned_samples import (
    BLOCK,
    CHANGE,
    CONFIG,
    JOINTS,
    PARAMETERS,
    PERIOD,
    curve,
    make_bank,
    monitor_of,
    planted,
    stream,
)


@pytest.mark.parametrize("number", range(5))
def test_planted_fault_is_named_and_its_map_proposed(number):
    rng = np.random.default_rng(10 + number)
    bank = make_bank(rng)
    right = bank.curves[number]
    shift = right.shift(6.0)
    base, true = planted(shift, rng)
    monitor = monitor_of(bank)
    parameters, _ = stream(monitor, true)
    (event,) = monitor.events
    name = event.names[-1]
    assert (name.fault, name.element) == (right.fault, right.element)
    assert name.low < 6.0 < name.high
    assert name.size == pytest.approx(6.0, rel=0.05)
    assert name.onset == pytest.approx(CHANGE, abs=BLOCK * PERIOD)
    assert CHANGE < name.time < CHANGE + 0.3
    assert name.confidence > 0.9
    assert name.explained > 0.9
    assert event.withdrawn is None
    np.testing.assert_allclose(parameters, base + shift, atol=0.01)
    hit = np.any(shift != 0.0, axis=1)
    number_of = 1 + bank.faults.index(right.fault)
    np.testing.assert_array_equal(monitor.report["fault"], number_of * hit)


def test_what_the_bank_does_not_have_is_an_unknown_change_without_a_likely_map():
    rng = np.random.default_rng(20)
    bank = make_bank(rng)
    shift = 0.1 * rng.standard_normal((len(JOINTS), PARAMETERS))
    shift[0] = 0.0
    _, true = planted(shift, rng)
    monitor = monitor_of(bank)
    _, given = stream(monitor, true)
    assert monitor.events[0].names[0].fault == UNKNOWN
    assert monitor.events[0].names[0].element == "knee"
    assert monitor.report["fault"].tolist() == [0.0, -1.0]
    assert all(proposal.odds <= 1.0 for _, made in given for proposal in made)


@pytest.mark.parametrize("pace", [1.0, 2.0])
def test_a_motion_half_as_fast_is_judged_in_twice_the_time(pace):
    """What nothing explains is told after a stride: at the look after 1.3 s of 1.2."""
    rng = np.random.default_rng(20)
    bank = make_bank(rng)
    odd = 0.1 * rng.standard_normal((len(JOINTS), PARAMETERS))
    _, true = planted(odd, rng)
    monitor = FaultMonitor(bank, JOINTS, CONFIG, sample_period=PERIOD, pace=pace)
    stream(monitor, true)
    (event,) = monitor.events
    assert event.names[0].fault == UNKNOWN
    assert event.names[0].time - CHANGE == pytest.approx(1.4 * pace, abs=0.05)


@pytest.mark.parametrize(("period", "pace"), [(1.2, 1.0), (3.0, 2.5), (None, 1.0), (np.inf, 1.0)])
def test_the_pace_is_that_of_the_reference(period, pace):
    setup = replace(
        prepared(RunSettings(scenario="", model="knee_bench")).controller_setup,
        reference_period=period,
        fault_bank=lambda: FaultBank(
            curves=tuple(replace(c, shifts=c.shifts[:, :1]) for c in make_bank(np.random).curves)
        ),
    )
    controller = make_controller("bsnn_arx_bank", setup)
    monitor, health = controller.monitor, controller.health
    assert monitor._warm_up == 1900 * pace
    assert monitor._slow_window == 600 * pace
    assert monitor._looks[-1] == pytest.approx(3.2 * pace)
    assert health._samples == 1500 * pace


def test_a_passing_disturbance_is_no_change():
    rng = np.random.default_rng(21)
    bank = make_bank(rng)
    base = rng.standard_normal((len(JOINTS), PARAMETERS))
    odd = 0.1 * rng.standard_normal((len(JOINTS), PARAMETERS))
    monitor = monitor_of(bank)
    stream(monitor, lambda time: base + (CHANGE < time < CHANGE + 0.1) * odd)
    assert monitor.events == []


def test_nothing_is_said_while_nothing_changes():
    rng = np.random.default_rng(22)
    bank = make_bank(rng)
    base = rng.standard_normal((len(JOINTS), PARAMETERS))
    monitor = monitor_of(bank)
    _, given = stream(monitor, lambda time: base, end=60.0)
    assert monitor.events == []
    assert given == []


def test_a_later_sample_revises_the_name_and_the_parameters():
    rng = np.random.default_rng(23)
    right = curve(rng, "rub")
    shifts = right.shifts.copy()
    shifts[..., 3:] *= -1.0
    rival = replace(right, fault="leak", shifts=shifts)
    base, true = planted(right.shift(6.0), rng)

    def excited(time):
        """Only what both have alike is seen at first."""
        seen = np.ones(PARAMETERS)
        seen[3:] = not CHANGE - 0.02 < time <= CHANGE + 0.4
        return seen

    config = CONFIG.model_copy(update={"confidence": 0.4})
    monitor = FaultMonitor(FaultBank(curves=(rival, right)), JOINTS, config, sample_period=PERIOD)
    parameters, given = stream(monitor, true, excited=excited)
    (event,) = monitor.events
    assert [name.fault for name in event.names] == ["leak", "rub"]
    assert event.names[0].time < CHANGE + 0.4 < event.names[1].time
    first = given[0][1][0].parameters
    np.testing.assert_allclose(first, base + rival.shift(6.0), atol=0.01)
    np.testing.assert_allclose(parameters, base + right.shift(6.0), atol=0.01)


def test_a_weak_fault_of_one_joint_is_named_though_most_of_the_error_is_noise():
    """One joint errs five times as much as before (squared), the other as before."""
    rng = np.random.default_rng(25)
    bank = make_bank(rng)
    right = bank.curves[4]
    step = np.sqrt(4.0) * 1e-3 / np.linalg.norm(right.shifts[1])
    weak = replace(right, shifts=step * right.shifts)
    _, true = planted(weak.shift(4.0), rng)
    weak_bank = FaultBank(curves=(*bank.curves[:4], weak))
    config = CONFIG.model_copy(update={"slow_window": 600, "explained": (0.8, 0.8)})
    monitor = FaultMonitor(weak_bank, JOINTS, config, sample_period=PERIOD)
    stream(monitor, true)
    (event,) = monitor.events
    assert [(name.fault, name.element) for name in event.names] == [("rub", "knee")]
    assert event.names[0].explained > 0.8


@pytest.mark.parametrize("told", [0.5, 1.0])
def test_a_fault_must_explain_what_a_map_can_say_of_it(told):
    """A good third of the error is the fault's shift, which says nothing of the rest."""
    rng = np.random.default_rng(26)
    bank = make_bank(rng)
    right = replace(bank.curves[1], explains=told)
    shift = right.shift(6.0)
    rest = rng.standard_normal(PARAMETERS)
    rest -= (rest @ shift[1]) / (shift[1] @ shift[1]) * shift[1]
    true_shift = shift.copy()
    true_shift[1] += 1.3 * rest * np.linalg.norm(shift[1]) / np.linalg.norm(rest)
    _, true = planted(true_shift, rng)
    monitor = monitor_of(FaultBank(curves=(bank.curves[0], right, *bank.curves[2:])))
    stream(monitor, true)
    (name,) = monitor.events[0].names
    assert name.fault == ("leak" if told < 1.0 else UNKNOWN)
    assert name.explained == pytest.approx(0.37, abs=0.08)


@pytest.mark.parametrize(
    ("evidence", "proof", "proposed", "named"),
    [(8.0, 8.0, 0.1, 0.1), (8.0, 1e6, 0.1, 0.6)],
)
def test_the_first_evidence_for_a_name_must_be_stronger(evidence, proof, proposed, named):
    rng = np.random.default_rng(27)
    bank = make_bank(rng)
    _, true = planted(bank.curves[3].shift(6.0), rng)
    config = CONFIG.model_copy(update={"evidence": evidence, "proof": (proof, 8.0)})
    monitor = FaultMonitor(bank, JOINTS, config, sample_period=PERIOD)
    _, given = stream(monitor, true)
    assert given[0][0] - CHANGE == pytest.approx(proposed + 0.05, abs=0.07)
    (event,) = monitor.events
    assert event.names[0].time - CHANGE == pytest.approx(named + 0.05, abs=0.07)


def test_same_samples_same_words():
    said = []
    for _ in range(2):
        rng = np.random.default_rng(24)
        bank = make_bank(rng)
        _, true = planted(bank.curves[2].shift(3.0), rng)
        monitor = monitor_of(bank)
        stream(monitor, true)
        said.append(monitor.events)
    assert said[0] == said[1]
    monitor.reset()
    assert monitor.events == []
    stream(monitor, true)
    assert monitor.events == said[0]


def run(controller, fault="seal_wear", *, scenario=None, **config):
    """A run of the knee bench with a fault at 8 s; controller and history."""
    settings = RunSettings(
        scenario="nominal", controller=controller, model="knee_bench", controller_config=config
    )
    loop = Loop(settings, scenario=scenario or get_scenario(fault, duration=16.0))
    measured = []
    real = loop.controller.command

    def noted(measurement, reference):
        measured.append(
            (measurement.time, measurement.position.copy(), measurement.velocity.copy(), reference)
        )
        return real(measurement, reference)

    loop.controller.command = noted
    history = loop.run()
    loop.controller.command = real
    assert not history.failure
    return loop, history, measured


def rms(history, start, end):
    part = (history.time >= 8.0 + start) & (history.time < 8.0 + end)
    return float(np.sqrt(np.mean(history.error[part] ** 2)))


@pytest.fixture(scope="module")
def worn():
    return run("bsnn_arx_bank")


def test_worn_seal_is_named_in_the_closed_loop_and_undone_sooner(worn):
    loop, history, _ = worn
    (event,) = loop.controller.events
    name = event.names[-1]
    assert (name.fault, name.element) == ("seal_wear", ALL)
    assert name.low < 10.0 < name.high
    assert name.onset == pytest.approx(8.0, abs=0.05)
    assert name.time < 8.5
    assert rms(history, 0.3, 1.2) < 0.5 * rms(run("bsnn_arx")[1], 0.3, 1.2)


def test_same_seed_same_bits(worn):
    again = run("bsnn_arx_bank")
    np.testing.assert_array_equal(again[1].command, worn[1].command)
    assert again[0].controller.events == worn[0].controller.events


def test_monitor_says_what_happens_and_not_what_the_simulation_is_told():
    # The scenario calls itself worn seals and rubs instead.
    lie = replace(get_scenario("friction_rise", duration=16.0), name="seal_wear", severity=10.0)
    loop, _, _ = run("bsnn_arx_bank", scenario=lie)
    assert loop.controller.events[-1].names[-1].fault == "friction_rise"


def test_monitor_needs_measurements_and_references_alone(worn):
    loop, history, measured = worn
    alone = make_controller("bsnn_arx_bank", replace(loop._setup), {})
    for number, (time, position, velocity, reference) in enumerate(measured):
        measurement = Measurement(time, position, velocity)
        if number == 0:
            alone.reset(measurement)
        command = alone.command(measurement, ReferencePoint(*reference))
        np.testing.assert_array_equal(np.clip(command, -1, 1), history.command[number])
    assert alone.events == loop.controller.events


def test_a_monitor_that_corrects_nothing_leaves_the_controller_as_it_is():
    watched = run("bsnn_arx_bank", corrects=False)
    np.testing.assert_array_equal(watched[1].command, run("bsnn_arx")[1].command)
    assert watched[0].controller.events[-1].names[-1].fault == "seal_wear"


def reversed_shifts(bank):
    """Every fault shifts the map the other way."""
    return FaultBank(curves=tuple(replace(c, shifts=-c.shifts) for c in bank.curves))


def without_leaks(bank):
    """What happens is not in it; friction explains more than half of it."""
    return bank.without(["seal_wear", "hot_oil", "chamber_leak"])


def nothing_like_it(bank):
    """Nothing of the bank explains much of what happens."""
    return without_leaks(bank).without(["friction_rise", "coulomb_friction"])


@pytest.mark.parametrize("wrong", [reversed_shifts, without_leaks, nothing_like_it])
def test_a_wrong_bank_does_no_harm(wrong, monkeypatch):
    import leglab.runs.loop as module

    real = module.fault_bank
    learned = run("bsnn_arx")[1]
    monkeypatch.setattr(module, "fault_bank", lambda *arguments: wrong(real(*arguments)))
    loop, history, _ = run("bsnn_arx_bank")
    for window in ((0.0, 1.2), (1.2, 2.4), (4.0, 8.0)):
        assert rms(history, *window) < 1.1 * rms(learned, *window)
    told = loop.controller.events[-1].names[-1]
    assert told.fault in (UNKNOWN, "friction_rise", "coulomb_friction")
    if wrong is without_leaks:
        assert told.explained < 0.7
    else:
        assert told.fault == UNKNOWN


def test_a_bank_in_single_precision_says_the_same(worn, monkeypatch):
    """So a controller may keep its constants in half the memory."""
    import leglab.runs.loop as module

    def rounded(bank):
        shifts = (c.shifts.astype(np.float32).astype(float) for c in bank.curves)
        pairs = zip(bank.curves, shifts, strict=True)
        return FaultBank(curves=tuple(replace(c, shifts=s) for c, s in pairs))

    real = module.fault_bank
    monkeypatch.setattr(module, "fault_bank", lambda *arguments: rounded(real(*arguments)))
    loop, _, _ = run("bsnn_arx_bank")
    (event,), (told,) = loop.controller.events, worn[0].controller.events
    for name, right in zip(event.names, told.names, strict=True):
        assert (name.fault, name.element, name.time) == (right.fault, right.element, right.time)
        assert name.size == pytest.approx(right.size, rel=1e-4)
        assert name.confidence == pytest.approx(right.confidence, abs=1e-3)


def test_events_are_in_the_metrics_and_in_words():
    result = run_scenario(
        RunSettings(
            scenario="seal_wear", controller="bsnn_arx_bank", model="knee_bench", duration=17.0
        )
    )
    (event,) = result.metrics["events"]
    assert event["names"][-1]["fault"] == "seal_wear"
    line = result.record.events[0].told()
    assert line.startswith("all cylinders: seal_wear")
    assert event["names"][-1]["size"] == pytest.approx(10.0, rel=0.05)
    assert "internal leakage ratio" in line
    number = result.recording["knee_fault"]
    assert set(np.unique(number)) == {0.0, 1.0}
    quiet = run_scenario(
        RunSettings(scenario="seal_wear", controller="pd", model="knee_bench", duration=2.0)
    )
    assert "events" not in quiet.metrics
    assert quiet.record.events == quiet.record.health == []


def test_a_bank_of_another_machine_is_refused():
    bank = make_bank(np.random.default_rng(25))
    with pytest.raises(LeglabError, match="of 2 joints, the machine has 3"):
        FaultMonitor(bank, ("a", "b", "c"), CONFIG, sample_period=PERIOD)
    with pytest.raises(LeglabError, match=r"monitor\.explained\.1"):
        run("bsnn_arx_bank", monitor={"explained": [0.5, 1.5]})


def test_a_fault_that_the_bank_has_not_cannot_be_left_out():
    with pytest.raises(LeglabError, match="'rust' is not in the bank"):
        run("bsnn_arx_bank", left_out=["rust"])
