"""A run as a film: the machine rendered offscreen, encoded as H.264."""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from leglab.errors import LeglabError

FRAME_RATE = 30
SIZE = (1280, 720)
BACKENDS = ("egl", "osmesa")
INSTALL_LINE = "sudo apt-get install -y libegl1 libgl1-mesa-dri"

Progress = Callable[[float], None]


def render_run(
    folder: Path,
    out: Path,
    *,
    start: float | None = None,
    duration: float | None = None,
    camera: str = "three_quarter",
    progress: Progress | None = None,
) -> Path:
    """Renders the folder of a run to an MP4 file.

    MuJoCo chooses its OpenGL library when it is imported, so the rendering runs in a process of
    its own: with EGL, or with OSMesa where EGL is missing.

    Args:
        folder: Folder of a run.
        out: The film, replaced as a whole.
        start: First second shown; None for the beginning.
        duration: Seconds shown; None for all that follow.
        camera: Name of a camera of the model.
        progress: Called with the share that is done.

    Raises:
        LeglabError: If the folder is no run, or no OpenGL library is there; the message holds the
            line that installs one.
    """
    for name in ("run.json", "recording.parquet"):
        if not (folder / name).exists():
            raise LeglabError(f"{str(folder)!r} is not the folder of a run: it has no {name}")
    chosen = os.environ.get("MUJOCO_GL")
    backends = (chosen,) if chosen in BACKENDS else BACKENDS
    partial = out.with_name(f".{out.name}.partial.mp4")
    job = {
        "folder": str(folder),
        "out": str(partial),
        "start": start,
        "duration": duration,
        "camera": camera,
    }
    message = ""
    try:
        for backend in backends:
            message = _render_in_process(backend, job, progress)
            if not message:
                os.replace(partial, out)
                return out
            if not message.startswith("no OpenGL"):
                raise LeglabError(message)
    finally:
        partial.unlink(missing_ok=True)
    raise LeglabError(f"{message}; install one with: {INSTALL_LINE}")


def _render_in_process(backend: str, job: dict, progress: Progress | None) -> str:
    """Runs this module as a script; returns why it failed, empty if it did not."""
    process = subprocess.Popen(
        [sys.executable, "-m", "leglab.report.video", json.dumps(job)],
        env={**os.environ, "MUJOCO_GL": backend},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    failure = ""
    try:
        for line in process.stdout:
            kind, _, text = line.strip().partition(" ")
            if kind == "progress" and progress:
                progress(float(text))
            elif kind == "error":
                failure = text
        _, errors = process.communicate()
    except BaseException:
        process.kill()
        raise
    if process.returncode and not failure:
        last = errors.strip().splitlines()[-1:] or [f"exit status {process.returncode}"]
        failure = f"rendering failed: {last[0]}"
    return failure


def _render(job: dict) -> None:
    try:
        # The context is made at once: a missing library shows here, not in the middle.
        import mujoco

        context = mujoco.GLContext(16, 16)
        context.make_current()
        context.free()
    except Exception as error:
        backend = os.environ["MUJOCO_GL"]
        raise LeglabError(
            f"no OpenGL library for {backend} ({error})".replace("\n", " ")
        ) from error

    import imageio_ffmpeg

    from leglab.report.frames import RunFrames

    frames = RunFrames(Path(job["folder"]), camera=job["camera"], size=SIZE)
    first = frames.start if job["start"] is None else job["start"]
    last = frames.end if job["duration"] is None else min(first + job["duration"], frames.end)
    if not frames.start <= first < last:
        raise LeglabError(
            f"start = {first:g} s; allowed: within the run, {frames.start:g} to {frames.end:g} s"
        )
    times = np.arange(first, last, 1.0 / FRAME_RATE)
    writer = imageio_ffmpeg.write_frames(
        job["out"],
        SIZE,
        fps=FRAME_RATE,
        codec="libx264",
        quality=None,
        macro_block_size=8,
        output_params=["-crf", "20", "-preset", "fast", "-movflags", "+faststart"],
    )
    writer.send(None)
    with contextlib.closing(writer), contextlib.closing(frames):
        for i, time in enumerate(times):
            writer.send(np.ascontiguousarray(frames.draw(float(time))))
            print(f"progress {(i + 1) / len(times):.4f}", flush=True)


if __name__ == "__main__":
    try:
        _render(json.loads(sys.argv[1]))
    except LeglabError as problem:
        print(f"error {problem}", flush=True)
        sys.exit(2)
