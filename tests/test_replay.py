"""Measured commands drive the knee bench from measured states over 0.3 s windows."""

from pathlib import Path

import numpy as np
import pytest

from leglab.base.errors import LeglabError
from leglab.studies.verification.bench import KneeBench, nominal_folder, read_recording, reconstruct
from leglab.studies.verification.replay import LIMITS, Recording, replay

WALK = Path(__file__).parent / "data" / "knee_bench_walk.parquet"  # 3 s of nominal/walk


def nominal(name):
    try:
        return read_recording(nominal_folder() / f"{name}.parquet")
    except LeglabError as error:
        pytest.skip(str(error))


def stored_walk():
    recording = read_recording(WALK)
    return Recording(**{**vars(recording), "name": "walk"})


@pytest.mark.parametrize("timestep", [0.5e-3, 1e-3])
def test_three_stored_seconds_replay_within_the_limits(timestep):
    tiling, overlapping = replay(stored_walk(), timestep)
    knee, pressure = LIMITS["walk"]
    for result in (tiling, overlapping):
        assert result.position < knee
        assert max(result.pressure_a, result.pressure_b) < pressure
    assert tiling.passed
    assert tiling.count == 10


@pytest.mark.parametrize("timestep", [0.5e-3, 1e-3])
@pytest.mark.parametrize("name", LIMITS)
def test_nominal_recordings_replay_within_the_limits(name, timestep):
    tiling, overlapping = replay(nominal(name), timestep)
    knee, pressure = LIMITS[name]
    assert tiling.position < knee
    assert max(tiling.pressure_a, tiling.pressure_b) < pressure
    # Windows that start in vapour are ill-posed: no sensor tells how much of it there is.
    assert overlapping.position_without_vapour < knee
    assert (len(overlapping.vapour) > 0) == (name == "steps")


def test_a_worn_seal_does_not_replay_as_nominal():
    """The errors are small because the physics is right, not because windows are short."""
    recording = stored_walk()
    rig = KneeBench(1e-3)
    starts = reconstruct(recording, rig)
    nominal_end = rig.run(starts, recording.command, 300)
    worn_end = rig.run(starts, recording.command, 300, seal_clearance=10 ** (1 / 3))
    assert abs(nominal_end[0] - starts.position[600]) < 0.3e-3
    assert abs(worn_end[0] - starts.position[600]) > 1e-3


def test_reconstruction_follows_the_command_and_the_speed():
    recording = stored_walk()
    rig = KneeBench(1e-3)
    starts = reconstruct(recording, rig)
    later = slice(50, None)
    assert np.abs(starts.spool[later, 0] - recording.command[later]).max() < 0.2
    assert np.abs(starts.bristle).max() <= 150.0 / 2e6 * (1 + 1e-9)
    v = starts.velocity
    fast = np.abs(v) > 0.5
    lever = rig.lever(starts.position)
    assert np.all(np.sign(starts.bristle[1:][fast[:-1]]) == np.sign((v * lever)[:-1][fast[:-1]]))
