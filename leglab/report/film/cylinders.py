"""Cylinders whose two chambers show their pressures."""

import mujoco
import numpy as np

from leglab.machine.simulation import Simulation
from leglab.report.film.look import UNKNOWN, pressure_color

# Cylinders are drawn wider than they are, for their colours to be seen in a small picture.
_WIDER = 1.5
_WALL = 0.0035  # m
# Half of a colour glows and half is lit, so that it looks as in the colour bar, and still round.
_GLOW, _LIT = 0.9, 0.55
_CAP, _CHROME = (0.14, 0.15, 0.17), (0.92, 0.93, 0.95)
_ORIGIN, _UPRIGHT = np.zeros(3), np.eye(3).ravel()
_BASE, _END = 0.012, 0.012  # length of the ends of a barrel [m]


class CylinderShapes:
    """Barrels split at the piston: the cap side and the rod side each in its own colour.

    Cylinders that act on a joint directly have no place to be drawn, and are not.

    Args:
        simulation: The machine.

    Attributes:
        tendons: Names of the tendons that are cylinders.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._model = model = simulation.model
        self._tendon: list[int] = []
        for i in range(model.nu):
            is_tendon = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_TENDON
            self._tendon.append(int(model.actuator_trnid[i, 0]) if is_tendon else -1)
        self._parameters = [simulation.cylinder_parameters(name) for name in simulation.actuators]
        self.tendons = {model.tendon(i).name for i in self._tendon if i >= 0}

    def pins(self, data: mujoco.MjData) -> np.ndarray:
        """Ends of all tendons, cylinders and springs [m], (n, 3)."""
        used = data.ten_wrapnum > 0
        first = data.ten_wrapadr[used]
        last = first + data.ten_wrapnum[used] - 1
        return data.wrap_xpos.reshape(-1, 3)[np.concatenate([first, last])]

    def draw(self, scene: mujoco.MjvScene, data: mujoco.MjData, levels: np.ndarray) -> None:
        """Adds the cylinders to a scene.

        Args:
            scene: Where to.
            data: With tendons computed.
            levels: Pressures of cap and rod side over the end of the colour bar, NaN where unknown,
                (actuators, 2).
        """
        known = ~np.isnan(levels)[..., None]
        colours = _LIT * np.where(known, pressure_color(np.nan_to_num(levels)), UNKNOWN)
        points = data.wrap_xpos.reshape(-1, 3)
        for tendon, parameters, (cap, rod) in zip(
            self._tendon, self._parameters, colours, strict=True
        ):
            if tendon < 0 or data.ten_wrapnum[tendon] < 2:
                continue
            first = int(data.ten_wrapadr[tendon])
            base, end = points[first], points[first + data.ten_wrapnum[tendon] - 1]
            length = float(np.linalg.norm(end - base))
            stroke = parameters["stroke"]
            barrel = stroke + 0.02
            position = 0.5 * stroke + data.ten_length[tendon] - parameters["mid_length"]
            share = float(np.clip(position / stroke, 0.02, 0.98))
            piston = _BASE + share * (barrel - _BASE - _END)
            radius = _WIDER * (0.5 * parameters["bore"] + _WALL)
            axis = (end - base) / max(length, 1e-9)
            for start, stop, size, colour, glow in (
                (0.0, _BASE, radius + 0.001, _CAP, 0.0),
                (_BASE, piston, radius, cap, _GLOW),
                (piston - 0.0015, piston + 0.0015, radius + 0.0008, _CAP, 0.0),
                (piston, barrel - _END, radius, rod, _GLOW),
                (barrel - _END, barrel, radius + 0.001, _CAP, 0.0),
                (barrel, length, 0.6 * parameters["rod"], _CHROME, 0.1),
            ):
                _segment(scene, base + start * axis, base + stop * axis, size, colour, glow)


def _segment(
    scene: mujoco.MjvScene,
    start: np.ndarray,
    stop: np.ndarray,
    radius: float,
    colour: np.ndarray | tuple[float, float, float],
    glow: float,
) -> None:
    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    shape = mujoco.mjtGeom.mjGEOM_CYLINDER
    rgba = np.array([*colour, 1.0], np.float32)
    mujoco.mjv_initGeom(geom, shape, _ORIGIN, _ORIGIN, _UPRIGHT, rgba)
    mujoco.mjv_connector(geom, shape, radius, start, stop)
    geom.emission, geom.specular, geom.shininess = glow, 0.3, 0.3
    scene.ngeom += 1
