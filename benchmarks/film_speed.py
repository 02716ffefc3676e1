"""Speed of the film of three runs side by side: `python benchmarks/film_speed.py [--seconds 4]`.

Prints what a second of film costs, wall and CPU time of all processes, and the frames a second of
one process beside those of the bare `mujoco.Renderer` on the same model, at the same moment and
with the same load of the machine. With `--check` the exit status is 1 where 20 s of film need more
than 60 s.
"""

import argparse
import os
import resource
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("LP_NUM_THREADS", "0")

import mujoco

from leglab import RunSettings, run_scenario
from leglab.machine.simulation import Simulation, load_model
from leglab.report.film import FRAME_RATE, SIZE, render_film
from leglab.report.film.picture import Picture
from leglab.report.film.workers import worker_count
from leglab.runs.folder import write_run

CONTROLLERS = ("pd", "static_feedforward", "bsnn_arx")
FILM, LIMIT = 20.0, 60.0  # s


def cpu_seconds() -> float:
    """Of this process and all that ended before it [s]."""
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in usage)


def best(draw, count: int = 8) -> tuple[float, float]:
    """Least wall and CPU time of a call [s]."""
    wall, cpu = [], []
    draw()
    for _ in range(count):
        start, used = time.perf_counter(), time.process_time()
        draw()
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - used)
    return min(wall), min(cpu)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=4.0, help="length of the film [s]")
    parser.add_argument("--check", action="store_true", help="fail where it is too slow")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folders = []
        for controller in CONTROLLERS:
            settings = RunSettings(
                scenario="seal_wear", controller=controller, duration=arguments.seconds
            )
            folder = Path(name) / controller
            folders.append(write_run(run_scenario(settings), folder))

        model = load_model("leg")
        data = Simulation(model).data
        panel = (SIZE[0] // 3, 400)
        with mujoco.Renderer(model, panel[1], panel[0]) as renderer:

            def bare() -> None:
                for _ in CONTROLLERS:
                    renderer.update_scene(data, "three_quarter")
                    renderer.render()

            wall, cpu = best(bare)
        print(f"mujoco.Renderer, 3 x {panel[0]} x {panel[1]}: {1 / wall:.1f} frames/s a process,")
        print(f"  {1e3 * cpu:.0f} ms CPU a frame")

        picture = Picture(folders, (0.0, arguments.seconds), "three_quarter")
        wall, cpu = best(lambda: picture.draw(0.6 * arguments.seconds))
        picture.close()
        print(f"a whole frame of the film: {1 / wall:.1f} frames/s a process,")
        print(f"  {1e3 * cpu:.0f} ms CPU a frame")

        start, used = time.perf_counter(), cpu_seconds()
        film = render_film(folders, Path(name) / "film.mp4")
        wall, cpu = time.perf_counter() - start, cpu_seconds() - used
        frames = round(arguments.seconds * FRAME_RATE)
        print(f"film of {arguments.seconds:g} s, {worker_count(frames)} processes, encoded: ")
        print(f"  {wall / arguments.seconds:.2f} s wall and {cpu / arguments.seconds:.2f} s CPU ")
        print(f"  a second of film; {film.stat().st_size / 1e6:.1f} MB")
        whole = wall / arguments.seconds * FILM
        print(f"20 s of film: {whole:.0f} s (limit {LIMIT:.0f} s)")
    if arguments.check and whole > LIMIT:
        sys.exit(1)


if __name__ == "__main__":
    main()
