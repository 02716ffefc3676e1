"""Films of runs: what is in the picture, and what is said where one cannot be made."""

import imageio_ffmpeg
import numpy as np
import pytest

from leglab.errors import LeglabError
from leglab.report.film import render_film
from leglab.report.run_folder import write_run
from leglab.runner import RunSettings, run_scenario


def decoded(path):
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    frames = [np.frombuffer(frame, np.uint8).reshape(720, 1280, 3).astype(int) for frame in reader]
    return meta, frames


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    run = run_scenario(
        RunSettings(scenario="seal_wear", controller="pd", model="knee_bench", duration=4.0)
    )
    return write_run(run, tmp_path_factory.mktemp("runs") / "run", figures=False)


def test_a_film_shows_the_run(folder, tmp_path):
    shares = []
    path = render_film(
        [folder], tmp_path / "film.mp4", start=1.9, duration=0.4, progress=shares.append
    )
    assert shares[-1] == 1.0
    meta, frames = decoded(path)
    assert meta["size"] == (1280, 720)
    assert meta["codec"] == "h264"
    assert len(frames) == 12
    assert np.abs(frames[-1] - frames[0])[100:450].max() > 50  # the shank moves
    assert [entry.name for entry in tmp_path.iterdir()] == ["film.mp4"]


def test_a_start_outside_the_run_is_refused(folder, tmp_path):
    with pytest.raises(LeglabError, match=r"start = 9 s; allowed.*0 to 4 s"):
        render_film([folder], tmp_path / "film.mp4", start=9.0)
