"""Makes the moving picture and the stills of the README: `python docs/_tools/make_gallery.py`.

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

from leglab import RunSettings, run_scenario
from leglab.report.film import SIZE, render_film
from leglab.report.film.workers import draw_frames
from leglab.runs.folder import write_run

CONTROLLERS = ("static_feedforward", "bsnn_arx", "bsnn_arx_bank")
DURATION = 20.0  # s; the seals wear out half way
LOOP = (9.0, 5.0)  # start and length of the loop [s]
CLIP_SIZE, CLIP_STEP = (960, 540), 2  # every second frame
CLIP_LIMIT, STILL_LIMIT = 2_000_000, 300_000  # bytes


def make_runs(folder: Path) -> dict[str, Path]:
    """Simulates the runs that are shown, unless they are there; their folders by name."""
    wanted = {name: RunSettings(scenario="seal_wear", controller=name) for name in CONTROLLERS}
    wanted["cold"] = RunSettings(
        scenario="cold_oil", controller="bsnn_arx", model="leg_rail", reference="squat"
    )
    for name, settings in wanted.items():
        if not (folder / name).exists():
            write_run(run_scenario(settings), folder / name)
    return {name: folder / name for name in wanted}


def still(folders: list[Path], span: tuple[float, float], time: float) -> Image.Image:
    """One frame of the film that shows a span [s]."""
    job = {"folders": [str(folder) for folder in folders], "camera": "three_quarter"}
    job |= {"start": span[0], "last": span[1], "frames": 2, "rate": 1.0 / (time - span[0])}
    *_, frame = draw_frames(job, backend="egl", count=1)
    return Image.frombytes("RGB", SIZE, bytes(frame))


def frames(film: Path) -> list[Image.Image]:
    """All frames of a film."""
    reader = imageio_ffmpeg.read_frames(str(film))
    next(reader)
    return [Image.frombytes("RGB", SIZE, frame) for frame in reader]


def write_loop(
    images: list[Image.Image],
    out: Path,
    *,
    size: tuple[int, int],
    milliseconds: int,
    limit: int,
    best: int,
) -> None:
    """Writes a loop as WebP, at the best quality, up to `best`, that fits into a limit [byte]."""
    small = [image.resize(size, Image.Resampling.LANCZOS) for image in images]
    for quality in range(best, 0, -10):
        buffer = io.BytesIO()
        small[0].save(
            buffer, "WEBP", save_all=True, append_images=small[1:], loop=0, method=4,
            duration=milliseconds, quality=quality,
        )  # fmt: skip
        if buffer.tell() < limit:
            break
    out.write_bytes(buffer.getvalue())
    print(
        f"{out}: {buffer.tell() / 1e3:.0f} kB, {len(small)} frames, quality {quality}", flush=True
    )


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
    parser.add_argument("--runs", type=Path, help="keeps the runs there, and uses those found")
    arguments = parser.parse_args()
    out = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        runs = make_runs(arguments.runs or Path(name))
        three, span = [runs[controller] for controller in CONTROLLERS], (LOOP[0], sum(LOOP))
        write_still(still(three, span, 11.5), out / "film_side_by_side.webp")
        write_still(still([runs["bsnn_arx"]], span, 11.5), out / "film_one_run.webp")
        write_still(still([runs["cold"]], span, 11.5), out / "film_squat.webp")
        film = render_film(three, Path(name) / "film.mp4", start=LOOP[0], duration=LOOP[1])
        write_loop(
            frames(film)[::CLIP_STEP], out / "seal_wear.webp",
            size=CLIP_SIZE, milliseconds=round(1000 * CLIP_STEP / 30), limit=CLIP_LIMIT, best=80,
        )  # fmt: skip


if __name__ == "__main__":
    main()
