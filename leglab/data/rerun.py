"""Recordings for the viewer of rerun.io: plots of all columns, and the machine where there is one.

The files are for looking at and cannot be read back. Writing needs the package `rerun-sdk`.
"""

import tempfile
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from leglab.base.errors import FileError, LeglabError
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.base.units import unit_of
from leglab.data.files import LeftOut
from leglab.data.scene import Scene

_TIMELINE = "time"


def read_table(path: Path, left_out: LeftOut) -> NoReturn:
    """Refuses the file.

    Raises:
        LeglabError: Always.
    """
    told = f"{path}: files for rerun cannot be read back; keep the recording itself"
    raise FileError(told, given=path)


def write(recording: Recording, path: Path, scene: Scene | None = None) -> None:
    """Writes a recording, columns by the element and quantity: `/plots/knee/pressure_a`.

    Args:
        recording: To write.
        path: The file.
        scene: The machine; its links lie below `/machine`, each in the frame of its parent.

    Raises:
        LeglabError: rerun-sdk is missing, or the folder cannot be written to.
    """
    try:
        import rerun as rr
    except ImportError as error:
        raise LeglabError("files for rerun need rerun-sdk: pip install rerun-sdk") from error
    stream = rr.RecordingStream("leglab", recording_id="leglab")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "recording.rrd"
        stream.save(file)
        _plots(rr, stream, recording)
        if scene:
            _machine(rr, stream, recording.time, scene)
        stream.disconnect()
        content = file.read_bytes()
    write_atomically(path, lambda out: out.write(content))


def _plots(rr: Any, stream: Any, recording: Recording) -> None:
    time = rr.TimeColumn(_TIMELINE, duration=recording.time)
    for name, samples in recording.columns.items():
        owners = [joint for joint in recording.joints if name.startswith(f"{joint}_")]
        joint = max(owners, key=len, default="")
        entity = f"/plots/{joint}/{name.removeprefix(f'{joint}_')}" if joint else f"/plots/{name}"
        unit = unit_of(name, recording.metadata)
        label = f"{name} [{unit}]" if unit else name
        stream.log(entity, rr.SeriesLines(names=label), static=True)
        stream.send_columns(entity, indexes=[time], columns=rr.Scalars.columns(scalars=samples))


def _machine(rr: Any, stream: Any, time: np.ndarray, scene: Scene) -> None:
    stream.log("/machine", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    paths: list[str] = []
    for link, parent in zip(scene.links, scene.parents, strict=True):
        paths.append(f"{paths[parent]}/{link}" if parent >= 0 else f"/machine/{link}")
    for number, mesh in enumerate(scene.meshes):
        shown = rr.Mesh3D(
            vertex_positions=mesh.vertices.astype(np.float32),
            triangle_indices=mesh.faces.astype(np.uint32),
            albedo_factor=[float(part) for part in mesh.color],
        )
        stream.log(f"{paths[mesh.link]}/mesh_{number}", shown, static=True)
    shown_time = rr.TimeColumn(_TIMELINE, duration=time[scene.rows])
    for number in range(1, len(scene.links)):
        # rerun puts w last.
        turned = scene.quaternions[:, number][:, [1, 2, 3, 0]]
        poses = rr.Transform3D.columns(translation=scene.positions[:, number], quaternion=turned)
        stream.send_columns(paths[number], indexes=[shown_time], columns=poses)
