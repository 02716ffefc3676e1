"""Processes that draw frames in parallel; the frames are returned in order.

A process writes raw RGB frames to standard output, and the reason of a failure to standard error.
"""

import contextlib
import fcntl
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

from leglab.base import plugins
from leglab.base.errors import LeglabError
from leglab.report.film.look import SIZE

_FRAME_SIZE = 3 * SIZE[0] * SIZE[1]  # bytes of a frame
_PIPE = 1 << 20  # size of the pipe from a process [bytes]
_LEAST_FRAMES = 20  # minimum frames per process: for fewer, starting it takes longer than it saves
_ERROR_MARK = "leglab-error: "  # prefix of the line on standard error with the message for the user
_NO_OPENGL = "no OpenGL library"
# Code that a process runs. `python -m` would load this module twice.
_CODE = "from leglab.report.film.workers import work; work()"


class NoOpenGLError(LeglabError):
    """The requested OpenGL library is missing or does not work."""


def worker_count(frames: int) -> int:
    """Returns the number of processes: one per core, at most 16, fewer for short films."""
    return max(1, min(len(os.sched_getaffinity(0)), frames // _LEAST_FRAMES, 16))


def draw_frames(job: dict[str, Any], *, backend: str, count: int) -> Iterator[bytes]:
    """Draws the frames of a job.

    Args:
        job: `folders`, `camera`, `start` and `last` time of the film [s], number of `frames`, and
            `rate` [frames per second].
        backend: MuJoCo's OpenGL library, "egl" or "osmesa".
        count: Number of processes.

    Yields:
        The frames in order, RGB.

    Raises:
        NoOpenGLError: The library is missing or does not work.
        LeglabError: A run cannot be shown, or a process failed.
    """
    # One thread per process, because the processes together already use all cores.
    quiet = {"OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "0", **os.environ, "MUJOCO_GL": backend}
    job = {**job, "plugins": plugins.carried(), "step": count}
    workers = [_Worker({**job, "first": i}, quiet) for i in range(count)]
    try:
        for i in range(job["frames"]):
            yield workers[i % count].next_frame()
    finally:
        for worker in workers:
            worker.close()


class _Worker:
    def __init__(self, job: dict[str, Any], env: dict[str, str]) -> None:
        self._log = tempfile.TemporaryFile()  # noqa: SIM115
        self._process = subprocess.Popen(
            # -P: modules are imported from where they are installed, not from the working folder.
            [sys.executable, "-P", "-c", _CODE, json.dumps(job)],
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._log,
        )
        assert self._process.stdout is not None
        self._frames = self._process.stdout
        with contextlib.suppress(OSError, AttributeError):  # Linux only, within its limit
            fcntl.fcntl(self._frames.fileno(), fcntl.F_SETPIPE_SZ, _PIPE)

    def next_frame(self) -> bytes:
        frame = self._frames.read(_FRAME_SIZE)
        if len(frame) < _FRAME_SIZE:
            self._process.wait()
            raise self._failure()
        return frame

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        self._frames.close()
        self._log.close()

    def _failure(self) -> LeglabError:
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        for line in lines:
            if line.startswith(_ERROR_MARK):
                text = line.removeprefix(_ERROR_MARK)
                return NoOpenGLError(text) if text.startswith(_NO_OPENGL) else LeglabError(text)
        last = lines[-1] if lines else f"exit status {self._process.returncode}"
        return LeglabError(f"rendering failed: {last}")


def work() -> NoReturn:
    """Draws every `step`-th frame of the job in the first argument, then ends the process."""
    status = 0
    try:
        _draw(json.loads(sys.argv[1]))
    except LeglabError as problem:
        print(f"{_ERROR_MARK}{problem}", file=sys.stderr, flush=True)
        status = 2
    except (BrokenPipeError, KeyboardInterrupt):
        status = 3
    sys.stderr.flush()
    os._exit(status)  # some OpenGL libraries fail again while Python shuts down


def _draw(job: dict[str, Any]) -> None:
    # Standard output goes to standard error, so that no library prints between the frames.
    frames = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    _open_gl()
    plugins.carry(job["plugins"])
    from leglab.report.film.picture import Picture

    span = (job["start"], job["last"])
    picture = Picture([Path(folder) for folder in job["folders"]], span, job["camera"])
    with contextlib.closing(picture), frames:
        for i in range(job["first"], job["frames"], job["step"]):
            frames.write(picture.draw(job["start"] + i / job["rate"]).tobytes())
            frames.flush()


def _open_gl() -> None:
    """Opens and closes an OpenGL context, so that a missing library fails before any rendering."""
    try:
        import mujoco

        context = mujoco.GLContext(16, 16)
        context.make_current()
        context.free()
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise LeglabError(f"{_NO_OPENGL} for {os.environ['MUJOCO_GL']} ({reason})") from error
