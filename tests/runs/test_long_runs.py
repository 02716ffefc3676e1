"""Rows of a run go to disk as they come: the same bits, and memory that hardly grows."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import leglab.runs.metrics
import leglab.runs.run
from leglab import data
from leglab.base.errors import LeglabError
from leglab.base.scenario import get_scenario
from leglab.data import parquet
from leglab.machine.sensors import (
    EncoderFaults,
    SensorConfiguration,
    VelocityFilter,
    held,
    skip_normal,
    velocity_filter_coefficient,
)
from leglab.report.figures import outline, save_run_figures
from leglab.runs.loop import Loop
from leglab.runs.metrics import sliding_rms
from leglab.runs.preparation import RunSettings
from leglab.runs.run import record_scenario, run_scenario

# Does not fit the checks of the loop, every 50 periods; of 1001 the last block has one period.
BLOCK = 125
RUNS = {
    "a bench": {"model": "knee_bench"},
    "lost readings": {"scenario": "sensor_dropout"},
    "an encoder that slips": {"scenario": "encoder_shift", "reference": "random_stride"},
    "measured pressures": {"scenario": "supply_drop", "controller": "bsnn_arx_pressure"},
    "a frozen twin": {"scenario": "hot_oil", "controller": "bsnn_arx", "model": "knee_bench"},
    "joints that nothing drives": {"model": "leg_rail"},
    "motors": {"model": "leg_motor"},
}


def settings(**changes):
    return RunSettings(**{"scenario": "nominal", "controller": "pd", "duration": 2.0, **changes})


def figures(run):
    """All metrics but the times of this computer."""
    clock = ("real_time_factor", "command_time_s")
    return {k: v for k, v in run.metrics.items() if k not in clock}


@pytest.mark.parametrize("case", RUNS)
def test_a_recording_that_is_written_as_it_comes_is_that_of_a_run_in_memory(
    case, tmp_path, monkeypatch
):
    asked = settings(**RUNS[case])
    expected = run_scenario(asked)
    assert len(expected.recording) < leglab.runs.run.BLOCK  # all at once
    monkeypatch.setattr(leglab.runs.run, "BLOCK", BLOCK)
    monkeypatch.setattr(leglab.runs.metrics, "_BLOCK", 333)
    path = tmp_path / "recording.parquet"
    made = record_scenario(asked, path)
    assert data.read(path) == expected.recording  # metadata, too
    assert made.recording == expected.recording
    assert list(made.recording.columns) == list(expected.recording.columns)
    assert figures(made) == figures(expected)
    assert made.configuration == expected.configuration
    assert [p.name for p in tmp_path.iterdir()] == ["recording.parquet"]
    # In memory, in blocks.
    again = run_scenario(asked)
    assert again.recording == expected.recording
    assert figures(again) == figures(expected)
    for name in ("position", "command", "encoder_shift", "encoder_lost", "error"):
        np.testing.assert_array_equal(getattr(again.history, name), getattr(expected.history, name))


@pytest.mark.parametrize("controller", ["pd", "bsnn_arx_pressure"])
def test_a_loop_in_blocks_goes_on_beyond_the_end_as_one_that_has_drawn_all_noise(controller):
    asked = settings(scenario="sensor_dropout", controller=controller, model="knee_bench")
    loops = [Loop(asked, kept=kept) for kept in (None, BLOCK)]
    for _ in range(2 * loops[0].count + BLOCK):
        whole, blocks = (loop.step() for loop in loops)
        for one, other in zip(whole.measurement, blocks.measurement, strict=True):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(whole.reference.position, blocks.reference.position)
    for loop in loops:
        loop.close()


def test_a_reference_that_cannot_be_followed_is_refused_before_the_run():
    asked = settings(model="knee_bench", reference="sine_sweep", duration=60.0)
    fast = {**asked.__dict__, "reference_config": {"end_frequency": 60.0}}
    with pytest.raises(LeglabError, match="reference 'sine_sweep': joint 'knee' moves at"):
        Loop(RunSettings(**fast), kept=500)


def test_a_run_that_is_interrupted_is_the_beginning_of_the_whole_one(tmp_path, monkeypatch):
    monkeypatch.setattr(leglab.runs.run, "BLOCK", BLOCK)
    asked = settings(scenario="sensor_dropout", model="leg_rail")
    whole = run_scenario(asked).recording

    def stop(now):
        if now > 1.0:
            os.kill(os.getpid(), signal.SIGINT)

    made = record_scenario(asked, tmp_path / "a.parquet", stop)
    assert made.record.failure.startswith("interrupted at 1.")
    part = data.read(tmp_path / "a.parquet")
    assert BLOCK < len(part) < len(whole)
    assert part.columns.keys() == whole.columns.keys()
    for name, samples in part.columns.items():
        np.testing.assert_array_equal(samples, whole[name][: len(part)], name)


class Blind:
    """A controller that begins to report late, and fails later."""

    def __init__(self, setup, fails):
        self._joints, self._fails, self._time = len(setup.joints), fails, 0.0

    def reset(self, measurement):
        pass

    def command(self, measurement, reference):
        self._time = measurement.time
        if self._time > self._fails:
            raise RuntimeError("no more")
        return np.zeros(self._joints)

    def diagnostics(self):
        if self._time < 0.5:
            return {"early": np.full(self._joints, 1.0)}
        return {"late": np.full(self._joints, self._time)}


@pytest.mark.parametrize("fails", [np.inf, 0.699])
def test_reports_that_begin_late_are_not_a_number_before_and_failures_keep_rows(
    fails, tmp_path, monkeypatch
):
    asked = settings(model="knee_bench", duration=1.0)
    monkeypatch.setattr("leglab.runs.loop.make_controller", lambda name, s, c: Blind(s, fails))
    expected = run_scenario(asked)
    monkeypatch.setattr(leglab.runs.run, "BLOCK", BLOCK)
    made = record_scenario(asked, tmp_path / "a.parquet")
    recording = data.read(tmp_path / "a.parquet")
    assert recording == expected.recording == made.recording
    late, early = recording["knee_late"], recording["knee_early"]
    assert np.isnan(late[:250]).all()
    np.testing.assert_array_equal(late[250:], recording.time[250:])
    np.testing.assert_array_equal(early[:250], 1.0)
    assert np.isnan(early[250:]).all()
    assert len(recording) == (501 if fails > 1 else 350)
    assert (made.record.failure is None) == (fails > 1)
    assert [p.name for p in tmp_path.iterdir()] == ["a.parquet"]


def test_a_run_that_blows_up_keeps_the_rows_before(tmp_path, monkeypatch):
    monkeypatch.setattr(leglab.runs.run, "BLOCK", BLOCK)
    asked = settings(model="knee_bench")
    loop = Loop(asked, kept=BLOCK)
    taken = []

    def disturb(rows):
        taken.append(len(rows.time))
        if len(taken) == 3:
            loop.simulation.data.qvel[:] = 1e6

    ending = loop.stream(disturb)
    assert "blew up" in ending.failure
    assert ending.rows == sum(taken) == 3 * BLOCK


def test_a_file_that_is_not_finished_does_not_take_its_place(tmp_path):
    path, columns = tmp_path / "a.parquet", {"time": np.arange(3.0), "x": np.arange(3.0)}

    def write(*blocks):
        with parquet.growing(path, lambda _: {}) as file:
            for block in blocks:
                file.append(block)

    with pytest.raises(TypeError):
        write(columns, None)
    with pytest.raises(LeglabError, match="column 'x' ends before"):
        write(columns, {"time": np.arange(3.0, 6.0)})
    with pytest.raises(LeglabError, match="at least one sample"):
        write()
    assert list(tmp_path.iterdir()) == []
    with parquet.growing(path, lambda names: {"names": list(names)}) as file:
        file.append(columns)
    content = path.read_bytes()
    assert data.read(path).metadata == {"names": ["x"]}
    for place in range(0, len(content), 7):
        damaged = bytearray(content)
        damaged[place] ^= 1
        path.write_bytes(damaged)
        try:
            found = data.read(path)
        except LeglabError:
            continue
        np.testing.assert_array_equal(found["x"], columns["x"])


@pytest.mark.slow("a killed process")
def test_a_killed_run_leaves_no_folder_and_the_next_one_clears_up(tmp_path):
    command = [sys.executable, "-m", "leglab", "run", "nominal", "--model", "knee_bench"]
    command += ["--no-figures", "--out", "a", "--duration"]
    process = subprocess.Popen([*command, "3000"], cwd=tmp_path, stderr=subprocess.DEVNULL)
    end = time.monotonic() + 120
    while not any(path.stat().st_size > 100_000 for path in tmp_path.rglob("*.parquet")):
        assert process.poll() is None
        assert time.monotonic() < end
        time.sleep(0.05)
    process.kill()
    process.wait()
    assert not (tmp_path / "a").exists()
    subprocess.run([*command, "1"], cwd=tmp_path, check=True, capture_output=True)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert json.loads((tmp_path / "a" / "metrics.json").read_text())["completed"]


MEMORY = """
import resource, sys
from pathlib import Path
from leglab.runs.preparation import RunSettings
from leglab.runs.run import record_scenario
for duration in (60.0, 260.0):
    asked = RunSettings(
        scenario="supply_drop", controller="pd", model="knee_bench", duration=duration
    )
    record_scenario(asked, Path("a.parquet"))
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3)
"""


@pytest.mark.slow("long runs")
def test_memory_hardly_grows_with_the_duration(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", MEMORY], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    short, long = map(float, done.stdout.split())
    # 100,000 rows more: 17 MB. A run that is kept in memory takes 41 MB for them.
    assert long - short < 25.0


def test_figures_of_a_stored_recording_are_those_of_one_in_memory(tmp_path):
    asked = settings(scenario="supply_drop", model="knee_bench", duration=44.0)  # with outlines
    made = record_scenario(asked, tmp_path / "a.parquet")
    phases = get_scenario("supply_drop", duration=44.0).phases
    for name, recording in (
        ("stored", made.recording),
        ("read", data.read(tmp_path / "a.parquet")),
    ):
        (tmp_path / name).mkdir()
        save_run_figures(recording, tmp_path / name, phases=phases, window=1.2)
    pictures = sorted(path.name for path in (tmp_path / "read").iterdir())
    assert len(pictures) == 4
    for name in pictures:
        stored, read = (tmp_path / place / name for place in ("stored", "read"))
        assert stored.read_bytes() == read.read_bytes()


def test_parts_of_long_series_are_those_of_all_at_once(monkeypatch):
    rng = np.random.default_rng(4)
    time, error = 0.002 * np.arange(5000), rng.normal(size=(5000, 3))
    expected = {span: sliding_rms(time, error, span) for span in (0.3, 1.0, 30.0)}
    values = np.where(rng.random(50_000) < 0.1, np.nan, rng.normal(size=50_000))
    monkeypatch.setattr(leglab.runs.metrics, "_BLOCK", 77)
    for span, windowed in expected.items():
        np.testing.assert_array_equal(sliding_rms(time, error, span), windowed)
        count = round(span / 0.002)
        if count <= len(time):
            last = np.sqrt(np.mean(error[-count:] ** 2))
            assert windowed[-1] == pytest.approx(last, rel=1e-12)
    found = set(outline(values).tolist())
    for place in range(0, 50_000, 5):
        piece = values[place : place + 5]
        if not np.isnan(piece).all():
            assert {place + np.nanargmin(piece), place + np.nanargmax(piece)} <= found


def test_filters_and_losses_go_on_from_block_to_block():
    rng, config = np.random.default_rng(1), SensorConfiguration()
    positions, lost = rng.normal(size=(50, 2)), rng.random(50) < 0.5
    parts = [slice(0, 1), slice(1, 20), slice(20, 50)]
    whole = VelocityFilter(config).of(positions)
    blocks = VelocityFilter(config)
    np.testing.assert_array_equal(
        whole, np.concatenate([blocks.of(positions[part]) for part in parts])
    )
    a = velocity_filter_coefficient(config.control_period, config.velocity_cutoff)
    by_hand = a / config.control_period * (positions[2] - positions[1]) + (1 - a) * whole[1]
    np.testing.assert_allclose(whole[2], by_hand, rtol=1e-12)
    before, found = None, []
    for part in parts:
        found.append(held(positions[part, 0], lost[part], before))
        before = float(found[-1][-1])
    np.testing.assert_array_equal(np.concatenate(found), held(positions[:, 0], lost))
    noise, other = np.random.default_rng(5), np.random.default_rng(5)
    noise.normal(size=20_001)
    skip_normal(other, 20_001)
    assert noise.random() == other.random()


def test_a_late_encoder_needs_its_last_samples_only():
    faults = EncoderFaults(offset=np.zeros(2), scale=np.ones(2), delay=np.array([0.0071, 0.0]))
    samples = np.random.default_rng(2).normal(size=(60, 2))
    ring = np.zeros((faults.needed(2e-3), 2))
    assert len(ring) == 6
    for last in range(60):
        ring[last % 6] = samples[last]
        np.testing.assert_array_equal(
            faults.seen(ring, last, 2e-3), faults.seen(samples, last, 2e-3)
        )
