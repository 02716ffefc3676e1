"""Renders the models in their keyframes: `python docs/_tools/model_pictures.py`."""

import argparse
import os
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
from PIL import Image

from leglab.machine.simulation import Simulation, load_model


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", default="leg")
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--cameras", nargs="+", default=["side", "three_quarter"])
    parser.add_argument("--poses", nargs="+", default=["home", "swing", "squat"])
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 720))
    arguments = parser.parse_args()
    width, height = arguments.size
    simulation = Simulation(load_model(arguments.model))
    arguments.out.mkdir(parents=True, exist_ok=True)
    with mujoco.Renderer(simulation.model, height, width) as renderer:
        for pose in arguments.poses:
            simulation.reset(pose)
            for camera in arguments.cameras:
                renderer.update_scene(simulation.data, camera)
                path = arguments.out / f"{arguments.model}_{pose}_{camera}.webp"
                Image.fromarray(renderer.render()).save(path, quality=88, method=6)


if __name__ == "__main__":
    main()
