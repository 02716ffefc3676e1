"""One run on its machine: where everything is at a time."""

import mujoco
import numpy as np
from PIL import Image

from leglab.report.film import framing
from leglab.report.film.machine import Machine
from leglab.report.film.track import Track


class Stage:
    """One run on its machine.

    Args:
        machine: Of the model of the run.
        track: The run.
        scale: Pressure at the end of the colour bar [Pa].
    """

    def __init__(self, machine: Machine, track: Track, scale: float) -> None:
        self._machine, self._track = machine, track
        model = machine.model
        self._data, self._reference = mujoco.MjData(model), mujoco.MjData(model)
        for data in (self._data, self._reference):
            mujoco.mj_copyData(data, model, machine.simulation.data)
        # Joints without a reference, such as a rail, stay where they truly are in the ghost too.
        self._truth = self._columns("truth", "position")
        self._wanted = self._columns("reference", "truth", "position")
        sides = [
            track.column(f"{joint}_pressure_{side}")
            for joint in machine.simulation.joints
            for side in "ab"
        ]
        unknown = np.full(len(track.recording), np.nan)
        self._levels = np.stack([unknown if s is None else s / scale for s in sides], axis=1)

    def place(self, time: float) -> None:
        """Moves the machine and its ghost to a time [s]."""
        row = self._track.row(time)
        for data, columns in ((self._data, self._truth), (self._reference, self._wanted)):
            for address, values in columns:
                if np.isfinite(values[row]):
                    data.qpos[address] = values[row]
            for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):
                compute(self._machine.model, data)
            mujoco.mj_tendon(self._machine.model, data)

    def extent(self, times: np.ndarray) -> np.ndarray:
        """Points around machine and ghost at these times [s], (n, 3) [m]."""
        found = []
        for time in times:
            self.place(float(time))
            found += [self._machine.outline(data) for data in (self._data, self._reference)]
        return np.concatenate(found)

    def direction(self, camera: str) -> framing.Direction:
        """Where a camera of the model looks."""
        return framing.direction(self._machine.model, self._data, camera)

    def draw(self, time: float) -> Image.Image:
        """The machine at a time [s]."""
        self.place(time)
        levels = self._levels[self._track.row(time)].reshape(-1, 2)
        return self._machine.draw(self._data, self._reference, levels)

    def _columns(self, *suffixes: str) -> list[tuple[int, np.ndarray]]:
        """Place in qpos and samples of every joint that was recorded."""
        model, found = self._machine.model, []
        for i in range(model.njnt):
            name = model.joint(i).name
            values = self._track.column(*(f"{name}_{suffix}" for suffix in suffixes))
            if values is not None:
                found.append((int(model.jnt_qposadr[i]), values))
        return found
