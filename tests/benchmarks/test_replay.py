"""Measured commands drive the knee bench from measured states over 0.3 s windows."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.measured import shared_data
from benchmarks.verification.replay import LIMITS, replay
from leglab.data import read
from leglab.diagnosis.replay.starts import bristle, spool
from tests.helpers.measured import or_skip

WALK = Path(__file__).parents[1] / "data" / "knee_bench_walk.parquet"  # 3 s of nominal/walk


@pytest.mark.parametrize("timestep", [0.5e-3, 1e-3])
def test_three_stored_seconds_replay_within_the_limits(timestep):
    result = replay("walk", read(WALK), timestep)
    knee, pressure = LIMITS["walk"]
    assert result.position < knee
    assert max(result.pressure_a, result.pressure_b) < pressure
    assert result.passed
    assert result.count >= 25


@pytest.mark.parametrize("timestep", [0.5e-3, 1e-3])
@pytest.mark.parametrize("name", LIMITS)
def test_nominal_recordings_replay_within_the_limits(name, timestep):
    recording = read(or_skip(shared_data, f"knee_bench/nominal/{name}.parquet"))
    result = replay(name, recording, timestep)
    knee, pressure = LIMITS[name]
    assert result.position < knee
    assert max(result.pressure_a, result.pressure_b) < pressure
    assert result.count > 110  # of 117; in `steps` some would start in vapour


def test_a_worn_seal_does_not_replay_as_nominal():
    """The errors are small because the physics is right, not because windows are short."""
    recording, clearance = read(WALK), ("knee_valve", "seal_clearance")
    assert replay("walk", recording, 1e-3).position < 0.3e-3
    worn = replay("walk", recording, 1e-3, {clearance: 10 ** (1 / 3)})
    assert worn.position > 1e-3
    assert not worn.passed


def test_reconstruction_follows_the_command_and_the_speed():
    recording = read(WALK)
    command = recording["knee_valve_command"]
    position = spool(command, 2 * np.pi * 250.0, 0.7, 1e-3)[:, 0]
    assert np.abs(position[50:] - command[50:]).max() < 0.2
    v = 0.03 * np.gradient(recording["knee_position"], 1e-3)  # m/s, by a lever of 30 mm
    level, stiffness = 100.0 + 50.0 * np.exp(-((v / 0.014) ** 2)), 2e6
    deflection = bristle(v, level, stiffness, 1e-3)[1:]
    assert np.abs(deflection).max() <= 150.0 / 2e6 * (1 + 1e-9)
    fast = np.abs(v[:-1]) > 0.015
    assert np.all(np.sign(deflection[fast]) == np.sign(v[:-1][fast]))
