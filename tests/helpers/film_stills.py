"""Draws frames for the tests, where OpenGL is: `python -m tests.helpers.film_stills JOB OUT`.

A process of its own, because MuJoCo chooses its OpenGL library when it is imported.
"""

import contextlib
import json
import os
import sys
from pathlib import Path

import numpy as np


def main() -> None:
    from leglab.report.film.picture import Picture

    jobs = json.loads(sys.argv[1])
    frames = {}
    for name, (folders, span, times) in jobs.items():
        paths = [Path(folder) for folder in folders]
        with contextlib.closing(Picture(paths, tuple(span), "three_quarter")) as picture:
            frames[name] = np.stack([np.asarray(picture.draw(time)) for time in times])
    np.savez(sys.argv[2], **frames)


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    os._exit(0)  # some OpenGL libraries fail once more when Python tidies up
