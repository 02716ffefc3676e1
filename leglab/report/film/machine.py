"""A model as a picture: its pose, a ghost at the reference, pressures in colour."""

import math

import mujoco
import numpy as np
from PIL import Image

from leglab.machine.simulation import Simulation, load_model
from leglab.report.film import framing
from leglab.report.film.cylinders import CylinderShapes
from leglab.report.film.look import GHOST
from leglab.report.film.shadow import FloorShadow

# Rendered half again as large and averaged; twice as large takes an eighth longer and looks alike.
_SUPERSAMPLING = 1.5
# Parts of a ghost that are smaller than this are left out [m].
_SMALL_PART = 0.05
# A ghost is moved away from the camera by this share of its distance, so that it does not flicker
# on the surface of a leg that is where it should be.
_GHOST_SHIFT = 0.003
_SPRING = (0.88, 0.33, 0.06, 1.0)
_MAX_GEOMS = 4000
_HIDDEN_GROUP = 5
_FLIP, _AVERAGE = Image.Transpose.FLIP_TOP_BOTTOM, Image.Resampling.HAMMING


class Machine:
    """A model with what is needed to draw it; runs of one model share it.

    What cannot move is drawn once. After that only the part of the picture in which the machine is
    at the time is rendered: in software pixels take the time, and a leg is narrow.

    Args:
        model: Name or path, as `load_model` takes it.
        size: Width and height of the picture [px].
    """

    def __init__(self, model: str, size: tuple[int, int]) -> None:
        self.model = load_model(model)
        self.simulation = Simulation(self.model)
        self.cylinders = CylinderShapes(self.simulation)
        self.shadow = FloorShadow(self.model)
        self._size = size
        width, height = _larger(size)
        view = self.model.vis.global_
        view.offwidth, view.offheight = width, height
        view.fovy = framing.FIELD_OF_VIEW
        self.model.vis.quality.offsamples = 0
        for i in range(self.model.ntendon):
            if self.model.tendon(i).name not in self.cylinders.tendons:
                self.model.tendon_width[i] *= 2.0
                self.model.tendon_rgba[i] = _SPRING
        self._ghost = load_model(model)
        _make_ghost(self._ghost)
        self._option, self._perturbation = mujoco.MjvOption(), mujoco.MjvPerturb()
        self._fixed_lights = not _lights_move(self.model)
        self._moving = framing.moving_geoms(self.model)
        self._scene = mujoco.MjvScene(self.model, _MAX_GEOMS)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[flag] = 0
        self._gl = mujoco.GLContext(width, height)
        self._gl.make_current()
        self._context = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)

    def look(self, camera: mujoco.MjvCamera) -> None:
        """Chooses the view, and draws what stands still."""
        self._camera = camera
        self._whole = framing.Crop(0, 0, *self._size)
        data = self.simulation.data
        self._start_scene(data, self._whole, mujoco.mjtCatBit.mjCAT_STATIC)
        self._background = self._render(data, self._whole)

    def close(self) -> None:
        """Frees the OpenGL context."""
        self._gl.make_current()
        self._context.free()
        self._gl.free()

    def outline(self, data: mujoco.MjData) -> np.ndarray:
        """Points around all that moves, but for its shadow [m], (n, 3)."""
        corners = framing.corners(self.model, data, self._moving)
        return np.concatenate([corners, self.cylinders.pins(data)])

    def draw(
        self, data: mujoco.MjData, reference: mujoco.MjData, pressures: np.ndarray
    ) -> Image.Image:
        """The picture.

        Args:
            data: The true pose, as `pose` leaves it.
            reference: The pose of the ghost.
            pressures: Of both sides of each cylinder over the end of the colour bar, NaN where
                unknown, (actuators, 2).
        """
        crop = self._whole
        if self._fixed_lights:
            parts = self.outline(data), self.outline(reference), self.shadow.corners(data)
            crop = framing.crop(np.concatenate(parts), self._camera, self._size)
        scene = self._start_scene(data, crop, mujoco.mjtCatBit.mjCAT_ALL)
        self.cylinders.draw(scene, data, pressures)
        self.shadow.draw(scene, data)
        self._add_ghost(scene, reference)
        picture = self._background.copy()
        picture.paste(self._render(data, crop), (crop.left, crop.top))
        return picture

    def _start_scene(
        self, data: mujoco.MjData, crop: framing.Crop, categories: mujoco.mjtCatBit
    ) -> mujoco.MjvScene:
        scene = self._scene
        scene.ngeom = 0
        mujoco.mjv_updateCamera(self.model, data, self._camera, scene)
        crop.apply(scene, self._size)
        # Not mjv_updateScene: the plugins would add hundreds of shapes of their own.
        mujoco.mjv_addGeoms(
            self.model, data, self._option, self._perturbation, int(categories), scene
        )
        return scene

    def _add_ghost(self, scene: mujoco.MjvScene, reference: mujoco.MjData) -> None:
        first = scene.ngeom
        moving = int(mujoco.mjtCatBit.mjCAT_DYNAMIC)
        mujoco.mjv_addGeoms(self._ghost, reference, self._option, self._perturbation, moving, scene)
        eye = np.mean([eye.pos for eye in scene.camera], axis=0)
        for geom in scene.geoms[first : scene.ngeom]:
            geom.pos[:] += _GHOST_SHIFT * (geom.pos - eye)

    def _render(self, data: mujoco.MjData, crop: framing.Crop) -> Image.Image:
        mujoco.mjv_makeLights(self.model, data, self._scene)
        width, height = _larger(crop.size)
        place = mujoco.MjrRect(0, 0, width, height)
        pixels = np.empty((height, width, 3), np.uint8)
        self._gl.make_current()
        mujoco.mjr_render(place, self._scene, self._context)
        mujoco.mjr_readPixels(pixels, None, place, self._context)
        # OpenGL counts rows from below.
        return Image.fromarray(pixels).transpose(_FLIP).resize(crop.size, _AVERAGE)


def _larger(size: tuple[int, int]) -> tuple[int, int]:
    width, height = (math.ceil(_SUPERSAMPLING * n) for n in size)
    return width, height


def _make_ghost(model: mujoco.MjModel) -> None:
    """Leaves the large moving parts, see-through and of one colour."""
    kept = np.zeros(model.ngeom, dtype=bool)
    kept[framing.moving_geoms(model)] = True
    kept &= model.geom_rbound > _SMALL_PART
    model.geom_group[~kept] = _HIDDEN_GROUP
    model.geom_matid[:] = -1
    model.geom_rgba[:] = GHOST
    model.tendon_rgba[:, 3] = 0.0


def _lights_move(model: mujoco.MjModel) -> bool:
    """Whether what stands still may look different later on."""
    fixed = int(mujoco.mjtCamLight.mjCAMLIGHT_FIXED)
    moving = model.body_weldid[model.light_bodyid] != 0
    return bool(np.any(moving | (model.light_mode != fixed)))
