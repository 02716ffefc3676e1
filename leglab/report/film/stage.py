"""The machine of one run as a picture: its pose, a ghost at the reference, pressures in colour."""

import mujoco
import numpy as np
from PIL import Image

from leglab.report.film import framing
from leglab.report.film.cylinders import CylinderShapes
from leglab.report.film.look import GHOST
from leglab.report.film.track import Track
from leglab.simulation import Simulation, load_model

# Rendered this many times larger and averaged: finer edges than multisampling, in less time.
_SUPERSAMPLING = 2
# Parts of a ghost that are smaller than this are left out [m].
_SMALL_PART = 0.05
# A ghost is moved away from the camera by this share of its distance, so that it does not flicker
# on the surface of a leg that is where it should be.
_GHOST_SHIFT = 0.003
_SPRING, _SHADOW = (0.88, 0.33, 0.06, 1.0), (0.10, 0.11, 0.13, 0.10)
_MAX_GEOMS = 4000
_HIDDEN_GROUP = 5


class Machine:
    """A model with what is needed to draw it; runs of one model share it.

    Args:
        model: Name or path, as `load_model` takes it.
        size: Width and height of the picture [px].
    """

    def __init__(self, model: str, size: tuple[int, int]) -> None:
        self.model = load_model(model)
        self.simulation = Simulation(self.model)
        width, height = (_SUPERSAMPLING * n for n in size)
        view, quality = self.model.vis.global_, self.model.vis.quality
        view.offwidth, view.offheight = max(width, view.offwidth), max(height, view.offheight)
        view.fovy = framing.FIELD_OF_VIEW
        quality.offsamples = 0
        self.cylinders = CylinderShapes(self.simulation)
        for i in range(self.model.ntendon):
            if self.model.tendon(i).name not in self.cylinders.tendons:
                self.model.tendon_width[i] *= 2.0
                self.model.tendon_rgba[i] = _SPRING
        self.ghost = load_model(model)
        _make_ghost(self.ghost)
        self.renderer = mujoco.Renderer(self.model, height, width, max_geom=_MAX_GEOMS)
        # Shadows and mirrors are most of the time of a frame in software.
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self.renderer.scene.flags[flag] = 0
        self._option, self._perturbation = mujoco.MjvOption(), mujoco.MjvPerturb()
        names = {self.model.joint(i).name: i for i in range(self.model.njnt)}
        self._addresses = {name: int(self.model.jnt_qposadr[i]) for name, i in names.items()}
        self._floor, self._foot, self._foot_size = _floor_and_foot(self.model)

    def close(self) -> None:
        """Frees the OpenGL context."""
        self.renderer.close()

    def pose(self, data: mujoco.MjData, track: Track, time: float, suffixes: list[str]) -> None:
        """Moves all joints to where the run had them.

        Args:
            data: Of this model.
            track: The run.
            time: [s].
            suffixes: Of the columns to take, the first that is there.
        """
        row = track.row(time)
        for joint, address in self._addresses.items():
            values = track.column(*(f"{joint}_{suffix}" for suffix in suffixes))
            if values is not None and np.isfinite(values[row]):
                data.qpos[address] = values[row]
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        mujoco.mj_camlight(self.model, data)
        mujoco.mj_tendon(self.model, data)

    def draw(
        self,
        data: mujoco.MjData,
        reference: mujoco.MjData,
        camera: mujoco.MjvCamera,
        pressures: np.ndarray,
    ) -> Image.Image:
        """The picture, of the size of the machine.

        Args:
            data: The true pose.
            reference: The pose of the ghost.
            camera: Where from.
            pressures: Of both sides of each cylinder over the end of the colour bar, NaN where
                unknown, (actuators, 2).
        """
        scene, option, pert = self.renderer.scene, self._option, self._perturbation
        every = int(mujoco.mjtCatBit.mjCAT_ALL)
        dynamic = int(mujoco.mjtCatBit.mjCAT_DYNAMIC)
        scene.ngeom = 0
        mujoco.mjv_updateCamera(self.model, data, camera, scene)
        # Not mjv_updateScene: the plugins would add hundreds of shapes of their own.
        mujoco.mjv_addGeoms(self.model, data, option, pert, every, scene)
        self.cylinders.draw(scene, data, pressures)
        self._draw_shadow(scene, data)
        first = scene.ngeom
        mujoco.mjv_addGeoms(self.ghost, reference, option, pert, dynamic, scene)
        eye = np.mean([eye.pos for eye in scene.camera], axis=0)
        for geom in scene.geoms[first : scene.ngeom]:
            geom.pos[:] += _GHOST_SHIFT * (geom.pos - eye)
        mujoco.mjv_makeLights(self.model, data, scene)
        image = Image.fromarray(self.renderer.render())
        return image.reduce(_SUPERSAMPLING)

    def _draw_shadow(self, scene: mujoco.MjvScene, data: mujoco.MjData) -> None:
        """Soft discs on the floor below the last body, darker as it comes nearer."""
        if self._floor is None or scene.ngeom + 4 > scene.maxgeom:
            return
        point = data.geom_xpos[self._foot].copy()
        height = max(point[2] - self._floor, 0.0)
        spread = self._foot_size * (0.75 + 0.5 * height)
        forward = data.geom_xmat[self._foot].reshape(3, 3)
        long_axis = forward[:2, int(np.argmax(self.model.geom_aabb[self._foot][3:]))]
        angle = float(np.arctan2(long_axis[1], long_axis[0])) if np.any(long_axis) else 0.0
        turn = np.array(
            [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]]
        )
        for i in range(4):
            radius = spread * (0.55 + 0.2 * i)
            point[2] = self._floor + 0.0005 * (i + 1)
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(
                geom,
                mujoco.mjtGeom.mjGEOM_ELLIPSOID,
                np.array([radius, 0.6 * radius, 1e-4]),
                point,
                turn.ravel(),
                np.array(_SHADOW, np.float32),
            )
            geom.specular = geom.reflectance = 0.0
            scene.ngeom += 1


class Stage:
    """One run on its machine, seen by a camera that stands still.

    Args:
        machine: Of the model of the run.
        track: The run.
        scale: Pressure at the end of the colour bar [Pa].
    """

    def __init__(self, machine: Machine, track: Track, scale: float) -> None:
        self._machine, self._track, self._scale = machine, track, scale
        self._data = mujoco.MjData(machine.model)
        self._reference = mujoco.MjData(machine.model)
        for data in (self._data, self._reference):
            mujoco.mj_copyData(data, machine.model, machine.simulation.data)
        self._pressures = [
            [track.column(f"{joint}_pressure_{side}") for side in "ab"]
            for joint in machine.simulation.joints
        ]
        self.camera = mujoco.MjvCamera()

    def place(self, time: float) -> None:
        """Moves the machine and its ghost to a time [s]."""
        track, machine = self._track, self._machine
        machine.pose(self._data, track, time, ["truth", "position"])
        # Joints without a reference, such as a rail, stay where they truly are.
        machine.pose(self._reference, track, time, ["reference", "truth", "position"])

    def extent(self, times: np.ndarray) -> np.ndarray:
        """Corners of all that moves at these times [s], ghost included, (n, 3) [m]."""
        geoms = framing.moving_geoms(self._machine.model)
        found = []
        for time in times:
            self.place(float(time))
            for data in (self._data, self._reference):
                found.append(framing.corners(self._machine.model, data, geoms))
        return np.concatenate(found)

    def direction(self, camera: str) -> framing.Direction:
        """Where a camera of the model looks."""
        return framing.direction(self._machine.model, self._data, camera)

    def draw(self, time: float) -> Image.Image:
        """The machine at a time [s]."""
        self.place(time)
        row = self._track.row(time)
        levels = [
            [np.nan if side is None else side[row] / self._scale for side in sides]
            for sides in self._pressures
        ]
        return self._machine.draw(self._data, self._reference, self.camera, np.array(levels))


def _make_ghost(model: mujoco.MjModel) -> None:
    """Leaves the large moving parts, see-through and of one colour."""
    kept = np.zeros(model.ngeom, dtype=bool)
    kept[framing.moving_geoms(model)] = True
    kept &= model.geom_rbound > _SMALL_PART
    model.geom_group[~kept] = _HIDDEN_GROUP
    model.geom_matid[:] = -1
    model.geom_rgba[:] = GHOST
    model.tendon_rgba[:, 3] = 0.0


def _floor_and_foot(model: mujoco.MjModel) -> tuple[float | None, int, float]:
    """Height of the floor [m], and the largest part of the last body with its half length [m]."""
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    moving = framing.moving_geoms(model)
    if not len(planes) or not len(moving):
        return None, 0, 0.0
    last = moving[model.geom_bodyid[moving] == model.geom_bodyid[moving].max()]
    foot = int(last[np.argmax(model.geom_rbound[last])])
    return float(model.geom_pos[planes[0], 2]), foot, float(model.geom_aabb[foot][3:].max())
