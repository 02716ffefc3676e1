"""Camera positions from which the moving geoms fill a given region of the picture."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from leglab.base.errors import SettingsError
from leglab.report.film.look import Rect

FIELD_OF_VIEW = 24.0  # vertical [degrees]; small, so that perspective hardly differs between panels
DEFAULT_CAMERA = "three_quarter"
SIGNS = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, 8).T  # of the corners of a box
_MARGIN = 10  # margin around the points of `crop` [px]


@dataclass(frozen=True)
class Direction:
    """Viewing direction of a camera, in MuJoCo's angles [degrees]."""

    azimuth: float
    elevation: float

    def axes(self) -> np.ndarray:
        """Returns the unit vectors right, up and forward of the picture as rows, (3, 3)."""
        azimuth, elevation = math.radians(self.azimuth), math.radians(self.elevation)
        right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
        level = math.cos(elevation)
        forward = np.array(
            [level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)]
        )
        return np.stack([right, np.cross(right, forward), forward])


def narrow(scene: mujoco.MjvScene, part: Rect, size: tuple[int, int]) -> None:
    """Narrows the view of a scene to `part` of its picture, which has the size `size` [px]."""
    width, height = size
    for eye in scene.camera:
        pixel = (eye.frustum_top - eye.frustum_bottom) / height
        top = eye.frustum_top
        eye.frustum_center += pixel * 0.5 * (part.left + part.right - width)
        eye.frustum_top = top - pixel * part.top
        eye.frustum_bottom = top - pixel * part.bottom


def direction(model: mujoco.MjModel, data: mujoco.MjData, camera: str) -> Direction:
    """Returns a camera's direction; the free camera's if the model has no `DEFAULT_CAMERA`.

    Raises:
        LeglabError: The model has no camera of this name; the message lists the model's cameras.
    """
    names = [model.camera(i).name for i in range(model.ncam)]
    if camera not in names:
        if camera != DEFAULT_CAMERA:
            raise SettingsError.unknown("camera", camera, [*names, DEFAULT_CAMERA])
        view = model.vis.global_
        return Direction(float(view.azimuth), float(view.elevation))
    forward = -data.cam_xmat[names.index(camera)].reshape(3, 3)[:, 2]
    elevation = math.degrees(math.asin(float(np.clip(forward[2], -1.0, 1.0))))
    return Direction(math.degrees(math.atan2(forward[1], forward[0])), elevation)


def moving_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Returns the indices of the geoms that are visible and can move."""
    moving = model.body_weldid[model.geom_bodyid] != 0
    return np.flatnonzero(moving & (model.geom_group < 3))


def corners(model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray) -> np.ndarray:
    """Returns the corners of the boxes around geoms [m], (8 geoms, 3)."""
    boxes = model.geom_aabb[geoms]
    local = boxes[:, None, :3] + SIGNS[None] * boxes[:, None, 3:]
    turned = np.einsum("gij,gkj->gki", data.geom_xmat[geoms].reshape(-1, 3, 3), local)
    return (turned + data.geom_xpos[geoms][:, None]).reshape(-1, 3)


def crop(points: np.ndarray, camera: mujoco.MjvCamera, size: tuple[int, int]) -> Rect:
    """Returns the rectangle of a camera's picture that contains points, with a margin.

    Args:
        points: Points in front of the camera [m], (n, 3).
        camera: Camera that `frame` returned.
        size: Width and height of the picture [px].
    """
    axes = Direction(camera.azimuth, camera.elevation).axes()
    x, y, z = axes @ (points - camera.lookat + camera.distance * axes[2]).T
    width, height = size
    scale = 0.5 * height / math.tan(math.radians(FIELD_OF_VIEW) / 2)
    columns, rows = 0.5 * width + scale * x / z, 0.5 * height - scale * y / z
    # Edges are even numbers, so that the picture rendered 1.5 times as large has whole pixels.
    return Rect(
        left=max(2 * (math.floor(columns.min() - _MARGIN) // 2), 0),
        top=max(2 * (math.floor(rows.min() - _MARGIN) // 2), 0),
        right=min(-2 * (-math.ceil(columns.max() + _MARGIN) // 2), width),
        bottom=min(-2 * (-math.ceil(rows.max() + _MARGIN) // 2), height),
    )


def frame(
    points: np.ndarray, view: Direction, aspect: float, region: tuple[float, float, float, float]
) -> mujoco.MjvCamera:
    """Returns the nearest camera that sees all points inside a region of its picture.

    A camera at c sees a point p between x0 and x1 if p_x - x1 k p_z <= c_x - x1 k c_z and
    p_x - x0 k p_z >= c_x - x0 k c_z in camera axes, with half the picture's width k at distance 1.
    The two conditions are linear in c and together bound c_z; so do the two for the height.

    Args:
        points: Points to be visible [m], (n, 3).
        view: Viewing direction.
        aspect: Width over height of the picture.
        region: Left, right, bottom, top of the region, from -1 to 1.
    """
    axes = view.axes()
    x, y, z = axes @ points.T
    half = math.tan(math.radians(FIELD_OF_VIEW) / 2)
    bounds, depth = [], math.inf
    for values, k, (low, high) in ((x, half * aspect, region[:2]), (y, half, region[2:])):
        least = float(np.min(values - low * k * z))
        most = float(np.max(values - high * k * z))
        depth = min(depth, (least - most) / ((high - low) * k))
        bounds.append((least, most, low * k, high * k))
    centre = [
        0.5 * (least + low * depth + most + high * depth) for least, most, low, high in bounds
    ]
    distance = float(np.mean(z)) - depth
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.azimuth, camera.elevation, camera.distance = view.azimuth, view.elevation, distance
    camera.lookat[:] = np.array([*centre, depth + distance]) @ axes
    return camera
