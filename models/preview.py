"""Renders the leg without the plugin: `python -m leglab.models.preview --out docs/images`.

Draws each cylinder as barrel and rod along its tendon and a coil around each spring strut.
"""

import argparse
import os
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

os.environ.setdefault("MUJOCO_GL", "egl")

import matplotlib.image
import mujoco
import numpy as np

from leglab.models.swap import FOLDER, load_with_motors

BARREL, CAP, CHROME = (0.46, 0.48, 0.52, 1.0), (0.76, 0.78, 0.81, 1.0), (0.93, 0.94, 0.97, 1.0)
DARK, COIL = (0.30, 0.31, 0.34, 1.0), (0.88, 0.33, 0.06, 1.0)


def cylinder_sizes() -> dict[str, tuple[float, float, float]]:
    """Returns (bore, rod diameter, stroke) in m by joint, from parts/cylinders.xml."""
    sizes = {}
    for plugin in ElementTree.parse(FOLDER / "parts" / "cylinders.xml").iterfind("actuator/plugin"):
        value = {c.get("key"): c.get("value") for c in plugin.iterfind("config")}
        bore, rod, stroke = (float(str(value[key])) for key in ("bore", "rod", "stroke"))
        sizes[str(plugin.get("name")).removesuffix("_valve")] = (bore, rod, stroke)
    return sizes


def add_segment(
    scene: mujoco.MjvScene,
    start: np.ndarray,
    end: np.ndarray,
    radius: float,
    rgba: tuple[float, ...],
    kind: int = mujoco.mjtGeom.mjGEOM_CYLINDER,
) -> None:
    """Adds a cylinder or capsule between two points, m, to the scene."""
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(
        geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), np.asarray(rgba, np.float32)
    )
    geom.specular, geom.shininess = 0.9, 0.7
    mujoco.mjv_connector(geom, kind, radius, start, end)
    scene.ngeom += 1


def draw_cylinder(
    scene: mujoco.MjvScene,
    base: np.ndarray,
    rod: np.ndarray,
    bore: float,
    rod_diameter: float,
    stroke: float,
) -> None:
    """Draws one cylinder between its pins: eye, barrel with end caps, chrome rod, rod eye."""
    line = (rod - base) / np.linalg.norm(rod - base)
    radius, length = bore / 2 + 0.0035, stroke + 0.02
    add_segment(scene, base, base + 0.012 * line, 0.45 * radius, CAP)
    add_segment(scene, base + 0.008 * line, base + 0.016 * line, radius + 0.0008, CAP)
    add_segment(scene, base + 0.016 * line, base + (length - 0.010) * line, radius, BARREL)
    add_segment(scene, base + (length - 0.012) * line, base + length * line, radius + 0.0012, CAP)
    add_segment(scene, base + length * line, rod, rod_diameter / 2, CHROME)
    add_segment(scene, rod - 0.014 * line, rod - 0.004 * line, 0.4 * bore, CAP)


def draw_coil(
    scene: mujoco.MjvScene,
    base: np.ndarray,
    rod: np.ndarray,
    radius: float = 0.0105,
    wire: float = 0.0018,
    turns: int = 9,
) -> None:
    """Draws the damper tube and the coil of a spring strut between its pins."""
    line = (rod - base) / np.linalg.norm(rod - base)
    side = np.cross(line, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    other = np.cross(line, side)
    start, end = base + 0.018 * line, rod - 0.018 * line
    add_segment(scene, start - 0.004 * line, start, radius + wire, DARK)
    add_segment(scene, end, end + 0.004 * line, radius + wire, DARK)
    add_segment(scene, base, base + 0.55 * (rod - base), 0.0065, DARK)
    t = np.linspace(0.0, 1.0, 12 * turns + 1)[:, None]
    angle = 2 * np.pi * turns * t
    points = start + t * (end - start) + radius * (np.cos(angle) * side + np.sin(angle) * other)
    for a, b in pairwise(points):
        add_segment(scene, a, b, wire, COIL, mujoco.mjtGeom.mjGEOM_CAPSULE)


def draw_hydraulics(scene: mujoco.MjvScene, data: mujoco.MjData) -> None:
    """Adds all cylinders and coils to a scene, after `update_scene`."""
    for joint, size in cylinder_sizes().items():
        base, rod = (data.site(f"{joint}_cylinder_{end}").xpos for end in ("base", "rod"))
        draw_cylinder(scene, base, rod, *size)
    for joint in ("hip_pitch", "knee", "ankle_pitch"):
        draw_coil(scene, *(data.site(f"{joint}_spring_{end}").xpos for end in ("base", "rod")))


def render(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    camera: str | mujoco.MjvCamera,
    width: int = 1280,
    height: int = 720,
) -> np.ndarray:
    """Returns one picture, uint8 of shape (height, width, 3)."""
    option = mujoco.MjvOption()
    option.geomgroup[3] = 0
    with mujoco.Renderer(model, height, width, max_geom=4000) as renderer:
        renderer.update_scene(data, camera, option)
        draw_hydraulics(renderer.scene, data)
        return renderer.render()


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", default="leg")
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--cameras", nargs="+", default=["side", "three_quarter"])
    parser.add_argument("--poses", nargs="+", default=["home", "swing", "squat"])
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 720))
    arguments = parser.parse_args()
    model = load_with_motors(arguments.model)
    data = mujoco.MjData(model)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for pose in arguments.poses:
        mujoco.mj_resetDataKeyframe(model, data, model.key(pose).id)
        mujoco.mj_forward(model, data)
        for camera in arguments.cameras:
            path = arguments.out / f"{arguments.model}_{pose}_{camera}.png"
            matplotlib.image.imsave(path, render(model, data, camera, *arguments.size))


if __name__ == "__main__":
    main()
