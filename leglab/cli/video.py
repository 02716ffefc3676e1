"""The command `leglab video`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from leglab.cli.options import Camera, Json
from leglab.cli.terminal import output, progress_bar


def video(
    folders: Annotated[list[Path], typer.Argument(help="Folders of one to four runs.")],
    out: Annotated[
        Path | None,
        typer.Option(help="MP4 file; default FOLDER/video.mp4, of several runs ./video.mp4."),
    ] = None,
    start: Annotated[float | None, typer.Option(help="First second shown.")] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds shown; default: all.")] = None,
    camera: Camera = "three_quarter",
    as_json: Json = False,
) -> None:
    """Renders runs side by side to MP4, headless, with EGL or OSMesa."""
    from leglab.report.film import FRAME_RATE, SIZE, render_film

    path = out or (folders[0] / "video.mp4" if len(folders) == 1 else Path("video.mp4"))
    with progress_bar() as bar:
        task = bar.add_task("rendering", total=1.0)
        render_film(
            folders,
            path,
            start=start,
            duration=duration,
            camera=camera,
            progress=lambda share: bar.update(task, completed=share),
        )
    if as_json:
        content = {
            "film": str(path),
            "runs": [str(folder) for folder in folders],
            "size": list(SIZE),
            "frame_rate": FRAME_RATE,
            "bytes": path.stat().st_size,
        }
        typer.echo(json.dumps(content, indent=2))
    else:
        output.print(f"written to {path}")
