"""The gate of the diagnosis: logs as loggers write them are read, or refused in one line."""

import re

import numpy as np
import pytest

from leglab import data
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.diagnosis.balance.units import unquestioned
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.intake.admission import admit
from leglab.diagnosis.intake.recordings import read_recordings, split_held_out
from leglab.diagnosis.intake.remarks import Remark, merged
from leglab.diagnosis.intake.rotation import unwrapped
from leglab.diagnosis.intake.series import Clock, UniformSeries, common_period, quantum
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.replay.windows import resolution
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.thresholds import Thresholds
from leglab.diagnosis.verdict.verdict import diagnose
from rigs import PENDULUM, SLIDE_AXIS, Truth, record
from tests.helpers.unpleasant import (
    CASES,
    changed,
    drifting,
    dropped,
    even,
    jittered,
    of_bench,
    thinned,
    wrapped,
)

TURN = 2.0 * np.pi
AXIS = ("axis_position", "drive_command")


def axis(kind="fast", **options):
    return record(SLIDE_AXIS, kind, Truth(), seed=1, **{"seconds": 3.0, **options})


def pendulum(kind="turns", **options):
    return record(PENDULUM, kind, Truth(), seed=1, **{"seconds": 4.0, **options})


@pytest.fixture(scope="module")
def turning():
    return pendulum()


@pytest.fixture(scope="module")
def sliding():
    return axis()


@pytest.fixture(scope="module")
def wheel():
    return Machine(PENDULUM.model)


@pytest.fixture(scope="module")
def slide():
    return Machine(SLIDE_AXIS.model)


# Rotation.


@pytest.mark.parametrize("turn", [TURN, TURN / 5.0, 4.0 * TURN])
@pytest.mark.parametrize("lost", [0.0, 0.3])
def test_jumps_of_an_encoder_are_taken_out(turning, turn, lost):
    log = dropped(wrapped(turning, "hinge_position", turn), lost, np.random.default_rng(0))
    samples, found, _ = unwrapped(log.time, log["hinge_position"], hinge=True)
    assert found == pytest.approx(turn, rel=1e-9)
    truth = np.interp(log.time, turning.time, turning["hinge_position"])
    off = samples - truth
    assert np.ptp(off) < 1e-9
    assert off[0] / turn == pytest.approx(round(off[0] / turn), abs=1e-9)


def test_turns_within_a_pause_are_told_by_the_speed_beside_it():
    time = np.arange(2000) * 1e-2
    angle = 40.0 * time + 3.0 * np.sin(time)
    keep = np.ones(2000, dtype=bool)
    for first in range(100, 1900, 150):
        keep[first : first + 11] = False  # 4.8 rad, more than half a turn
    samples, _, _ = unwrapped(time[keep], angle[keep] % TURN, hinge=True)
    assert np.ptp(samples - angle[keep]) < 1e-9


def test_a_rack_begins_anew_after_what_its_jumps_agree_on():
    time = np.arange(5000) * 1e-3
    travel = 0.3 * time + 0.02 * np.sin(9.0 * time)
    noisy = (travel + 1e-5 * np.random.default_rng(0).standard_normal(5000)) % 0.0815
    samples, turn, _ = unwrapped(time, noisy, hinge=False)
    assert turn == pytest.approx(0.0815, rel=1e-3)
    assert np.ptp(samples - travel) < 5e-4


def test_what_is_no_turn_is_left_as_it_is(turning, sliding):
    rng = np.random.default_rng(0)
    time = np.arange(4000) * 1e-3
    lost_message = np.sin(3.0 * time) + 4.0
    lost_message[1000] = 0.0
    toggling = np.where(rng.random(4000) < 0.3, 0.001, 0.0)
    for samples in (lost_message, toggling, rng.standard_normal(4000), np.zeros(4000)):
        assert unwrapped(time, samples, hinge=True) is None
    assert unwrapped(turning.time, turning["hinge_position"], hinge=True) is None
    steps = np.repeat(rng.standard_normal(40), 100)
    assert unwrapped(time, steps, hinge=True) is None


def test_a_wheel_may_turn_beyond_twice_around_and_says_what_was_unwrapped(wheel, turning):
    assert np.abs(turning["hinge_position"]).max() > 4.0 * np.pi
    assert admit(wheel, {"a": turning}).notes == ()
    logs = {n: wrapped(turning, "hinge_position", TURN) for n in "ab"}
    admitted = admit(wheel, logs)
    (note,) = admitted.notes
    assert "all recordings: the encoder begins anew after 6.283 rad; unwrapped" in note
    off = admitted.recordings["a"]["hinge_position"] - turning["hinge_position"]
    assert np.ptp(off) < 1e-9


def test_degrees_of_a_wheel_show_in_its_speeds_and_jumps(wheel, turning):
    degrees = changed(turning, "hinge_position", np.rad2deg)
    with pytest.raises(LeglabError, match=r"'hinge_position' in degrees the model fits .* better"):
        unquestioned(wheel, admit(wheel, {"a": degrees}))
    with pytest.raises(LeglabError, match=r"jumps by 360, .* is it in degrees\?"):
        admit(wheel, {"a": wrapped(degrees, "hinge_position", 360.0)})
    # A drive that is twenty times as strong as its model is no reason to doubt the unit.
    weak = changed(turning, "drive_command", lambda u: u / 20.0)
    unquestioned(wheel, admit(wheel, {"a": weak}))


def test_an_encoder_that_begins_anew_within_a_limited_joint_comes_back_into_its_range():
    machine = Machine("knee_bench")
    walk = of_bench()["walk"]
    low = float(np.min(walk["knee_position"]))
    # The first samples lie below the encoder's zero.
    walk = walk.between(walk.time[int(np.argmin(walk["knee_position"]))], 1e9)
    shown = changed(walk, "knee_position", lambda q: (q - low - 0.1) % TURN)
    assert np.ptp(shown["knee_position"]) > 6.0
    admitted = admit(machine, {"a": shown})
    assert any("unwrapped" in note for note in admitted.notes)
    off = admitted.recordings["a"]["knee_position"] - (walk["knee_position"] - low - 0.1)
    np.testing.assert_allclose(off, 0.0, atol=1e-9)


def test_clock_notes_say_whose_clock_differs(slide):
    logs = {str(rate): axis(stamps=even(rate, 3.0)) for rate in (1000, 1000.4, 500)}
    assert admit(slide, {n: logs[n] for n in ("1000", "1000.4")}).notes == (
        "clocks differ from a period of 0.001 s, resampled by their stamps: 1000.4 -0.04 %",
    )
    (note,) = admit(slide, {n: logs[n] for n in ("1000", "500")}).notes
    assert note == (
        "averaged to 500 Hz, the rate of the slowest recording: 1000 from 1000 Hz; their motion "
        "above 250 Hz is lost"
    )


# Clocks.


def series_of(log, period=None):
    return UniformSeries.from_recording(log, "log", AXIS, period=period)


@pytest.mark.parametrize("lost", [0.0, 0.3])
@pytest.mark.parametrize("jitter", [0.0, 0.3, 0.5])
def test_the_period_of_an_uneven_clock(jitter, lost):
    rng = np.random.default_rng(1)
    stamps = jittered(500, jitter, rng, seconds=20.0)
    stamps = stamps[rng.random(stamps.size) >= lost]
    clock = Clock.of(stamps)
    assert clock.period == pytest.approx(2e-3, rel=1e-3 if clock.clear else 0.1)
    # Jitter of a whole period across leaves no beat to tell ticks from.
    assert clock.clear == (not (jitter == 0.5 and lost))
    assert clock.lost == pytest.approx(lost * 10000, rel=0.3)


def test_two_intervals_that_differ_have_a_usual_one():
    assert Clock.of(np.array([0.0, 1.0, 5.0])).period in (1.0, 4.0)


@pytest.mark.parametrize("rate", [600.0, 400.0, 730.0, 910.0])
def test_stamps_in_milliseconds_of_an_even_clock_are_straightened(rate):
    stamps = np.floor(1e3 * even(rate) + 1e-6) / 1e3
    clock = Clock.of(stamps)
    assert clock.rounding == pytest.approx(1e-3)
    assert clock.period == pytest.approx(1.0 / rate, rel=1e-6)
    off = clock.stamps - even(rate)
    assert np.ptp(off) < 1e-6


def test_the_grid_is_that_of_the_slowest(sliding):
    logs = dict.fromkeys("acd", sliding)
    logs["b"] = thinned(sliding, np.arange(len(sliding)) % 2 == 0)
    assert common_period(logs) == pytest.approx(2e-3)
    drift = {str(r): Recording(time=even(r, 3.0), columns={}) for r in (1000, 1000.4, 999.5)}
    assert common_period(drift) == 1e-3


def test_a_log_on_the_grid_stays_as_it_is(sliding):
    series = series_of(sliding)
    for column in AXIS:
        np.testing.assert_allclose(series.columns[column], sliding[column], rtol=0, atol=1e-15)
    assert series.valid.all()
    assert series.noise == {}


@pytest.mark.parametrize("ratio", [2, 2.5, 5, 0.9996, 1.003])
def test_commands_keep_their_impulse(ratio):
    rng = np.random.default_rng(2)
    time = np.arange(4000) * 1e-3
    command = rng.standard_normal(4000)
    log = Recording(time=time, columns={"axis_position": time, "drive_command": command})
    series = series_of(log, period=1e-3 * ratio)
    impulse = series.period * np.cumsum(series.columns["drive_command"])
    ends = series.time + series.period
    truth = np.interp(ends, np.append(time, 4.0), 1e-3 * np.append(0.0, np.cumsum(command)))
    inside = ends < 3.99
    np.testing.assert_allclose(impulse[inside], truth[inside], atol=1e-5)


@pytest.mark.parametrize(
    "stamps",
    [
        even(1000, 4.0),
        even(937.0, 4.0),
        jittered(1000, 0.4, np.random.default_rng(3), 4.0),
        jittered(1000, 0.5, np.random.default_rng(4), 4.0)[
            np.random.default_rng(5).random(4000) > 0.3
        ],
        drifting(1000, 0.01, 4.0),
    ],
    ids=["even", "other", "jitter", "jitter and lost rows", "drift"],
)
@pytest.mark.parametrize("period", [1e-3, 2e-3, 5e-3])
def test_measurements_have_no_phase_shift_and_honest_noise(stamps, period):
    """A swing of 3 Hz and white noise; the noise of means over 10 ms is the one that is claimed."""
    rng = np.random.default_rng(6)
    sigma = 1e-3
    means, claimed, late = [], [], []
    for _ in range(6):
        swing = 0.5 * np.sin(2.0 * np.pi * 3.0 * stamps)
        log = Recording(
            time=stamps,
            columns={
                "axis_position": swing + sigma * rng.standard_normal(stamps.size),
                "drive_command": swing,
            },
        )
        series = series_of(log, period)
        off = series.columns["axis_position"] - 0.5 * np.sin(2.0 * np.pi * 3.0 * series.time)
        off[~series.valid] = 0.0
        assert series.valid.mean() > 0.99
        per = round(0.01 / period)
        means.append(off[20 : 20 + off.size // per * per - 40 * per].reshape(-1, per).mean(axis=1))
        claimed.append(series.noise.get("axis_position", sigma) / np.sqrt(per))
        velocity = 3.0 * np.pi * np.cos(2.0 * np.pi * 3.0 * series.time)
        late.append(np.mean(off * velocity) / np.mean(velocity**2))
    assert abs(np.mean(late)) < 5e-6  # s
    assert np.std(np.concatenate(means)) == pytest.approx(np.mean(claimed), rel=0.12)


def test_frequencies_above_the_grid_are_averaged_not_folded():
    """395 Hz at 1 kHz would be seen as 5 Hz at 200 Hz."""
    time = np.arange(4000) * 1e-3
    log = Recording(
        time=time,
        columns={
            "axis_position": np.sin(2.0 * np.pi * 395.0 * time),
            "drive_command": np.sin(2.0 * np.pi * 395.0 * time),
        },
    )
    series = series_of(log, period=5e-3)
    for column in AXIS:
        assert np.std(series.columns[column][10:-10]) < 0.25 * np.sqrt(0.5)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda rng: {"stamps": jittered(1000, 0.5, rng, 3.0)},
        lambda rng: {"lost": 0.3},
        lambda rng: {"stamps": jittered(1000, 0.3, rng, 3.0), "lost": 0.3},
    ],
    ids=["jitter", "lost rows", "both"],
)
def test_uneven_logs_keep_nearly_all_windows(spoil):
    rng = np.random.default_rng(7)
    options = spoil(rng)
    lost = options.pop("lost", 0.0)
    clean = {"a": axis(), "b": axis("multisine")}
    logs = {
        n: dropped(axis(k, **options), lost, rng) for n, k in (("a", "fast"), ("b", "multisine"))
    }
    settings = DiagnosisSettings(threads=1)
    good = set_up(SLIDE_AXIS.model, clean, ("b",), settings)
    bad = set_up(SLIDE_AXIS.model, logs, ("b",), settings)
    assert bad.replay.windows >= 0.9 * good.replay.windows
    level = np.median(bad.window_cost(Hypothesis())) / np.median(good.window_cost(Hypothesis()))
    assert level < 1.6


def test_true_gaps_are_left_out(sliding):
    keep = np.ones(len(sliding), dtype=bool)
    keep[1000:1040] = False
    series = series_of(thinned(sliding, keep))
    assert (~series.valid).sum() == pytest.approx(40, abs=2)
    assert not series.valid[1002:1038].any()


def test_a_short_gap_is_bridged_only_where_the_motion_is_smooth():
    time = np.arange(3000) * 1e-3
    smooth = np.sin(4.0 * time)
    sudden = np.where(time < 1.5, 0.0, 1.0)
    keep = np.ones(3000, dtype=bool)
    keep[1497:1502] = False
    for position, command, known in (
        (smooth, smooth, True),
        (sudden, smooth, False),
        (smooth, sudden, False),
    ):
        noise = 1e-4 * np.random.default_rng(0).standard_normal(3000)
        columns = {"axis_position": position + noise, "drive_command": command}
        series = series_of(thinned(Recording(time=time, columns=columns), keep))
        assert series.valid[1499] == known


@pytest.mark.parametrize("hidden", [0.0, 8.0])
def test_a_decimated_log_and_one_of_that_rate_have_the_same_misfit(hidden):
    """A loop at 500 Hz, and one at 1 kHz whose log is brought to 500 Hz here; windows alike."""
    settings = DiagnosisSettings(threads=1, thresholds=Thresholds(start_room=0.0))
    level = {}
    for rate in (1000, 500):
        logs = {
            kind: record(SLIDE_AXIS, kind, Truth(forward=hidden), seed=3, stamps=even(rate, 6.0))
            for kind in ("fast", "multisine")
        }
        # A short recording of 500 Hz sets the grid for both.
        logs["slow"] = record(SLIDE_AXIS, "slow", Truth(), seed=4, stamps=even(500, 1.0))
        problem = set_up(SLIDE_AXIS.model, logs, ("multisine",), settings)
        assert problem.series[0].period == pytest.approx(2e-3)
        some = problem.replay.recording < 2
        errors = problem.raw_errors(Hypothesis()) if hidden else problem.residual(Hypothesis())
        level[rate] = np.sqrt(np.mean(errors[some] ** 2))
    # Of 1,140 numbers of noise each, three standard deviations of the ratio are 0.09.
    assert level[1000] == pytest.approx(level[500], rel=0.04 if hidden else 0.09)


# Noise floors.


def test_the_least_step_is_found_among_float_noise_and_odd_values():
    rng = np.random.default_rng(8)
    motion = np.sin(np.arange(8000) * 3e-3)
    for step in (1e-2, 1e-3, 2.0 * np.pi / 16384):
        counts = np.rint((motion + 2e-3 * rng.standard_normal(8000)) / step) * step
        assert quantum(counts + 1e-16 * rng.standard_normal(8000)) == pytest.approx(step, rel=1e-3)
        counts[100::90] += 0.37 * step  # single values that a logger interpolated
        assert quantum(counts) == pytest.approx(step, rel=1e-3)
    assert quantum(motion) == 0.0
    assert quantum(motion + 1e-4 * rng.standard_normal(8000)) == 0.0
    assert quantum(0.02 * np.arange(8000)) == 0.0  # a steady motion is no count
    assert quantum(1e-16 * rng.standard_normal(8000) + 1.0) == 0.0


def test_a_signal_that_rests_on_one_count_has_the_noise_of_a_count():
    step = 1e-3
    motion = np.sin(np.arange(4000) * 3e-3)
    float_noise = 1e-16 * np.random.default_rng(0).standard_normal(4000)
    moving = np.rint(motion / step) * step
    half = np.where(np.arange(4000) < 2000, moving, moving[2000]) + float_noise
    still = np.full(4000, moving[2000]) + float_noise
    time = np.arange(4000) * 1e-3

    def made(position):
        return series_of(Recording(time=time, columns={AXIS[0]: position, AXIS[1]: motion}))

    for found in ([made(half), made(still)], [made(still), made(moving)]):
        assert resolution(found, AXIS[0]) == pytest.approx(step / np.sqrt(12.0), rel=1e-3)
    assert 1e-5 < resolution([made(np.full(4000, 0.3))], AXIS[0]) < 1e-3


def test_windows_at_rest_are_few_and_no_thousand_noise_levels():
    found = CASES["resting"]()
    logs = {n: found.recordings[n] for n in ("rests", "idle", "multisine")}
    problem = set_up(found.model, logs, (), DiagnosisSettings(threads=1))
    names = list(logs)
    idle = problem.replay.recording == names.index("idle")
    assert 1 <= idle.sum() <= 2  # of nine
    moving = problem.replay.recording == names.index("multisine")
    squares = np.sqrt(np.mean(problem.residual(Hypothesis()) ** 2, axis=1))
    assert squares[idle].max() < 10.0
    assert np.median(squares[moving]) > 20.0  # the hidden friction


# Columns and recordings.


def test_notes_are_said_once():
    remarks = [
        Remark(text="is doubtful", recording="a", place="'x' 3"),
        Remark(text="is doubtful", recording="b", place="'x' 4"),
        Remark(text="is doubtful", recording="b", place="'y' 1"),
        Remark(text="rests", recording="b"),
        Remark(text="rests", recording="a"),
    ]
    assert merged(remarks, ("a", "b")) == (
        "is doubtful: a ('x' 3); b ('x' 4, 'y' 1)",
        "all recordings: rests",
    )


def test_notes_of_ten_thousand_gaps_are_one_line(slide, sliding):
    logs = {n: dropped(sliding, 0.3, np.random.default_rng(i)) for i, n in enumerate("abc")}
    (note,) = admit(slide, logs).notes
    assert note.startswith("rows are missing: a (")


JUNK = {
    "comment": lambda r: np.array(["ok"] * len(r)),
    "empty": lambda r: np.full(len(r), np.nan),
    "spare_pressure_a": lambda r: np.full(len(r), 3.2),
    "torque": lambda r: np.full(len(r), np.inf),
}


@pytest.mark.parametrize("form", ["csv", "parquet", "mat", "mcap"])
def test_columns_that_nobody_needs_refuse_nothing(form, tmp_path, slide, sliding):
    path = tmp_path / f"a.{form}"
    columns = dict(sliding.columns) | {n: make(sliding) for n, make in JUNK.items()}
    if form == "csv":
        header = ["time", *columns, "torque"]  # one name twice
        rows = zip(sliding.time, *columns.values(), sliding.time, strict=True)
        lines = [",".join(map(str, row)) for row in rows]
        path.write_text("\n".join([",".join(header), *lines]) + "\n")
    elif form == "parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        pq.write_table(pa.table({"time": sliding.time, **columns}), path)
    elif form == "mat":
        from scipy.io import savemat

        savemat(path, {"time": sliding.time, **columns, "short": np.arange(7.0)})
    else:
        columns.pop("comment")
        data.write(Recording(time=sliding.time, columns=columns), path)
    found = read_recordings([path])
    admitted = admit(slide, found)
    assert admitted.notes == ()
    np.testing.assert_allclose(
        admitted.recordings[path.name]["axis_position"], sliding["axis_position"], atol=1e-15
    )
    assert set(admitted.recordings[path.name].columns) == set(AXIS)


def test_a_map_of_columns_that_are_not_there_refuses_only_what_is_needed(tmp_path, slide, sliding):
    data.write(sliding, tmp_path / "a.csv")
    (tmp_path / "map.toml").write_text('[columns]\nt_oil = "oil_temperature"\n')
    found = read_recordings([tmp_path / "a.csv"], tmp_path / "map.toml")
    assert admit(slide, found).notes == ()
    (tmp_path / "map.toml").write_text('[columns]\npos = "axis_position"\naxis_position = "old"\n')
    found = read_recordings([tmp_path / "a.csv"], tmp_path / "map.toml")
    with pytest.raises(LeglabError, match="a.csv: no column 'pos', which .*map.toml names"):
        admit(slide, found)


def test_a_broken_cell_in_a_needed_column_is_named_by_its_row(tmp_path, slide, sliding):
    data.write(sliding, tmp_path / "good.csv")
    lines = (tmp_path / "good.csv").read_text().splitlines()
    lines[5] = "0.004,broken,0.1"
    (tmp_path / "bad.csv").write_text("\n".join(lines) + "\n")
    found = read_recordings([tmp_path / "bad.csv"])
    words = "column 'axis_position', row 4: 'broken' is not a number"
    with pytest.raises(LeglabError, match=words) as error:
        admit(slide, found)
    assert "\n" not in str(error.value)
    both = read_recordings([tmp_path / "bad.csv", tmp_path / "good.csv"])
    admitted = admit(slide, both)
    assert list(admitted.recordings) == ["good.csv"]
    assert admitted.notes == (f"bad.csv: left out, {words}",)
    with pytest.raises(LeglabError, match=f"{words}; it was to be held out; allowed: another"):
        admit(slide, both, ("bad.csv",))
    with pytest.raises(LeglabError, match=f"{words}; no recording is left to fit"):
        admit(slide, both, ("good.csv",))
    parts, held = split_held_out(SLIDE_AXIS.model, both, [])
    assert held == ("good.csv (end)",)
    assert set(parts) == {"bad.csv", "good.csv", "good.csv (end)"}


def test_a_recording_in_degrees_is_left_out_if_others_remain(wheel, turning):
    wrong = changed(turning, "hinge_position", np.rad2deg)
    admitted = unquestioned(wheel, admit(wheel, {"a": turning, "b": wrong, "c": turning}, ("a",)))
    assert set(admitted.recordings) == {"a", "c"}
    (note,) = admitted.notes
    assert re.match(r"b: left out, with 'hinge_position' in degrees the model fits", note)


def without(recording, column):
    columns = {n: s for n, s in recording.columns.items() if n != column}
    return Recording(time=recording.time, columns=columns)


def test_pressures_lost_in_one_file_cost_the_file_and_in_most_the_pressures():
    machine = Machine("knee_bench")
    logs = of_bench()
    assert admit(machine, logs, ("walk",)).notes == ()
    lost = logs | {"slow": without(logs["slow"], "knee_pressure_b")}
    admitted = admit(machine, lost, ("walk",))
    assert set(admitted.recordings) == {"multisine", "walk"}
    assert "slow: left out, no column 'knee_pressure_b', and the other" in admitted.notes[0]
    assert "knee_pressure_b" in admitted.recordings["walk"]
    # Those with all of them are the smaller part.
    most = lost | {
        "multisine": without(logs["multisine"], "knee_pressure_b"),
        "short": logs["walk"].between(0.0, 1.0),
    }
    admitted = admit(machine, most, ("walk",))
    assert set(admitted.recordings) == set(most)
    assert not any("knee_pressure_b" in r for r in admitted.recordings.values())
    # The judge lacks them: then nobody uses the column.
    admitted = admit(machine, lost, ("slow",))
    assert set(admitted.recordings) == set(logs)
    assert not any("knee_pressure_b" in r for r in admitted.recordings.values())
    assert any("pressures are not used, other recordings lack them" in n for n in admitted.notes)


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lambda p: np.full_like(p, 5e5), "is the sensor connected?"),
        (lambda p: 1e-5 * p, "is it in bar?"),
        (lambda p: np.where(np.arange(p.size) % 3, np.nan, p), "numbers in"),
    ],
    ids=["dead", "bar", "NaN"],
)
def test_a_dead_pressure_in_one_file_is_named(spoil, word):
    machine, logs = Machine("knee_bench"), of_bench()
    logs["slow"] = changed(logs["slow"], "knee_pressure_a", spoil)
    admitted = admit(machine, logs, ("walk",))
    assert set(admitted.recordings) == {"multisine", "walk"}
    assert len(admitted.notes) == 1
    assert "'knee_pressure_a'" in admitted.notes[0]
    assert word in admitted.notes[0]


def test_a_recording_that_is_far_slower_does_not_slow_the_others(slide, sliding):
    slow = axis("slow", seconds=20.0)
    slow = thinned(slow, np.arange(len(slow)) % 100 == 0)
    admitted = admit(slide, {"a": sliding, "b": slow})
    assert list(admitted.recordings) == ["a"]
    assert admitted.notes == ("b: left out, sampled every 0.1 s only, the others every 0.001 s",)
    assert list(admit(slide, {"b": slow}).recordings) == ["b"]


def test_admitting_twice_changes_nothing(wheel, turning):
    once = admit(wheel, {"a": wrapped(turning, "hinge_position", TURN), "b": turning})
    again = admit(wheel, once.recordings)
    for name in "ab":
        assert again.recordings[name] == once.recordings[name]
    assert again.notes == ()


# Whole diagnoses.


@pytest.mark.slow("whole diagnoses with all effects")
@pytest.mark.parametrize("name", ["uneven", "everything"])
def test_an_unpleasant_case_gets_the_name_and_size_of_a_clean_one(name):
    case = CASES[name]()
    result, _ = diagnose(
        case.model,
        case.recordings,
        held_out=(case.held_out,),
        settings=DiagnosisSettings(threads=1),
    )
    effect, _, _ = case.hidden
    assert [e.name for e in result.effects][:1] == [effect]
    assert result.gap.closed_fraction > 0.95
    assert len(set(result.notes)) == len(result.notes)
