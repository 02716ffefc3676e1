"""Single frames of a run: the machine at a time, with what is happening written over it."""

import json
from pathlib import Path

import mujoco
import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from leglab import data, metrics
from leglab.recording import Recording
from leglab.simulation import Simulation, load_model

_INK, _SOFT, _ALARM, _TRACE = (28, 32, 38), (110, 118, 128), (196, 58, 28), (0, 98, 155)
_STRIP = 176  # height of the error strip below the picture [px]


class RunFrames:
    """Draws frames of the folder of a run. Needs an OpenGL context; close it after use.

    Args:
        folder: Folder of a run.
        camera: Name of a camera of the model; the free camera if it has none of this name.
        size: Width and height [px].
    """

    def __init__(self, folder: Path, *, camera: str, size: tuple[int, int]) -> None:
        run = json.loads((folder / "run.json").read_text())
        self._recording = data.read(folder / "recording.parquet")
        settings = run["settings"]
        self._simulation = Simulation(load_model(settings["model"]))
        model = self._simulation.model
        width, height = size
        self._renderer = mujoco.Renderer(model, height - _STRIP, width)
        names = [model.camera(i).name for i in range(model.ncam)]
        self._camera = camera if camera in names else -1
        self._title = f"{settings['scenario']} · {settings['controller']}"
        self._changes = run["changes"]
        self._window = run["window"]
        self._size = size
        face = font_manager.findfont("DejaVu Sans")
        self._large, self._small = (ImageFont.truetype(face, points) for points in (26, 17))
        self._prepare_strip()

    @property
    def start(self) -> float:
        """First time of the run [s]."""
        return float(self._recording.time[0])

    @property
    def end(self) -> float:
        """Last time of the run [s]."""
        return float(self._recording.time[-1])

    def close(self) -> None:
        """Frees the OpenGL context."""
        self._renderer.close()

    def draw(self, time: float) -> np.ndarray:
        """The frame at a time [s], (height, width, 3) uint8."""
        self._place(time)
        self._renderer.update_scene(self._simulation.data, self._camera)
        image = Image.new("RGB", self._size, (255, 255, 255))
        image.paste(Image.fromarray(self._renderer.render()))
        self._write(image, time)
        return np.asarray(image)

    def _place(self, time: float) -> None:
        simulation, recording = self._simulation, self._recording
        row = int(np.clip(np.searchsorted(recording.time, time), 0, len(recording) - 1))
        model, state = simulation.model, simulation.data
        names = [model.joint(i).name for i in range(model.njnt)]
        for i, name in enumerate(names):
            if f"{name}_truth" in recording:
                state.qpos[model.jnt_qposadr[i]] = recording[f"{name}_truth"][row]
        simulation.set_pressures(
            *(
                np.array(
                    [max(recording[f"{joint}_{name}"][row], 0.0) for joint in simulation.joints]
                )
                for name in ("pressure_a", "pressure_b")
            )
        )
        mujoco.mj_forward(model, state)

    def _prepare_strip(self) -> None:
        recording = self._recording
        error = _errors(recording, self._simulation.joints)
        self._windowed = metrics.sliding_rms(recording.time, error, self._window)
        finite = self._windowed[np.isfinite(self._windowed)]
        self._top = float(finite.max(initial=0.0)) or 1.0

    def _write(self, image: Image.Image, time: float) -> None:
        width, height = self._size
        draw = ImageDraw.Draw(image, "RGBA")
        draw.text((28, 22), self._title, font=self._large, fill=_INK)
        draw.text((28, 58), f"{time:6.2f} s", font=self._small, fill=_SOFT)
        for change in self._changes:
            if time >= change["start"]:
                verb = "x" if change["kind"] == "scale" else "="
                text = f"{change['parameter'].replace('_', ' ')} {verb} {change['value']:g}"
                draw.text((120, 58), text, font=self._small, fill=_ALARM)
        top, bottom = height - _STRIP + 52, height - 22
        label = f"RMS tracking error of all joints over {self._window:g} s"
        draw.text((28, top - 40), label, font=self._small, fill=_SOFT)
        value = self._windowed[max(int(np.searchsorted(self._recording.time, time)) - 1, 0)]
        if np.isfinite(value):
            text = f"{1e3 * value:.1f} mrad"
            draw.text((width - 28, top - 40), text, font=self._small, fill=_TRACE, anchor="ra")
        times = self._recording.time
        left, right = 28, width - 28
        span = self.end - self.start

        def at(t: float) -> float:
            return left + (right - left) * (t - self.start) / span

        for change in self._changes:
            x = at(change["start"])
            draw.line((x, top, x, bottom), fill=_ALARM, width=2)
        draw.line((left, bottom, right, bottom), fill=_SOFT, width=1)
        rows = np.flatnonzero((times <= time) & np.isfinite(self._windowed))[::5]
        points = [
            (at(times[i]), bottom - (bottom - top) * 0.95 * self._windowed[i] / self._top)
            for i in rows
        ]
        if len(points) > 1:
            draw.line(points, fill=_TRACE, width=3, joint="curve")


def _errors(recording: Recording, joints: tuple[str, ...]) -> np.ndarray:
    return np.stack(
        [recording[f"{joint}_truth"] - recording[f"{joint}_reference"] for joint in joints], axis=1
    )
