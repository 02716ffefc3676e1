"""Rendering of films from the folders of runs."""

import contextlib
import os
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from leglab.base.errors import LeglabError, SettingsError
from leglab.report.film.encoder import check_film, encoding
from leglab.report.film.framing import DEFAULT_CAMERA
from leglab.report.film.look import MAX_RUNS, SIZE
from leglab.report.film.track import Track, load_track
from leglab.report.film.workers import NoOpenGLError, draw_frames, worker_count

FRAME_RATE = 30
BACKENDS = ("egl", "osmesa")
INSTALL_LINE = "sudo apt-get install -y libegl1 libgl1-mesa-dri"


def render_film(
    folders: Sequence[Path],
    out: Path,
    *,
    start: float | None = None,
    duration: float | None = None,
    camera: str = DEFAULT_CAMERA,
    progress: Callable[[float], None] | None = None,
) -> Path:
    """Renders runs side by side to an MP4 file: H.264, 1280 x 720, 30 frames per second.

    MuJoCo chooses its OpenGL library when it is imported, so rendering runs in separate processes:
    with EGL, or with OSMesa if EGL is missing; the variable `MUJOCO_GL` can select one of the two.
    Equal folders give equal frames.

    Args:
        folders: Folders of one to four runs; models, scenarios and lengths may differ.
        out: Path of the film; an earlier film is replaced when the new one is complete.
        start: Time at which the film starts [s]; None for the beginning of the runs.
        duration: Duration of the film [s]; None for up to the end of the runs.
        camera: Name of a camera of the models.
        progress: Function called with the share of frames that are done.

    Returns:
        `out`.

    Raises:
        LeglabError: A folder is no run, the span lies outside the runs, an OpenGL library or the
            encoder is missing (the message has the command that installs it), or the film cannot
            be written.
    """
    folders, out = [Path(folder) for folder in folders], Path(out)
    if not 1 <= len(folders) <= MAX_RUNS:
        text = f"{len(folders)} runs side by side; allowed: "
        raise SettingsError(text, given=len(folders), allowed=f"1 to {MAX_RUNS}")
    check_film(out)
    first, last = _span([load_track(folder) for folder in folders], start, duration)
    count = max(round((last - first) * FRAME_RATE), 1)
    job = {
        "folders": [str(folder) for folder in folders],
        "start": first,
        "frames": count,
        "rate": FRAME_RATE,
        "last": last,
        "camera": camera,
    }
    frames = _frames(job)
    # The first frame is drawn before any file is written: if it fails, an old film stays.
    head = next(frames)
    with contextlib.closing(frames), encoding(out, SIZE, FRAME_RATE) as write:
        write(head)
        for i, frame in enumerate(frames, start=2):
            write(frame)
            if progress:
                progress(i / count)
        if progress:
            progress(1.0)
    return out


def _frames(job: dict[str, Any]) -> Generator[bytes, None, None]:
    chosen = os.environ.get("MUJOCO_GL", "").lower()
    reasons = []
    for backend in (chosen,) if chosen in BACKENDS else BACKENDS:
        try:
            yield from draw_frames(job, backend=backend, count=worker_count(job["frames"]))
            return
        except NoOpenGLError as error:
            reasons.append(str(error))
    raise LeglabError(f"{'; '.join(reasons)}; install one with: {INSTALL_LINE}")


def _span(
    tracks: Sequence[Track], start: float | None, duration: float | None
) -> tuple[float, float]:
    """Returns first and last time of the film [s], up to 2 s beyond a run that stopped early."""
    earliest = min(track.start for track in tracks)
    latest = max(track.end for track in tracks)
    # The film is longer if a run stopped early, for viewers to read the text that reports it.
    if any(track.stopped and track.end > latest - 1.0 for track in tracks):
        latest = min(latest + 2.0, max(track.planned_end for track in tracks))
    first = earliest if start is None else start
    if duration is not None and not (duration > 0 and np.isfinite(duration)):
        text = f"duration = {duration:g} s; allowed: "
        raise SettingsError(text, given=duration, allowed="more than 0")
    if not earliest <= first < latest:
        allowed = f"within the runs, {earliest:g} to {latest:g} s"
        raise SettingsError(f"start = {first:g} s; allowed: ", given=first, allowed=allowed)
    return first, latest if duration is None else min(first + duration, latest)
