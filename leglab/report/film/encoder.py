"""Films from raw frames, smaller films, and stills, all made by ffmpeg."""

import contextlib
import os
import re
import subprocess
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from leglab.base.errors import FileError, LeglabError
from leglab.base.output import cannot_write, new_file, regular_file

# What explains a failure best comes first; ffmpeg is told to print nothing but errors.
_TELLING = ("No space left", "Unknown encoder", "")
# Longest time that ffmpeg may take for a frame, or for its end [s].
_PATIENCE = 120.0
# Longest time that it may take to encode a film anew, or for a picture of it [s].
_PATIENCE_OF_A_FILM = 600.0
# Share of the wanted size that is aimed at: one pass meets a bit rate roughly.
_AIM = 0.85
_ATTEMPTS = 3
_CODING = ("-an", "-c:v", "libx264", "-preset", "fast", "-pix_fmt", "yuv420p")
_STILL_WIDTH = 960  # at most [px]: as wide as a page shows a film on most screens


class Encoder:
    """Writes a film beside its place and moves it there when it is whole.

    H.264 in yuv420p with its index at the front: any browser starts to play it at once. One thread,
    so that the same frames give the same file.

    Args:
        out: The film; its folder is made.
        size: Width and height [px].
        rate: Frames a second.

    Raises:
        LeglabError: There is no ffmpeg, it cannot encode H.264, or the file cannot be written.
    """

    def __init__(self, out: Path, size: tuple[int, int], rate: int) -> None:
        program = _ffmpeg()
        check_film(out)
        self._out = out
        width, height = size
        command = [
            *(program, "-hide_banner", "-loglevel", "error", "-y"),
            *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(rate)),
            *("-i", "-", "-an", "-vf", "scale=out_color_matrix=bt709:out_range=tv"),
            *("-c:v", "libx264", "-preset", "veryfast", "-crf", "20", "-pix_fmt", "yuv420p"),
            *("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"),
            *("-color_range", "tv", "-threads", "1", "-fflags", "+bitexact"),
            *("-flags:v", "+bitexact", "-movflags", "+faststart"),
        ]
        with contextlib.ExitStack() as stack:
            self._partial = stack.enter_context(new_file(out))
            self._log = stack.enter_context(tempfile.TemporaryFile())
            try:
                self._process = subprocess.Popen(
                    [*command, str(self._partial)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    stderr=self._log,
                )
            except OSError as error:
                told = f"{program} cannot be run: {error.strerror}"
                raise LeglabError(told, given=program) from error
            self._patience = stack.enter_context(_Patience(self._process))
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def write(self, frame: bytes | bytearray) -> None:
        """Adds a frame, RGB, row by row from the top.

        Raises:
            LeglabError: The encoder stopped, because the disk is full, for instance.
        """
        assert self._process.stdin is not None
        self._patience.begin_anew()
        try:
            self._process.stdin.write(frame)
        except OSError:
            self._process.wait()
            raise self._failure() from None

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        reason = error
        try:
            if error is not None:
                self._process.kill()
            self._patience.begin_anew()
            with contextlib.suppress(OSError):
                assert self._process.stdin is not None
                self._process.stdin.close()
            status = self._process.wait()
            if error is None and (status or self._said() or not self._partial.stat().st_size):
                raise self._failure()
        except BaseException as failure:
            reason = failure
            raise
        finally:  # The film takes its place where there is no reason against it.
            self._stack.__exit__(type(reason) if reason else None, reason, trace)

    def _said(self) -> str:
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").splitlines()
        return next((line.strip() for word in _TELLING for line in lines if word in line), "")

    def _failure(self) -> LeglabError:
        said = self._said()
        if self._patience.ended:
            said = f"ffmpeg took nothing for {_PATIENCE:g} s"
        elif "No space left" in said:
            told = f"{self._out}: cannot be written: no space left on the disk"
            return FileError(told, given=self._out)
        elif "Unknown encoder" in said:
            return LeglabError(
                "this ffmpeg cannot encode H.264 (it has no libx264); unset IMAGEIO_FFMPEG_EXE "
                "to use the one that comes with imageio-ffmpeg"
            )
        told = f"{self._out}: cannot be encoded: {said or 'ffmpeg wrote nothing'}"
        return FileError(told, given=self._out)


class _Patience:
    """Ends a process that takes nothing for too long: a pipe that is full waits for ever."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self._over = threading.Event()
        self.ended = False
        self.begin_anew()
        self._watch = threading.Thread(target=self._wait, daemon=True)

    def begin_anew(self) -> None:
        self._last = time.monotonic() + _PATIENCE

    def __enter__(self) -> Self:
        self._watch.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._watch.join()

    def _wait(self) -> None:
        while (left := self._last - time.monotonic()) > 0:
            if self._over.wait(left):
                return
        self.ended = True
        self._process.kill()


def check_film(path: Path) -> None:
    """Refuses a place where a film would replace something else, before any work is done.

    Raises:
        LeglabError: The name does not end with .mp4, or a file stands there that is no film.
    """
    if path.suffix.lower() != ".mp4":
        told = f"{path}: a film needs a name that ends with "
        raise FileError(told, given=path, allowed=".mp4")
    try:
        with regular_file(path).open("rb") as stream:
            head = stream.read(8)
    except FileNotFoundError:
        return
    except OSError as error:
        raise cannot_write(path, error) from error
    if head and head[4:] != b"ftyp":
        raise FileError(f"{path}: is no film: it is left as it is", given=path)


def _ffmpeg() -> str:
    try:
        import imageio_ffmpeg

        path = imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        path = ""
    if not path or not os.access(path, os.X_OK):
        raise LeglabError(
            "no ffmpeg; install one with: pip install --force-reinstall imageio-ffmpeg"
        )
    return path


def film_bytes(film: Path, most: int) -> bytes:
    """The film, encoded anew with fewer bits where it has more than `most` bytes.

    Raises:
        LeglabError: It cannot be read or encoded.
    """
    try:
        content = film.read_bytes()
    except OSError as error:
        raise FileError(f"{film}: cannot be read: {error.strerror}", given=film) from error
    if len(content) <= most:
        return content
    seconds = _seconds(film)
    rate = _AIM * 8 * most / max(seconds, 1e-3)
    for _ in range(_ATTEMPTS):
        bits = round(rate)
        rates = ("-b:v", f"{bits}", "-maxrate", f"{2 * bits}", "-bufsize", f"{4 * bits}")
        options = (*_CODING, *rates, "-movflags", "+faststart")
        content = _made(film, f".{film.stem}.small.mp4", after=options)
        if len(content) <= most:
            break
        rate *= _AIM * most / len(content)
    return content


def still_bytes(film: Path) -> bytes:
    """One picture of the film, a JPEG from soon after its middle: seen before it is played.

    Raises:
        LeglabError: It cannot be read.
    """
    seconds = _seconds(film)
    return _made(
        film,
        f".{film.stem}.still.jpg",
        before=("-ss", f"{0.6 * seconds:.3f}"),
        after=("-frames:v", "1", "-vf", f"scale='min({_STILL_WIDTH},iw)':-2", "-q:v", "4"),
    )


def _made(film: Path, name: str, *, before: Sequence[str] = (), after: Sequence[str]) -> bytes:
    """Makes a file from a film by ffmpeg, with options for reading and writing, and reads it."""
    made = film.with_name(name)
    try:
        _ask(film, before=before, after=(*after, str(made)))
        return made.read_bytes()
    except OSError as error:
        raise FileError(f"{film}: cannot be encoded: {error.strerror}", given=film) from error
    finally:
        made.unlink(missing_ok=True)


def _seconds(film: Path) -> float:
    """Length of a film."""
    told = _ask(film, after=("-c", "copy", "-f", "null", "-progress", "pipe:1", "-"))
    times = re.findall(r"^out_time_us=(\d+)$", told, flags=re.MULTILINE)
    return 1e-6 * int(times[-1]) if times else 0.0


def _ask(film: Path, *, before: Sequence[str] = (), after: Sequence[str]) -> str:
    """Runs ffmpeg on a film, with options for reading and for writing; returns what it printed."""
    command = [_ffmpeg(), "-y", "-loglevel", "error", *before, "-i", str(film), *after]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, timeout=_PATIENCE_OF_A_FILM
        )
    except subprocess.TimeoutExpired:
        told = f"{film}: cannot be encoded: ffmpeg took more than {_PATIENCE_OF_A_FILM:g} s"
        raise FileError(told, given=film) from None
    except OSError as error:
        raise FileError(f"{film}: cannot be encoded: {error.strerror}", given=film) from error
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        raise FileError(f"{film}: cannot be encoded: {lines[-1]}", given=film)
    return done.stdout
