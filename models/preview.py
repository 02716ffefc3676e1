"""Renders the leg: `python models/preview.py [MODEL.xml] --out docs/images` (MUJOCO_GL=egl).

Draws each cylinder as barrel and rod along its tendon, as the plugin's visualisation does, so that
the pictures need no plugin.
"""

import argparse
import os
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
import numpy as np
from PIL import Image

HERE = Path(__file__).parent
BORE_AND_STROKE = {  # m, as in parts/cylinders.xml
    "hip_yaw": (0.012, 0.064),
    "hip_roll": (0.016, 0.048),
    "hip_pitch": (0.020, 0.100),
    "knee": (0.020, 0.085),
    "ankle_pitch": (0.014, 0.046),
    "ankle_roll": (0.010, 0.026),
}
STRUTS = ("hip_pitch", "knee", "ankle_pitch")


def add_segment(scene, start, end, radius, rgba, kind=mujoco.mjtGeom.mjGEOM_CYLINDER):
    """Adds a cylinder or capsule between two points to the scene."""
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), np.float32(rgba))
    geom.specular, geom.shininess = 0.9, 0.7
    mujoco.mjv_connector(geom, kind, radius, start, end)
    scene.ngeom += 1


def draw_cylinder(scene, base, rod, bore, stroke):
    """Draws one cylinder between its pins: eye, barrel with end caps, chrome rod, rod eye."""
    line = (rod - base) / np.linalg.norm(rod - base)
    body, cap, chrome = (0.30, 0.31, 0.34, 1), (0.70, 0.72, 0.75, 1), (0.93, 0.94, 0.97, 1)
    radius, length = bore / 2 + 0.0035, stroke + 0.02
    add_segment(scene, base, base + 0.012 * line, 0.45 * radius, cap)
    add_segment(scene, base + 0.008 * line, base + 0.016 * line, radius + 0.0008, cap)
    add_segment(scene, base + 0.016 * line, base + (length - 0.010) * line, radius, body)
    add_segment(scene, base + (length - 0.012) * line, base + length * line, radius + 0.0012, cap)
    add_segment(scene, base + length * line, rod, 0.30 * bore, chrome)
    add_segment(scene, rod - 0.014 * line, rod - 0.004 * line, 0.42 * bore, cap)


def draw_coil(scene, base, rod, radius=0.0105, wire=0.0018, turns=9):
    """Draws the coil of a spring strut between its pins."""
    line = (rod - base) / np.linalg.norm(rod - base)
    side = np.cross(line, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    other = np.cross(line, side)
    start, end = base + 0.018 * line, rod - 0.018 * line
    cap = (0.30, 0.31, 0.34, 1)
    add_segment(scene, start - 0.004 * line, start, radius + wire, cap)
    add_segment(scene, end, end + 0.004 * line, radius + wire, cap)
    add_segment(scene, base, base + 0.55 * (rod - base), 0.0065, cap)
    t = np.linspace(0.0, 1.0, 12 * turns + 1)[:, None]
    angle = 2 * np.pi * turns * t
    points = start + t * (end - start) + radius * (np.cos(angle) * side + np.sin(angle) * other)
    for a, b in pairwise(points):
        add_segment(scene, a, b, wire, (0.88, 0.33, 0.06, 1), mujoco.mjtGeom.mjGEOM_CAPSULE)


def draw_hydraulics(scene, data):
    """Adds all cylinders and coils to a scene, after `update_scene`."""
    for joint, (bore, stroke) in BORE_AND_STROKE.items():
        base = data.site(f"{joint}_cylinder_base").xpos
        draw_cylinder(scene, base, data.site(f"{joint}_cylinder_rod").xpos, bore, stroke)
    for joint in STRUTS:
        base = data.site(f"{joint}_spring_base").xpos
        draw_coil(scene, base, data.site(f"{joint}_spring_rod").xpos)


def render(model, data, camera, width=1280, height=720):
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
    parser.add_argument("model", nargs="?", default=str(HERE / "leg_motor.xml"))
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--cameras", nargs="+", default=["side", "three_quarter"])
    parser.add_argument("--poses", nargs="+", default=["home", "swing", "squat"])
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 720))
    arguments = parser.parse_args()
    model = mujoco.MjModel.from_xml_path(arguments.model)
    data = mujoco.MjData(model)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for pose in arguments.poses:
        mujoco.mj_resetDataKeyframe(model, data, model.key(pose).id)
        mujoco.mj_forward(model, data)
        for camera in arguments.cameras:
            name = f"{Path(arguments.model).stem}_{pose}_{camera}.png"
            Image.fromarray(render(model, data, camera, *arguments.size)).save(arguments.out / name)


if __name__ == "__main__":
    main()
