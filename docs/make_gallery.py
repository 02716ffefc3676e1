"""Makes the moving picture and the stills of the README: `python docs/make_gallery.py`.

One walking leg with three controllers side by side, whose piston seals begin to leak ten times as
much: docs/images/seal_wear.webp, a loop around the moment of the change, and stills of films of
one, two and three runs.
"""

import argparse
import io
import tempfile
from pathlib import Path

import imageio_ffmpeg
from PIL import Image

from leglab.report.film import SIZE, render_film
from leglab.report.run_folder import write_run
from leglab.runner import RunSettings, run_scenario

CONTROLLERS = ("pd", "static_feedforward", "bsnn_arx")
DURATION = 20.0  # s; the seals wear out half way
LOOP = (9.0, 5.0)  # start and length of the loop [s]
CLIP_SIZE, CLIP_STEP = (960, 540), 2  # every second frame
CLIP_LIMIT, STILL_LIMIT = 2_000_000, 300_000  # bytes


def make_runs(folder: Path) -> dict[str, Path]:
    """Simulates the runs that are shown, by name."""
    wanted = {name: RunSettings(scenario="seal_wear", controller=name) for name in CONTROLLERS}
    wanted["cold"] = RunSettings(
        scenario="cold_oil", controller="bsnn_arx", model="leg_rail", reference="squat"
    )
    return {
        name: write_run(run_scenario(settings), folder / name, figures=False)
        for name, settings in wanted.items()
    }


def frames(film: Path) -> list[Image.Image]:
    """All frames of a film."""
    reader = imageio_ffmpeg.read_frames(str(film))
    next(reader)
    return [Image.frombytes("RGB", SIZE, frame) for frame in reader]


def write_clip(images: list[Image.Image], out: Path) -> None:
    """Writes a loop as WebP, at the best quality that fits into the limit."""
    small = [image.resize(CLIP_SIZE, Image.Resampling.LANCZOS) for image in images[::CLIP_STEP]]
    for quality in (80, 70, 60, 50, 40, 30):
        buffer = io.BytesIO()
        small[0].save(
            buffer,
            "WEBP",
            save_all=True,
            append_images=small[1:],
            duration=round(1000 * CLIP_STEP / 30),
            loop=0,
            quality=quality,
            method=4,
        )
        if buffer.tell() < CLIP_LIMIT:
            break
    out.write_bytes(buffer.getvalue())
    print(f"{out}: {buffer.tell() / 1e6:.2f} MB, {len(small)} frames, quality {quality}")


def write_still(image: Image.Image, out: Path) -> None:
    """Writes a picture as WebP: a tenth of a PNG in full colour, which a colour bar needs."""
    image.save(out, "WEBP", quality=90, method=6)
    size = out.stat().st_size
    print(f"{out}: {size / 1e3:.0f} kB")
    if size > STILL_LIMIT:
        raise SystemExit(f"{out} is larger than {STILL_LIMIT} bytes")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        runs = make_runs(Path(name))
        film = Path(name) / "film.mp4"

        def shown(names: tuple[str, ...], start: float, duration: float) -> list[Image.Image]:
            folders = [runs[run] for run in names]
            return frames(render_film(folders, film, start=start, duration=duration))

        loop = shown(CONTROLLERS, *LOOP)
        write_clip(loop, arguments.out / "seal_wear.webp")
        write_still(loop[75], arguments.out / "film_side_by_side.webp")
        write_still(shown(("bsnn_arx",), 9.0, 2.0)[50], arguments.out / "film_one_run.webp")
        write_still(shown(("cold",), 9.0, 2.0)[50], arguments.out / "film_squat.webp")


if __name__ == "__main__":
    main()
