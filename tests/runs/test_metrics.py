import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from leglab.base.errors import LeglabError
from leglab.base.scenario import Phase
from leglab.runs.metrics import (
    excess_error_area,
    joint_rms,
    phase_table,
    settling_time,
    sliding_rms,
    usage_table,
)

errors = hnp.arrays(
    np.float64,
    st.tuples(st.integers(2, 60), st.integers(1, 4)),
    elements=st.floats(-2, 2).filter(lambda x: x == 0 or abs(x) > 1e-6),
)


def windows_by_brute_force(time, error, window):
    """The definition, sample by sample; times are integers, so nothing is rounded."""
    result = np.full(len(time), np.nan)
    for i, now in enumerate(time):
        if now - window >= time[0] - (time[1] - time[0]):
            inside = [j for j in range(i + 1) if time[j] > now - window]
            result[i] = np.sqrt(np.mean(error[inside] ** 2))
    return result


@given(errors)
def test_figures_follow_their_definition(error):
    time, joints = np.arange(float(len(error))), "abcd"[: error.shape[1]]
    (row,) = phase_table(time, error, joints, [Phase(name="whole", start=0, end=time[-1])])
    for name, samples in (*zip(joints, error.T, strict=True), ("all", error.ravel())):
        assert row["rms_rad"][name] == pytest.approx(np.sqrt(sum(samples**2) / len(samples)))
        assert row["peak_rad"][name] == max(abs(samples))
        below = np.mean(abs(samples) <= row["p95_rad"][name] + 1e-12)
        assert 0.95 - 1 / len(samples) <= below
        assert np.mean(abs(samples) < row["p95_rad"][name] - 1e-12) <= 0.95 + 1e-9


def test_rms_of_a_sine():
    time = np.arange(1000) / 1000
    error = 0.3 * np.sin(2 * np.pi * time)[:, None]
    assert joint_rms(error) == pytest.approx(0.3 / np.sqrt(2))


def test_phases_split_the_run_without_overlap():
    time = np.arange(0, 10.5, 0.5)
    error = np.column_stack([np.where(time < 5, 0.1, 0.3), np.where(time < 5, 0.2, 0.6)])
    phases = [Phase(name="before", start=0, end=5), Phase(name="after", start=5, end=10)]
    before, after = phase_table(time, error, ["hip", "knee"], phases)
    assert before == {
        "name": "before",
        "start": 0,
        "end": 5,
        "rms_rad": pytest.approx({"hip": 0.1, "knee": 0.2, "all": np.sqrt(0.025)}),
        "peak_rad": pytest.approx({"hip": 0.1, "knee": 0.2, "all": 0.2}),
        "p95_rad": pytest.approx({"hip": 0.1, "knee": 0.2, "all": 0.2}),
    }
    assert after["rms_rad"] == pytest.approx({"hip": 0.3, "knee": 0.6, "all": np.sqrt(0.225)})


def test_the_last_sample_belongs_to_the_last_phase():
    time = np.arange(5.0)
    error = np.array([0, 0, 0, 0, 9.0])[:, None]
    (row,) = phase_table(time, error, ["knee"], [Phase(name="whole", start=0, end=4)])
    assert row["peak_rad"]["knee"] == 9


def test_a_phase_that_was_not_reached_is_left_out():
    phases = [Phase(name="before", start=0, end=5), Phase(name="after", start=5, end=10)]
    table = phase_table(np.arange(3.0), np.ones((3, 1)), ["knee"], phases)
    assert [row["name"] for row in table] == ["before"]


@pytest.mark.parametrize(
    ("error", "joints", "message"),
    [
        (np.ones((3, 2)), ["knee"], r"shape \(3, 2\), 3 samples of 1 joints need \(3, 1\)"),
        (np.ones(3), ["knee"], r"shape \(3,\)"),
        (np.ones((3, 1)), ["all"], "joint named 'all'"),
        (np.array([[0], [np.nan], [0]]), ["knee"], "row 1, joint 0: nan is not finite"),
    ],
)
def test_bad_errors_are_named(error, joints, message):
    with pytest.raises(LeglabError, match=message):
        phase_table(np.arange(3.0), error, joints, [Phase(name="whole", start=0, end=2)])


def test_a_window_without_length_is_refused():
    with pytest.raises(LeglabError, match="window 0"):
        sliding_rms(np.arange(3.0), np.ones((3, 1)), 0)


@given(errors, st.integers(1, 70))
def test_sliding_rms_equals_brute_force(error, window):
    time = np.arange(len(error)) * 1.0
    expected = windows_by_brute_force(time, error, window)
    np.testing.assert_allclose(sliding_rms(time, error, window), expected, rtol=1e-9, atol=1e-12)


def test_sliding_rms_with_lost_samples_equals_brute_force():
    rng = np.random.default_rng(1)
    time = np.concatenate(([0, 1], np.flatnonzero(rng.random(300) < 0.7) + 2)) * 1.0
    error = rng.normal(size=(len(time), 3))
    expected = windows_by_brute_force(time, error, 17)
    np.testing.assert_allclose(sliding_rms(time, error, 17), expected, rtol=1e-12)


def test_a_stride_of_rounded_time_stamps_holds_a_whole_number_of_samples():
    time = np.arange(5000) * 0.002
    wave = np.sin(2 * np.pi * time / 1.2)[:, None]
    windowed = sliding_rms(time, wave, 1.2)
    assert np.isnan(windowed[:599]).all()
    np.testing.assert_allclose(windowed[599:], 1 / np.sqrt(2), rtol=1e-12)


def test_small_errors_after_large_ones_keep_their_digits():
    time = np.arange(60000) * 0.001
    error = np.where(time < 30, 1.0, 1e-6)[:, None]
    assert sliding_rms(time, error, 1.2)[-1] == pytest.approx(1e-6, rel=1e-4)


def test_windows_do_not_depend_on_when_the_clock_began():
    time, error = np.arange(500) * 0.01, np.random.default_rng(2).normal(size=(500, 2))
    np.testing.assert_array_equal(
        sliding_rms(time + 64.0, error, 0.5), sliding_rms(np.arange(500) * 0.01, error, 0.5)
    )
    assert np.isnan(sliding_rms(np.zeros(1), np.ones((1, 1)), 0.5)).all()


@given(errors, st.integers(1, 20), st.integers(0, 60))
def test_excess_error_area_equals_brute_force(error, window, change):
    time = np.arange(len(error)) * 1.0
    area = excess_error_area(time, error, change, window)
    windowed = windows_by_brute_force(time, error, window)
    if change == 0 or change >= len(time) or np.isnan(windowed[change - 1]):
        assert area is None
        return
    excess = [max(w - windowed[change - 1], 0.0) for w in windowed[change:]]
    expected = sum((a + b) / 2 for a, b in itertools.pairwise(excess))
    assert area == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_excess_error_area_of_a_pulse():
    time = np.arange(3001) * 0.01
    error = np.where((time >= 10) & (time < 13), 1.1, 0.1)[:, None]
    # A rise and a fall of the window add up to about a pulse of its own length and height, and
    # the RMS lies above the mean while good and bad share the window.
    area = excess_error_area(time, error, change=10, window=1)
    assert 3.0 < area < 3.5


def test_effort_rate_and_energy_belong_to_the_phase_of_the_later_sample():
    time = 0.5 * np.arange(5)
    command = np.column_stack([[0.0, 1.0, 0.0, 2.0, 2.0], np.zeros(5)])
    energy = np.column_stack([[1.0, 2.0, 4.0, 8.0, 16.0], np.full(5, np.nan)])
    phases = (
        Phase(name="before", start=0.0, end=1.0),
        Phase(name="after", start=1.0, end=2.0),
    )
    before, after = usage_table(time, command, energy, ("a", "b"), phases)
    assert before["effort"] == pytest.approx({"a": 0.5**0.5, "b": 0.0, "all": 0.5})
    assert before["valve_activity_per_s"] == pytest.approx({"a": 2.0, "b": 0.0, "all": 2**0.5})
    assert before["energy_j"] == {"a": 1.0, "all": 1.0}
    assert after["effort"]["a"] == pytest.approx((8 / 3) ** 0.5)
    assert after["valve_activity_per_s"]["a"] == pytest.approx((20 / 3) ** 0.5)
    assert after["energy_j"] == {"a": 14.0, "all": 14.0}
    (first,) = usage_table(time[:1], command[:1], energy[:1], ("a", "b"), phases)
    assert first["valve_activity_per_s"] == {"a": 0.0, "b": 0.0, "all": 0.0}
    assert first["energy_j"] == {"a": 0.0, "all": 0.0}
    (none,) = usage_table(time[:1], command[:1], energy[:1, 1:].repeat(2, 1), ("a", "b"), phases)
    assert "energy_j" not in none


@pytest.mark.parametrize(
    ("exceeding", "settled"),
    [([], 0.0), ([2], 0.0), ([3], 0.0), ([4], 0.0), ([5], 1.0), ([3, 7], 3.0), ([9], None)],
)
def test_settling_ends_where_no_later_window_exceeds(exceeding, settled):
    time, windowed = np.arange(10.0), np.ones(10)
    windowed[exceeding] = 1.5
    windowed[0] = np.nan
    assert settling_time(time, windowed, change=3.0, window=2.0, threshold=1.0) == settled


@pytest.mark.parametrize("period", [0.1, 0.002, 7.0])
def test_stamps_that_are_rounded_change_no_window(period):
    time, error = np.arange(40) * period, np.random.default_rng(0).normal(size=(40, 2))
    found = sliding_rms(time, error, 5 * period)
    assert np.isnan(found[:4]).all()
    wanted = [np.sqrt(np.mean(error[i - 4 : i + 1] ** 2)) for i in range(4, 40)]
    np.testing.assert_allclose(found[4:], wanted)
