"""A film small enough to travel inside a page, and a still of it."""

import subprocess
from collections.abc import Sequence
from pathlib import Path

from leglab.base.errors import LeglabError

# Share of the wanted size that is aimed at: one pass meets a bit rate roughly.
_AIM = 0.85
_ATTEMPTS = 3
# Greatest of the still [pixel]: as wide as a page shows it on most screens.
_STILL_WIDTH = 960


def film_bytes(film: Path, most: int) -> bytes:
    """The film, encoded anew with fewer bits where it is too large.

    Args:
        film: MP4 file.
        most: Size that it may have [byte].

    Raises:
        LeglabError: It cannot be read or encoded.
    """
    try:
        content = film.read_bytes()
    except OSError as error:
        raise LeglabError(f"{film}: cannot be read: {error.strerror}") from error
    if len(content) <= most:
        return content
    import imageio_ffmpeg

    _, seconds = imageio_ffmpeg.count_frames_and_secs(film)
    rate = _AIM * 8 * most / max(seconds, 1e-3)
    for _ in range(_ATTEMPTS):
        content = _encoded(film, round(rate))
        if len(content) <= most:
            break
        rate *= _AIM * most / len(content)
    return content


def still_bytes(film: Path) -> bytes:
    """One picture of the film, a JPEG from soon after its middle: seen before it is played.

    Args:
        film: MP4 file.

    Raises:
        LeglabError: It cannot be read.
    """
    import imageio_ffmpeg

    _, seconds = imageio_ffmpeg.count_frames_and_secs(film)
    return _made(
        film,
        f".{film.stem}.still.jpg",
        before=("-ss", f"{0.6 * seconds:.3f}"),
        after=("-frames:v", "1", "-vf", f"scale='min({_STILL_WIDTH},iw)':-2", "-q:v", "4"),
    )


def _encoded(film: Path, rate: int) -> bytes:
    coding = ("-an", "-c:v", "libx264", "-preset", "fast", "-pix_fmt", "yuv420p")
    rates = ("-b:v", str(rate), "-maxrate", str(2 * rate), "-bufsize", str(4 * rate))
    options = (*coding, *rates, "-movflags", "+faststart")
    return _made(film, f".{film.stem}.small.mp4", after=options)


def _made(film: Path, name: str, *, before: Sequence[str] = (), after: Sequence[str]) -> bytes:
    """What FFmpeg makes of the film, with options for reading and for writing."""
    import imageio_ffmpeg

    made = film.with_name(name)
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error"]
    command += [*before, "-i", str(film), *after, str(made)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
            raise LeglabError(f"{film}: cannot be encoded: {lines[-1]}")
        return made.read_bytes()
    except OSError as error:
        raise LeglabError(f"{film}: cannot be encoded: {error.strerror}") from error
    finally:
        made.unlink(missing_ok=True)
