"""A whole frame: panels, what is written into them, and traces below."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from leglab.report.film import framing, layout
from leglab.report.film.look import PAPER, RUNS
from leglab.report.film.machine import Machine
from leglab.report.film.overlay import PanelWriter, draw_clock, draw_title, title_of
from leglab.report.film.stage import Stage
from leglab.report.film.traces import CommandTrace, ErrorTrace
from leglab.report.film.track import details, load_track

_POSES = 24  # looked at to find what has to be in the picture
_BAR_STEP = 20e5  # the colour bar ends at a multiple of this [Pa]


class Picture:
    """Draws the frames of a film. Needs an OpenGL context; close it after use.

    Args:
        folders: Of the runs, side by side.
        span: First and last time of the film [s].
        camera: Name of a camera of the models.

    Raises:
        LeglabError: A run, a model or a camera is missing or damaged.
    """

    def __init__(self, folders: Sequence[Path], span: tuple[float, float], camera: str) -> None:
        tracks = [load_track(folder) for folder in folders]
        names, colors = [str(t.settings["controller"]) for t in tracks], RUNS[: len(tracks)]
        self._panels = layout.panels(len(tracks))
        size = (self._panels[0].width, self._panels[0].height)
        supplies = [track.column("supply_pressure") for track in tracks]
        highest = max((float(np.nanmax(s)) for s in supplies if s is not None), default=160e5)
        scale = _BAR_STEP * np.ceil(highest / _BAR_STEP - 0.05)
        self._machines: dict[str, Machine] = {}
        for track in tracks:
            name = str(track.settings["model"])
            if name not in self._machines:
                self._machines[name] = Machine(name, size)
        machines = [self._machines[str(track.settings["model"])] for track in tracks]
        self._stages = [Stage(m, t, scale) for m, t in zip(machines, tracks, strict=True)]
        self._frame(machines, np.linspace(*span, _POSES), camera, size)
        left, right = layout.traces()
        self._error = ErrorTrace(tracks, colors, left, span)
        self._command = CommandTrace(tracks, colors, names, right, span)
        self._writers = [
            PanelWriter(*row, scale)
            for row in zip(
                tracks, details(tracks), colors, self._panels, self._error.errors, strict=True
            )
        ]
        self._base = Image.new("RGB", layout.SIZE, PAPER)
        draw_title(self._base, *title_of(tracks), scale)
        self._error.draw_static(self._base)
        self._command.draw_static(self._base)

    def close(self) -> None:
        """Frees the OpenGL contexts."""
        for machine in self._machines.values():
            machine.close()

    def draw(self, time: float) -> Image.Image:
        """The frame at a time [s], RGB."""
        image = self._base.copy()
        for stage, writer, panel in zip(self._stages, self._writers, self._panels, strict=True):
            image.paste(stage.draw(time), (panel.left, panel.top))
            writer.draw(image, time)
        self._error.draw(image, time)
        self._command.draw(image, time)
        draw_clock(image, time)
        return image

    def _frame(
        self, machines: list[Machine], times: np.ndarray, camera: str, size: tuple[int, int]
    ) -> None:
        """Gives runs of one model the same camera, so that they can be compared."""
        for machine in self._machines.values():
            stages = [s for s, m in zip(self._stages, machines, strict=True) if m is machine]
            points = np.concatenate([stage.extent(times) for stage in stages])
            region = layout.leg_region(self._panels[0])
            view = stages[0].direction(camera)
            machine.look(framing.frame(points, view, size[0] / size[1], region))
