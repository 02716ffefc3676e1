"""Pictures of a model: its pose, a ghost at the reference, cylinders coloured by pressure."""

import math

import mujoco
import numpy as np
from PIL import Image

from leglab.machine.simulation import Simulation, load_model
from leglab.report.film import framing
from leglab.report.film.look import GHOST, UNKNOWN, Rect, pressure_color
from leglab.report.film.track import Track

# Factor by which pictures are rendered larger, then averaged; 2 takes 1/8 longer, looks the same.
_SUPERSAMPLING = 1.5
# Geoms of a ghost whose bounding radius is smaller than this are left out [m].
_SMALL_PART = 0.05
# A ghost is moved away from the camera by this share of its distance from the camera. Otherwise its
# surface and the leg's would flicker where they coincide.
_GHOST_SHIFT = 0.003
_SPRING = (0.88, 0.33, 0.06, 1.0)
_MAX_GEOMS = 4000
_HIDDEN_GROUP = 5
_FLIP, _AVERAGE = Image.Transpose.FLIP_TOP_BOTTOM, Image.Resampling.HAMMING
# Cylinders are drawn wider by this factor, so that small pictures show their colours.
_WIDER = 1.5
_WALL = 0.0035  # m
# Shares of a cylinder's colour that are emitted, to match the colour bar, and lit, to look round.
_GLOW, _LIT = 0.9, 0.55
_CAP, _CHROME = (0.14, 0.15, 0.17), (0.92, 0.93, 0.95)
_ORIGIN, _UPRIGHT = np.zeros(3), np.eye(3).ravel()
_BASE, _END = 0.012, 0.012  # length of the ends of a barrel [m]
# Added to models without light or sky: direction of the light, colours of the sky, top and bottom.
_LIGHT, _SKY = (-0.35, 0.5, -0.8), ((0.93, 0.94, 0.96), (0.75, 0.77, 0.8))
# Number and colour of the stacked discs that look like a soft shadow below the foot.
_DISCS = 6
_SHADOW = (0.10, 0.11, 0.13, 0.07)


class DrawnMachine:
    """Renderer of a model, shared by all runs of the model.

    Fixed geoms are drawn once. A frame renders only the region that contains the machine, because
    the time of software rendering grows with the pixels, and a leg is narrow. `timestep` is the
    time step of the runs [s], None for the model's; `size` is width and height of the picture [px].
    """

    def __init__(self, model: str, timestep: float | None, size: tuple[int, int]) -> None:
        self.model = load_model(model, timestep=timestep, edit=_light)
        self.simulation = Simulation(self.model)
        self.cylinders = _CylinderShapes(self.simulation)
        self.shadow = _FloorShadow(self.model)
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
        self._ghost = load_model(model, timestep=timestep)
        _make_ghost(self._ghost)
        self._option, self._perturbation = mujoco.MjvOption(), mujoco.MjvPerturb()
        fixed = self.model.light_mode == mujoco.mjtCamLight.mjCAMLIGHT_FIXED
        # If a light moves, fixed geoms may look different in each frame, which then is drawn whole.
        still = self.model.body_weldid[self.model.light_bodyid] == 0
        self._fixed_lights = bool(np.all(fixed & still))
        self._moving = framing.moving_geoms(self.model)
        self._scene = mujoco.MjvScene(self.model, _MAX_GEOMS)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[flag] = 0
        self._gl = mujoco.GLContext(width, height)
        self._gl.make_current()
        self._context = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)

    def look(self, camera: mujoco.MjvCamera) -> None:
        """Sets the camera, and draws the geoms that do not move."""
        self._camera = camera
        self._whole = Rect(0, 0, *self._size)
        data = self.simulation.data
        self._start_scene(data, self._whole, mujoco.mjtCatBit.mjCAT_STATIC)
        self._background = self._render(data, self._whole)

    def close(self) -> None:
        """Frees the OpenGL context."""
        self._gl.make_current()
        self._context.free()
        self._gl.free()

    def outline(self, data: mujoco.MjData) -> np.ndarray:
        """Returns points around all moving parts, without the shadow [m], (n, 3)."""
        corners = framing.corners(self.model, data, self._moving)
        return np.concatenate([corners, self.cylinders.corners(data)])

    def draw(
        self, data: mujoco.MjData, reference: mujoco.MjData, pressures: np.ndarray
    ) -> Image.Image:
        """Returns the picture of the machine and its ghost.

        Args:
            data: State with the true pose, set by `DrawnRun.place`.
            reference: State with the pose of the ghost.
            pressures: Pressures of both sides of each cylinder, divided by the pressure at the end
                of the colour bar, (actuators, 2); NaN if unknown.
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
        self, data: mujoco.MjData, crop: Rect, categories: mujoco.mjtCatBit
    ) -> mujoco.MjvScene:
        scene = self._scene
        scene.ngeom = 0
        mujoco.mjv_updateCamera(self.model, data, self._camera, scene)
        framing.narrow(scene, crop, self._size)
        # Not mjv_updateScene, in which the plugins would add hundreds of shapes.
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

    def _render(self, data: mujoco.MjData, crop: Rect) -> Image.Image:
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


def _light(spec: mujoco.MjSpec) -> None:
    """Adds a light and a sky to models without them, where machine or sky would be black."""
    if not spec.lights:
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=_LIGHT, diffuse=[0.6] * 3
        )
        spec.visual.headlight.ambient = [0.35] * 3
    if not any(texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX for texture in spec.textures):
        spec.add_texture(
            name="sky of the film",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=_SKY[0],
            rgb2=_SKY[1],
            width=16,
            height=96,
        )


def _make_ghost(model: mujoco.MjModel) -> None:
    """Hides all geoms except large moving ones, which become transparent and of one colour."""
    kept = np.zeros(model.ngeom, dtype=bool)
    kept[framing.moving_geoms(model)] = True
    kept &= model.geom_rbound > _SMALL_PART
    model.geom_group[~kept] = _HIDDEN_GROUP
    model.geom_matid[:] = -1
    model.geom_rgba[:] = GHOST
    model.tendon_rgba[:, 3] = 0.0


class DrawnRun:
    """Drawings of one run; `scale` is the pressure at the end of the colour bar [Pa]."""

    def __init__(self, machine: DrawnMachine, track: Track, scale: float) -> None:
        self._machine, self._track = machine, track
        model = machine.model
        self._data, self._reference = mujoco.MjData(model), mujoco.MjData(model)
        for data in (self._data, self._reference):
            mujoco.mj_copyData(data, model, machine.simulation.data)
        # The ghost shows joints without a reference, such as a rail, in their true position.
        self._truth = self._columns("truth", "position")
        self._wanted = self._columns("reference", "truth", "position")
        joints, unknown = machine.simulation.joints, np.full(len(track.recording), np.nan)
        sides = [track.column(f"{joint}_pressure_{side}") for joint in joints for side in "ab"]
        self._levels = np.stack([unknown if s is None else s / scale for s in sides], axis=1)

    def place(self, time: float) -> None:
        """Sets the machine and its ghost to their poses at a time [s]."""
        row = self._track.row(time)
        for data, columns in ((self._data, self._truth), (self._reference, self._wanted)):
            for address, values in columns:
                if np.isfinite(values[row]):
                    data.qpos[address] = values[row]
            for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):
                compute(self._machine.model, data)
            mujoco.mj_tendon(self._machine.model, data)

    def extent(self, times: np.ndarray) -> np.ndarray:
        """Returns points around machine and ghost at all `times` [s], (n, 3) [m]."""
        found = []
        for time in times:
            self.place(float(time))
            found += [self._machine.outline(data) for data in (self._data, self._reference)]
        return np.concatenate(found)

    def direction(self, camera: str) -> framing.Direction:
        """Returns the viewing direction of a camera of the model."""
        return framing.direction(self._machine.model, self._data, camera)

    def draw(self, time: float) -> Image.Image:
        """Returns the picture of the machine at a time [s]."""
        self.place(time)
        levels = self._levels[self._track.row(time)].reshape(-1, 2)
        return self._machine.draw(self._data, self._reference, levels)

    def _columns(self, *suffixes: str) -> list[tuple[int, np.ndarray]]:
        """Returns each recorded joint's index in qpos, and its samples (first recorded suffix)."""
        model, found = self._machine.model, []
        for i in range(model.njnt):
            name = model.joint(i).name
            values = self._track.column(*(f"{name}_{suffix}" for suffix in suffixes))
            if values is not None:
                found.append((int(model.jnt_qposadr[i]), values))
        return found


class _CylinderShapes:
    """Cylinders split at the piston: cap side and rod side in the colours of their pressures.

    Cylinders that act on a joint directly have no position in space and are not drawn. `tendons`
    holds the names of the tendons that actuators pull or push; all other tendons are springs.
    """

    def __init__(self, simulation: Simulation) -> None:
        model = simulation.model
        on_tendon = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
        self._places = [simulation.actuators.index(name) for name in simulation.cylinders]
        tendons = np.where(on_tendon, model.actuator_trnid[:, 0], -1)
        self._tendon = tendons[self._places].tolist()
        self._parameters = [simulation.cylinder_parameters(name) for name in simulation.cylinders]
        self.tendons = {model.tendon(i).name for i in tendons[on_tendon].tolist()}
        bore = max((parameters["bore"] for parameters in self._parameters), default=0.0)
        self._corners = _radius(bore) * framing.SIGNS

    def corners(self, data: mujoco.MjData) -> np.ndarray:
        """Returns corners of boxes around the ends of cylinders and springs [m], (8 n, 3)."""
        used = data.ten_wrapnum > 0
        first = data.ten_wrapadr[used]
        last = first + data.ten_wrapnum[used] - 1
        ends = data.wrap_xpos.reshape(-1, 3)[np.concatenate([first, last])]
        return (ends[:, None] + self._corners).reshape(-1, 3)

    def draw(self, scene: mujoco.MjvScene, data: mujoco.MjData, levels: np.ndarray) -> None:
        """Adds the cylinders to a scene; `levels` are the `pressures` of `DrawnMachine.draw`."""
        known = ~np.isnan(levels)[..., None]
        colours = _LIT * np.where(known, pressure_color(np.nan_to_num(levels)), UNKNOWN)
        points = data.wrap_xpos.reshape(-1, 3)
        for tendon, parameters, (cap, rod) in zip(
            self._tendon, self._parameters, colours[self._places], strict=True
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
            radius = _radius(parameters["bore"])
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


def _radius(bore: float) -> float:
    """Returns the radius of a drawn barrel [m]."""
    return _WIDER * (0.5 * bore + _WALL)


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


class _FloorShadow:
    """Shadow of flat discs below the largest geom of the last body, if the model has a floor.

    Shadows rendered by MuJoCo would take half the time of a frame.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
        moving = framing.moving_geoms(model)
        self._floor: float | None = None
        if len(planes) and len(moving):
            last = moving[model.geom_bodyid[moving] == model.geom_bodyid[moving].max()]
            self._part = int(last[np.argmax(model.geom_rbound[last])])
            self._box = model.geom_aabb[self._part]
            self._floor = float(model.geom_pos[planes[0], 2])

    def draw(self, scene: mujoco.MjvScene, data: mujoco.MjData) -> None:
        """Adds the discs to a scene; they are wider if the geom is higher above the floor."""
        if self._floor is None:
            return
        point, turn, radii = self._place(data)
        for i in range(min(_DISCS, scene.maxgeom - scene.ngeom)):
            size = np.array([*(radii * (0.6 + 0.9 * i / _DISCS)), 1e-4])
            point[2] = self._floor + 0.0005 * (i + 1)
            geom = scene.geoms[scene.ngeom]
            shape = mujoco.mjtGeom.mjGEOM_ELLIPSOID
            mujoco.mjv_initGeom(geom, shape, size, point, turn, np.array(_SHADOW, np.float32))
            geom.specular = geom.reflectance = 0.0
            scene.ngeom += 1

    def corners(self, data: mujoco.MjData) -> np.ndarray:
        """Returns points around the discs [m], (n, 3)."""
        if self._floor is None:
            return np.empty((0, 3))
        point, turn, radii = self._place(data)
        ring = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
        spread = 1.5 * radii[:, None] * np.array([np.cos(ring), np.sin(ring)])
        point[2] = self._floor
        return point + (turn.reshape(3, 3)[:, :2] @ spread).T

    def _place(self, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the geom's centre [m], the discs' rotation (row-major) and half axes [m]."""
        turn = data.geom_xmat[self._part].reshape(3, 3)
        point = data.geom_xpos[self._part] + turn @ self._box[:3]
        # Longest axis of the geom's box in the horizontal plane; half extents along it and across.
        reach = turn[:2] * self._box[3:]
        longest = reach[:, int(np.argmax(np.hypot(*reach)))]
        angle = float(np.arctan2(longest[1], longest[0]))
        along = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-along[1], along[0]])
        radii = np.array([np.abs(axis @ reach).sum() for axis in (along, across)])
        radii *= 0.8 + 0.4 * max(point[2] - self._floor, 0.0)
        rotation = np.array([[*along, 0.0], [*across, 0.0], [0.0, 0.0, 1.0]]).T
        return point.copy(), rotation.ravel(), radii
