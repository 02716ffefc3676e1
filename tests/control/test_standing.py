"""Faults that stand are repaired in part, as a whole, or grow; made-up samples and the bench."""

from dataclasses import replace

import numpy as np
import pytest

from leglab import RunSettings
from leglab.base.scenario import Scenario, get_scenario
from leglab.causes.fault_names import ALL, UNKNOWN, FaultName
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve
from leglab.control.feedforward.standing import Standings
from leglab.runs.loop import Loop
from tests.helpers.learned_samples import JOINTS, PARAMETERS, make_bank, monitor_of, stream

TIMES = (4.0, 12.0, 20.0)  # of changes, s


def staged(base, *shifts):
    """A map that is changed at TIMES, to a base and the shift of then."""

    def true(time):
        return base + ([np.zeros_like(base), *shifts][sum(time > t for t in TIMES[: len(shifts)])])

    return true


def name_of(onset, fault, element, size):
    return FaultName(
        time=onset, onset=onset, fault=fault, element=element, size=size, confidence=1, explained=1
    )


def told_of(shifts, bank, rng, **options):
    monitor = monitor_of(bank)
    base = rng.standard_normal((len(JOINTS), PARAMETERS))
    parameters, _ = stream(monitor, staged(base, *shifts), end=28.0, **options)
    return monitor, parameters - base


def test_a_repaired_fault_is_told_as_gone_and_its_learned_shift_taken_back():
    """The machine's own shift is not quite the bank's; the learner has learned it."""
    rng = np.random.default_rng(40)
    bank = make_bank(rng)
    shift = bank.curves[1].shift(6.0)
    own = 1.1 * shift * (1.0 + 0.1 * rng.standard_normal(shift.shape))
    monitor, left = told_of((own, 0.0 * own), bank, rng, learned=(8.0,))
    first, second = (event.names[-1] for event in monitor.events)
    assert first.undoes is None
    assert (second.fault, second.element) == (first.fault, first.element) == ("leak", "knee")
    assert second.undoes == first.onset
    assert second.onset == pytest.approx(TIMES[1], abs=0.05)
    assert second.time < TIMES[1] + 0.3
    assert second.size == pytest.approx(1.0, abs=0.1)
    assert second.explained > 0.95
    np.testing.assert_allclose(left, 0.0, atol=0.01)


def test_an_unknown_change_that_goes_away_is_told_as_undone():
    rng = np.random.default_rng(41)
    bank = make_bank(rng)
    strange = 0.1 * rng.standard_normal((len(JOINTS), PARAMETERS))
    monitor, left = told_of((strange, 0.0 * strange), bank, rng, learned=(8.0,))
    first, second = (event.names[-1] for event in monitor.events)
    assert first.fault == second.fault == UNKNOWN
    assert (first.undoes, second.undoes) == (None, first.onset)
    assert second.size is None
    np.testing.assert_allclose(left, 0.0, atol=0.01)
    assert not monitor.report["fault"].any()
    line = monitor.events[-1]
    assert f"goes back on what began at {first.onset:.2f} s" in line.told()
    assert line.short().endswith("unknown change undone")


def test_more_of_a_fault_has_its_whole_size_and_goes_back_as_a_whole():
    rng = np.random.default_rng(42)
    bank = make_bank(rng)
    leak = bank.curves[0]
    shifts = (leak.shift(3.0), leak.shift(8.0), 0.0 * leak.shift(8.0))
    monitor, left = told_of(shifts, bank, rng, learned=(8.0, 16.0))
    sizes = [event.names[-1].size for event in monitor.events]
    assert [event.names[-1].fault for event in monitor.events] == ["leak"] * 3
    np.testing.assert_allclose(sizes, [3.0, 8.0, 1.0], atol=0.3)
    assert [event.names[-1].undoes for event in monitor.events[:2]] == [None, None]
    assert monitor.events[2].names[-1].undoes == monitor.events[1].names[-1].onset
    np.testing.assert_allclose(left, 0.0, atol=0.01)


def test_a_half_repaired_fault_still_stands_and_can_be_repaired_later():
    rng = np.random.default_rng(43)
    bank = make_bank(rng)
    shift = bank.curves[2].shift(9.0)
    monitor, left = told_of((shift, 0.5 * shift, 0.0 * shift), bank, rng, learned=(8.0, 16.0))
    sizes = [event.names[-1].size for event in monitor.events]
    np.testing.assert_allclose(sizes, [9.0, 5.0, 1.0], atol=0.3)
    onset = monitor.events[0].names[-1].onset
    assert [event.names[-1].undoes for event in monitor.events[1:]] == [onset, onset]
    np.testing.assert_allclose(left, 0.0, atol=0.01)


def test_another_fault_that_joins_one_is_no_repair_and_either_can_go():
    rng = np.random.default_rng(44)
    bank = make_bank(rng)
    leak, rub = bank.curves[1].shift(6.0), bank.curves[3].shift(6.0)
    monitor, left = told_of((leak, leak + rub, rub), bank, rng, learned=(8.0, 16.0))
    names = [event.names[-1] for event in monitor.events]
    assert [(n.fault, n.element) for n in names] == [
        ("leak", "knee"),
        ("rub", "hip"),
        ("leak", "knee"),
    ]
    assert [n.undoes for n in names] == [None, None, names[0].onset]
    np.testing.assert_allclose(left, rub, atol=0.01)


def test_a_fault_that_grows_beside_another_goes_back_alone():
    rng = np.random.default_rng(47)
    bank, shape = make_bank(rng), (len(JOINTS), PARAMETERS)
    seen = rng.standard_normal((50, *shape))
    leak, rub = bank.curves[1], bank.curves[3]
    standings, base = Standings(bank), rng.standard_normal(shape)
    now = base
    for onset, curve, size, shift in (
        (1.0, leak, 4.0, leak.shift(4.0)),
        (2.0, rub, 6.0, rub.shift(6.0)),
        (3.0, leak, 9.0, leak.shift(9.0) - leak.shift(4.0)),
    ):
        standings.add(name_of(onset, curve.fault, curve.element, size), now)
        now = now + shift
        ways = {c.undoes: c for c in standings.bank(now, seen).curves if c.undoes is not None}
    assert set(ways) == {2.0, 3.0}
    np.testing.assert_allclose(ways[2.0].shifts[1], -rub.shift(6.0), atol=1e-12)
    np.testing.assert_allclose(ways[3.0].shifts[1], -leak.shift(9.0), atol=1e-12)
    standings.undo(3.0, 1.0)
    (way,) = (c for c in standings.bank(base + rub.shift(6.0), seen).curves if c.undoes)
    assert way.undoes == 2.0


def test_curves_of_a_fault_that_stands_begin_at_its_size():
    sizes, shape = np.array([0.0, 2.0, 5.0]), (len(JOINTS), PARAMETERS)
    shifts = np.stack([np.zeros(shape), np.ones(shape), 4.0 * np.ones(shape)])
    up = FaultCurve(fault="null", element=ALL, meaning="", sizes=sizes, shifts=shifts)
    down = replace(up, sizes=-sizes, shifts=-shifts)
    standings = Standings(FaultBank(curves=(up, down)))
    before, after = np.zeros(shape), 2.2 * np.ones(shape)
    standings.add(name_of(1.0, "null", ALL, 3.0), before)
    seen = np.random.default_rng(45).standard_normal((50, *shape))
    onward, back = standings.bank(after, seen).curves
    np.testing.assert_array_equal(onward.sizes, [3.0, 5.0])
    np.testing.assert_allclose(onward.shifts[:, 0, 0], [0.0, 2.0])  # of 2 at a size of 3
    np.testing.assert_array_equal(back.sizes, [3.0, 0.0])
    np.testing.assert_allclose(back.shifts[:, 0, 0], [0.0, -2.2])
    assert (onward.undoes, back.undoes) == (None, 1.0)
    standings.undo(1.0, 1.5)
    (_, half) = standings.bank(1.1 * np.ones(shape), seen).curves
    np.testing.assert_allclose(half.sizes, [1.5, 0.0])
    np.testing.assert_allclose(half.shifts[1], -1.1)
    standings.undo(1.0, 0.1)
    assert standings.bank(before, seen).curves == (up, down)


def test_a_change_that_was_unlearned_without_a_word_stands_no_more():
    rng = np.random.default_rng(46)
    bank, shape = make_bank(rng), (len(JOINTS), PARAMETERS)
    base, seen = rng.standard_normal(shape), rng.standard_normal((50, *shape))
    seen[..., 0] = 0.0  # a parameter that the motion does not show may drift
    standings = Standings(bank)
    leak, rub = bank.curves[1].shift(6.0), bank.curves[3].shift(6.0)
    standings.add(name_of(1.0, "leak", "knee", 6.0), base)
    standings.bank(base + leak, seen)
    standings.add(name_of(2.0, "rub", "hip", 6.0), base + leak)
    drift = np.zeros(shape)
    drift[:, 0] = 0.5
    both = standings.bank(base + leak + rub + drift, seen).curves
    assert [c.undoes for c in both if c.undoes is not None] == [1.0, 2.0]
    left = standings.bank(base + 0.1 * leak + rub - drift, seen).curves
    assert [c.undoes for c in left if c.undoes is not None] == [2.0]
    whole = [c for c in left if (c.fault, c.element) == ("leak", "knee")]
    assert whole == [bank.curves[1]]


def test_a_supply_that_recovers_is_told_in_the_closed_loop():
    comes, goes = 8.0, 14.0
    (drop,) = get_scenario("supply_drop", duration=20.0, severity=110.0).changes
    (back,) = get_scenario("supply_drop", duration=20.0, severity=160.0).changes
    changes = (replace(drop, start=comes), replace(back, start=goes))
    settings = RunSettings(
        scenario="nominal", controller="bsnn_arx_bank", model="knee_bench", tolerance=0.1, vary=True
    )
    loop = Loop(settings, scenario=Scenario(name="drop", duration=20.0, changes=changes))
    history = loop.run()
    assert not history.failure
    first, second = (event.names[-1] for event in loop.controller.events)
    assert (first.fault, second.fault) == ("supply_drop", "supply_drop")
    assert second.undoes == first.onset
    assert second.onset == pytest.approx(goes, abs=0.1)
    assert second.time < goes + 0.6
    assert second.size > 150.0
