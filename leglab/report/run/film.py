"""A film small enough to travel inside a page."""

import subprocess
from pathlib import Path

from leglab.errors import LeglabError

# Share of the wanted size that is aimed at: one pass meets a bit rate roughly.
_AIM = 0.85
_ATTEMPTS = 3


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


def _encoded(film: Path, rate: int) -> bytes:
    import imageio_ffmpeg

    small = film.with_name(f".{film.stem}.small.mp4")
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", "-i", str(film)]
    command += ["-an", "-c:v", "libx264", "-preset", "fast", "-pix_fmt", "yuv420p"]
    command += ["-b:v", str(rate), "-maxrate", str(2 * rate), "-bufsize", str(4 * rate)]
    command += ["-movflags", "+faststart", str(small)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
            raise LeglabError(f"{film}: cannot be encoded: {lines[-1]}")
        return small.read_bytes()
    except OSError as error:
        raise LeglabError(f"{film}: cannot be encoded: {error.strerror}") from error
    finally:
        small.unlink(missing_ok=True)
