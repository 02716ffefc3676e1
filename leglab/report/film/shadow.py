"""A soft patch on the floor below the foot: real shadows are half the time of a frame."""

import mujoco
import numpy as np

from leglab.report.film.framing import moving_geoms

_DISCS = 6
_INK = (0.10, 0.11, 0.13, 0.07)


class FloorShadow:
    """Flat discs below the largest part of the last body; none where the model has no floor.

    Args:
        model: The machine.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
        moving = moving_geoms(model)
        self._floor: float | None = None
        if len(planes) and len(moving):
            last = moving[model.geom_bodyid[moving] == model.geom_bodyid[moving].max()]
            self._part = int(last[np.argmax(model.geom_rbound[last])])
            self._box = model.geom_aabb[self._part]
            self._floor = float(model.geom_pos[planes[0], 2])

    def draw(self, scene: mujoco.MjvScene, data: mujoco.MjData) -> None:
        """Adds the discs to a scene; the higher the part, the wider they are."""
        if self._floor is None:
            return
        point, turn, radii = self._place(data)
        for i in range(min(_DISCS, scene.maxgeom - scene.ngeom)):
            size = np.array([*(radii * (0.6 + 0.9 * i / _DISCS)), 1e-4])
            point[2] = self._floor + 0.0005 * (i + 1)
            geom = scene.geoms[scene.ngeom]
            shape = mujoco.mjtGeom.mjGEOM_ELLIPSOID
            mujoco.mjv_initGeom(geom, shape, size, point, turn, np.array(_INK, np.float32))
            geom.specular = geom.reflectance = 0.0
            scene.ngeom += 1

    def corners(self, data: mujoco.MjData) -> np.ndarray:
        """Points around the discs [m], (n, 3)."""
        if self._floor is None:
            return np.empty((0, 3))
        point, turn, radii = self._place(data)
        ring = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
        spread = 1.5 * radii[:, None] * np.array([np.cos(ring), np.sin(ring)])
        point[2] = self._floor
        return point + (turn.reshape(3, 3)[:, :2] @ spread).T

    def _place(self, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Point below the part, rotation of the discs and their half axes [m]."""
        turn = data.geom_xmat[self._part].reshape(3, 3)
        point = data.geom_xpos[self._part] + turn @ self._box[:3]
        # The longest horizontal axis of the part's box, and how far the part reaches beside it.
        reach = turn[:2] * self._box[3:]
        longest = reach[:, int(np.argmax(np.hypot(*reach)))]
        angle = float(np.arctan2(longest[1], longest[0]))
        along = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-along[1], along[0]])
        radii = np.array([np.abs(axis @ reach).sum() for axis in (along, across)])
        radii *= 0.8 + 0.4 * max(point[2] - self._floor, 0.0)
        rotation = np.array([[*along, 0.0], [*across, 0.0], [0.0, 0.0, 1.0]]).T
        return point.copy(), rotation.ravel(), radii
