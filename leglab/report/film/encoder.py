"""Encoding of films by ffmpeg: from raw frames, to fewer bytes, and to stills."""

import os
import re
import select
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from leglab.base.errors import FileError, LeglabError
from leglab.base.input import read_bytes
from leglab.base.output import cannot_write, new_file, regular_file

# Options of ffmpeg between the size of the raw frames and the path of a new film.
_NEW_FILM = (
    *("-i", "-", "-an", "-vf", "scale=out_color_matrix=bt709:out_range=tv"),
    *("-c:v", "libx264", "-preset", "veryfast", "-crf", "20", "-pix_fmt", "yuv420p"),
    *("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"),
    *("-color_range", "tv", "-threads", "1", "-fflags", "+bitexact"),
    *("-flags:v", "+bitexact", "-movflags", "+faststart"),
)
# The error line of ffmpeg with the earliest of these texts is reported; "" is in every line.
_TELLING = ("No space left", "Unknown encoder", "")
# Maximum time for which ffmpeg may accept no data, or may take to finish a new film [s].
_PATIENCE = 120.0
# Maximum time that ffmpeg may take to re-encode a film, or to extract a picture [s].
_PATIENCE_OF_A_FILM = 600.0
# Share of the allowed size that is aimed at, because a single pass meets a bit rate only roughly.
_AIM = 0.85
_ATTEMPTS = 3
_CODING = ("-an", "-c:v", "libx264", "-preset", "fast", "-pix_fmt", "yuv420p")
_STILL_WIDTH = 960  # maximum width of a still [px], with which most screens show a film on a page


@contextmanager
def encoding(out: Path, size: tuple[int, int], rate: int) -> Iterator[Callable[[bytes], None]]:
    """Writes a film to a temporary file and moves it into place when it is complete.

    The film is H.264 in yuv420p with the index at the front, so that browsers can play it before
    they have loaded it. A single thread encodes, so that equal frames give equal files.

    Args:
        out: Path of the film; its folder is made.
        size: Width and height [px].
        rate: Frames per second.

    Yields:
        A function that adds a frame: RGB bytes, row by row from the top.

    Raises:
        LeglabError: There is no ffmpeg, it cannot encode H.264 or takes no more frames, the file
            cannot be written or the disk is full.
    """
    program = _ffmpeg()
    raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "{}x{}".format(*size), "-r", str(rate))
    command = [program, "-hide_banner", "-loglevel", "error", "-y", *raw, *_NEW_FILM]
    with new_file(out) as partial, tempfile.TemporaryFile() as log:
        try:
            process = subprocess.Popen(
                [*command, str(partial)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=log,
            )
        except OSError as error:
            text = f"{program} cannot be run: {error.strerror}"
            raise LeglabError(text, given=program) from error
        assert process.stdin is not None
        pipe = process.stdin.fileno()
        os.set_blocking(pipe, False)

        def write(frame: bytes) -> None:
            try:
                _write(pipe, frame)
            except OSError:
                process.wait(_PATIENCE)
                raise _failure(out, log) from None

        try:
            yield write
            process.stdin.close()
            status = process.wait(_PATIENCE)
            if status or _said(log) or not partial.stat().st_size:
                raise _failure(out, log)
        except subprocess.TimeoutExpired:
            text = f"{out}: cannot be encoded: ffmpeg took nothing for {_PATIENCE:g} s"
            raise FileError(text, given=out) from None
        finally:
            process.kill()
            process.wait()
            process.stdin.close()


def _write(pipe: int, frame: bytes) -> None:
    """Writes a frame to a pipe of ffmpeg, which does not block; raises if it takes no data."""
    left = memoryview(frame)
    while left:
        _, ready, _ = select.select([], [pipe], [], _PATIENCE)
        if not ready:
            raise subprocess.TimeoutExpired("ffmpeg", _PATIENCE)
        left = left[os.write(pipe, left) :]


def _said(log: BinaryIO) -> str:
    log.seek(0)
    lines = log.read().decode(errors="replace").splitlines()
    return next((line.strip() for word in _TELLING for line in lines if word in line), "")


def _failure(out: Path, log: BinaryIO) -> LeglabError:
    said = _said(log)
    if "Unknown encoder" in said:
        return LeglabError(
            "this ffmpeg cannot encode H.264 (it has no libx264); unset IMAGEIO_FFMPEG_EXE "
            "to use the one that comes with imageio-ffmpeg"
        )
    text = f"{out}: cannot be encoded: {said or 'ffmpeg wrote nothing'}"
    if "No space left" in said:
        text = f"{out}: cannot be written: no space left on the disk"
    return FileError(text, given=out)


def check_film(path: Path) -> None:
    """Raises an error if a film at this path would replace a file that is no film.

    Raises:
        LeglabError: The name does not end with .mp4, or the path holds a file that is no film.
    """
    if path.suffix.lower() != ".mp4":
        text = f"{path}: a film needs a name that ends with "
        raise FileError(text, given=path, allowed=".mp4")
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
    """Returns the bytes of a film, re-encoded if the film has more than `most` bytes.

    Raises:
        LeglabError: The film cannot be read or encoded.
    """
    content = read_bytes(film)
    if len(content) <= most:
        return content
    rate = _AIM * 8 * most / max(_seconds(film), 1e-3)
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
    """Returns a JPEG picture from 60 % of the film, which a page shows until the film is played.

    Raises:
        LeglabError: The film cannot be read.
    """
    before = ("-ss", f"{0.6 * _seconds(film):.3f}")
    after = ("-frames:v", "1", "-vf", f"scale='min({_STILL_WIDTH},iw)':-2", "-q:v", "4")
    return _made(film, f".{film.stem}.still.jpg", before=before, after=after)


def _made(film: Path, name: str, *, before: Sequence[str] = (), after: Sequence[str]) -> bytes:
    """Returns the bytes that ffmpeg makes from a film, with options for input and output."""
    made = film.with_name(name)
    try:
        _ask(film, before=before, after=(*after, str(made)))
        return made.read_bytes()
    except OSError as error:
        raise FileError(f"{film}: cannot be encoded: {error.strerror}", given=film) from error
    finally:
        made.unlink(missing_ok=True)


def _seconds(film: Path) -> float:
    """Returns the length of a film [s]."""
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
        text = f"{film}: cannot be encoded: ffmpeg took more than {_PATIENCE_OF_A_FILM:g} s"
        raise FileError(text, given=film) from None
    except OSError as error:
        raise FileError(f"{film}: cannot be encoded: {error.strerror}", given=film) from error
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        raise FileError(f"{film}: cannot be encoded: {lines[-1]}", given=film)
    return done.stdout
