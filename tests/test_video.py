"""Films of runs: what is there, and what is said where no OpenGL library is."""

import subprocess

import imageio_ffmpeg
import numpy as np
import pytest

from leglab.errors import LeglabError
from leglab.report import video
from leglab.report.run_folder import write_run
from leglab.runner import RunSettings, run_scenario


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    run = run_scenario(
        RunSettings(scenario="seal_wear", controller="pd", model="knee_bench", duration=4.0)
    )
    return write_run(run, tmp_path_factory.mktemp("runs") / "run", figures=False)


def test_a_film_shows_the_run(folder, tmp_path):
    shares = []
    try:
        path = video.render_run(
            folder, tmp_path / "film.mp4", start=1.9, duration=0.4, progress=shares.append
        )
    except LeglabError as error:
        if "no OpenGL library" in str(error):
            pytest.skip(str(error))
        raise
    assert shares[-1] == 1.0
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    frames = [np.frombuffer(frame, np.uint8).reshape(720, 1280, 3).astype(int) for frame in reader]
    assert meta["size"] == (1280, 720)
    assert meta["codec"] == "h264"
    assert len(frames) == 12
    assert np.abs(frames[-1] - frames[0]).max() > 50  # the shank moves
    red = (frames[-1][..., 0] > 150) & (frames[-1][..., 1:].max(axis=-1) < 90)
    assert red.sum() > 100  # the change is marked
    assert [entry.name for entry in tmp_path.iterdir()] == ["film.mp4"]


def test_a_missing_library_is_said_with_the_line_that_installs_it(folder, tmp_path, monkeypatch):
    real = subprocess.Popen

    def without_libraries(command, env, **options):
        return real(
            command, env={**env, "MUJOCO_GL": "egl", "PYOPENGL_PLATFORM": "osmesa"}, **options
        )

    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(video.subprocess, "Popen", without_libraries)
    with pytest.raises(LeglabError, match="no OpenGL library.*apt-get install -y libegl1"):
        video.render_run(folder, tmp_path / "film.mp4")
    assert not list(tmp_path.iterdir())


def test_a_start_outside_the_run_is_refused(folder, tmp_path):
    with pytest.raises(LeglabError, match=r"start = 9 s; allowed.*0 to 4 s|no OpenGL"):
        video.render_run(folder, tmp_path / "film.mp4", start=9.0)
