"""A process that draws some of the frames: `python -m leglab.report.film.worker JOB`.

Writes raw RGB frames to standard output and, where it fails, why to standard error.
"""

import contextlib
import json
import os
import sys
from pathlib import Path

from leglab.base.errors import LeglabError

# Begins the line on standard error that is meant for the user.
ERROR_MARK = "leglab-error: "
NO_OPENGL = "no OpenGL library"


def main() -> None:
    """Draws every `step`-th frame of the job from `first` on."""
    job = json.loads(sys.argv[1])
    # Whatever a library prints must not end up between the frames.
    frames = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    _open_gl()
    from leglab.report.film.picture import Picture

    span = (job["start"], job["last"])
    picture = Picture([Path(folder) for folder in job["folders"]], span, job["camera"])
    with contextlib.closing(picture), frames:
        for i in range(job["first"], job["frames"], job["step"]):
            frames.write(picture.draw(job["start"] + i / job["rate"]).tobytes())
            frames.flush()


def _open_gl() -> None:
    """Makes a context at once: a missing library shows here, not in the middle."""
    try:
        import mujoco

        context = mujoco.GLContext(16, 16)
        context.make_current()
        context.free()
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise LeglabError(f"{NO_OPENGL} for {os.environ['MUJOCO_GL']} ({reason})") from error


if __name__ == "__main__":
    try:
        main()
    except LeglabError as problem:
        print(f"{ERROR_MARK}{problem}", file=sys.stderr, flush=True)
        os._exit(2)  # some OpenGL libraries fail once more when Python tidies up
    except (BrokenPipeError, KeyboardInterrupt):
        os._exit(3)
    sys.stderr.flush()
    os._exit(0)
