"""Recordings as MCAP files and ROS 2 bags, through the `mcap-ros2-support` package.

Topics and messages: docs/reference/data_formats.md and docs/guides/recordings.md.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap_ros2.writer import Writer

from leglab.base.errors import FileError, RecordingError
from leglab.base.input import read_bytes
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.base.units import unit_of
from leglab.data.alignment import on_clock
from leglab.data.bag import METADATA_NAME, Bag, decode, scan
from leglab.data.clock import LAST_EXACT, Timed
from leglab.data.column_map import ColumnMap
from leglab.data.files import LeftOut, to_json
from leglab.data.ros_messages import (
    DEFINITIONS,
    JOINT_STATE,
    OWN_PACKAGE,
    STRING,
    TRANSFORMS,
    header,
    own_definition,
    scalar,
    transforms_message,
)
from leglab.data.scene import Scene

_CLOCK_TOPIC = "/joint_states"
_DESCRIPTION = "/robot_description"

# Columns of a joint that tell of its cylinder, beside those of its actuator.
_HYDRAULIC = frozenset(
    ("pressure_a", "pressure_b", "spool", "oil_temperature", "seal_clearance", "energy_supply")
)
# Files of a bag; what is unpacked beside a packed file counts.
_PARTS = ("*.mcap.zstd", "*.db3.zstd", "*.db3", "*.mcap")
_PART = re.compile(
    r"^\s*-\s+(?:path:\s*)?[\"']?([^\s\"']+\.(?:mcap|db3)(?:\.zstd)?)[\"']?\s*$", re.M
)
# Names of fields that ROS allows.
_FIELD = re.compile(r"[a-z](?:_?[a-z0-9])*")

# Seconds in the header are an int32.
_END_OF_ROS_TIME = 2**31


def read_table(
    path: Path, left_out: LeftOut, columns: ColumnMap | None
) -> tuple[dict[str, np.ndarray], dict]:
    """Reads all topics of supported types, on the clock of the joint states.

    What was done stands in the metadata under "alignment", and `start_ns` where the time axis was
    moved to 0.

    Raises:
        LeglabError: The file is truncated or broken, has no joint states, or a topic that the map
            names shares no time with them.
    """
    columns = columns or ColumnMap()
    files, lacking = _files_of(path, left_out)
    bag = scan(files, salvage=left_out.salvage)
    clock_topic = _clock_topic(bag, columns, path)
    series = decode(bag, clock_topic, columns.settings.stamps, path, left_out)
    clock = series.pop(clock_topic)
    table, notes = on_clock(series.values(), clock, columns, left_out)
    if columns.settings.stamps == "header" and clock.stamped_by == "log":
        notes.insert(0, f"{clock_topic}: no header stamps, log time instead")
    if "time" in table:
        told = f"{path}: a topic is called 'time', which is the time axis"
        raise RecordingError(told, given="time")
    metadata = dict(bag.metadata)
    start = 0
    if clock.stamps.max(initial=0) > LAST_EXACT * 1e9:
        metadata["start_ns"] = start = int(clock.stamps.min())
    if lost := [*lacking, *bag.lost]:
        metadata["salvaged"] = lost
    if notes:
        metadata["alignment"] = [*metadata.get("alignment", ()), *notes]
    return Timed({"time": (clock.stamps - start) / 1e9, **table}), metadata


def write(recording: Recording, path: Path, scene: Scene | None = None) -> None:
    """Writes a recording: joints as JointState, their other columns as one or two messages.

    Columns of no joint are one topic each. Samples and metadata keep every bit, times are rounded
    to 1 ns. A scene is written as `/robot_description` and `/tf`; its efforts go to the JointState.

    Raises:
        LeglabError: The folder cannot be written to, times do not fit into ROS stamps, or a column
            is called like the JointState topic.
    """
    scaled = np.rint(recording.time * 1e9)
    if scaled[0] < 0 or scaled[-1] >= _END_OF_ROS_TIME * 1e9:
        first, last = recording.time[[0, -1]].tolist()
        told = f"{path}: time covers [{first:g}, {last:g}] s; allowed in a ROS message: "
        raise RecordingError(told, given=(first, last), allowed=f"[0, {_END_OF_ROS_TIME}) s")
    stamps = scaled.astype(np.int64)
    if (np.diff(stamps) <= 0).any():
        row = int(np.argmax(np.diff(stamps) <= 0)) + 1
        raise RecordingError(f"{path}: rows {row - 1} and {row} are less than 1 ns apart")
    if _CLOCK_TOPIC.removeprefix("/") in recording:
        told = f"{path}: column 'joint_states' is taken by the topic {_CLOCK_TOPIC!r}"
        raise RecordingError(told, given="joint_states")
    write_atomically(path, lambda stream: _write(recording, stamps.tolist(), stream, scene))


def losses(recording: Recording) -> tuple[str, ...]:
    """Returns what the format cannot hold."""
    rounded = np.rint(recording.time * 1e9) / 1e9
    count = int((rounded != recording.time).sum())
    return (f"{count} times are rounded to 1 ns",) if count else ()


def _write(recording: Recording, stamps: list[int], stream: BinaryIO, scene: Scene | None) -> None:
    joints = list(recording.joints)
    units = {name: unit_of(name, recording.metadata) for name in recording.columns}
    known = {**recording.columns}
    if scene:
        known |= {f"{joint}_effort": samples for joint, samples in scene.efforts.items()}
    # A JointState has a velocity for every joint or for none, and an effort likewise.
    fields = ["position"]
    fields += [f for f in ("velocity", "effort") if all(f"{j}_{f}" in known for j in joints)]
    states = {
        field: np.column_stack([known.pop(f"{joint}_{field}") for joint in joints]).tolist()
        for field in (fields if joints else ())
    }
    with Writer(stream) as writer:
        writer.add_metadata(METADATA_NAME, {"metadata": to_json(recording.metadata)})
        writer.add_metadata("units", {name: unit for name, unit in units.items() if unit})
        joint_state = writer.register_msgdef(JOINT_STATE, DEFINITIONS[JOINT_STATE])
        topics = []
        schemas: dict[str, Any] = {}
        for topic, names in _topics([n for n in known if n in recording], recording).items():
            kind, text = _type_of(topic, names, units)
            if text not in schemas:
                count = sum(schema.name.startswith(kind) for schema in schemas.values())
                kind += str(count + 1) if count else ""
                schemas[text] = writer.register_msgdef(kind, text)
            rows = np.column_stack([known[name] for name in names.values()]).tolist()
            topics.append((topic, schemas[text], tuple(names), rows))
        poses = _write_description(scene, stamps[0], writer) if scene else None
        for row, stamp in enumerate(stamps):
            state = {field: values[row] for field, values in states.items()}
            message: dict[str, Any] = {"header": header(stamp), "name": joints, **state}
            writer.write_message(_CLOCK_TOPIC, joint_state, message, stamp, stamp, row)
            for topic, schema, own, rows in topics:
                message = {"header": header(stamp), **dict(zip(own, rows[row], strict=True))}
                writer.write_message(topic, schema, message, stamp, stamp, row)
            if poses:
                poses(row, stamp)


def _type_of(topic: str, columns: dict[str, str], units: dict[str, str]) -> tuple[str, str]:
    """The type of a topic's messages, whose columns are given by field, and its definition."""
    if len(columns) == 1:
        kind, _ = scalar(topic)
        return kind, DEFINITIONS[kind]
    text = own_definition({field: units[column] for field, column in columns.items()})
    return OWN_PACKAGE + topic.rpartition("/")[2].capitalize(), text


def _topics(names: list[str], recording: Recording) -> dict[str, dict[str, str]]:
    """Returns which columns go into one message: by topic, columns by field.

    What belongs to the hydraulics or the drive of a joint goes to `/<joint>/hydraulics`, all else
    of the joint to `/<joint>/control`; where there is one column alone it keeps its own topic.
    """
    found: dict[str, dict[str, str]] = {}
    for name in names:
        owners = [joint for joint in recording.joints if name.startswith(f"{joint}_")]
        joint = max(owners, key=len, default="")
        field = name.removeprefix(f"{joint}_")
        if not owners or not _FIELD.fullmatch(field) or field in ("header", "position", "velocity"):
            continue
        actuator = recording.actuator_of(joint)
        of_drive = actuator is not None and name.startswith(f"{actuator}_")
        part = "hydraulics" if of_drive or field in _HYDRAULIC else "control"
        found.setdefault(f"/{joint}/{part}", {})[field] = name
    found = {t: f for t, f in found.items() if len(f) > 1 and t.removeprefix("/") not in names}
    grouped = {name for fields in found.values() for name in fields.values()}
    alone = {f"/{name}": {scalar(name)[1]: name} for name in names if name not in grouped}
    return found | alone


def _write_description(scene: Scene, stamp: int, writer: Writer) -> Callable[[int, int], None]:
    """Writes the URDF; returns what writes the poses of a row, where there are any."""
    text = writer.register_msgdef(STRING, DEFINITIONS[STRING])
    placed = writer.register_msgdef(TRANSFORMS, DEFINITIONS[TRANSFORMS])
    writer.write_message(_DESCRIPTION, text, {"data": scene.urdf}, stamp, stamp, 0)
    parents = [scene.links[parent] for parent in scene.parents[1:]]
    frames = list(zip(parents, scene.links[1:], strict=True))
    at = {int(row): k for k, row in enumerate(scene.rows)}

    def write_poses(row: int, stamp: int) -> None:
        if (k := at.get(row)) is not None:
            each = scene.positions[k, 1:].tolist(), scene.quaternions[k, 1:].tolist()
            message = transforms_message(stamp, frames, *each)
            writer.write_message("/tf", placed, message, stamp, stamp, k)

    return write_poses


def _files_of(path: Path, left_out: LeftOut) -> tuple[list[Path], list[str]]:
    """The parts of a bag, in any order, and a line for those that are missing."""
    if not path.is_dir():
        return [path], []
    files = {f.name.removesuffix(".zstd"): f for kind in _PARTS for f in path.glob(kind)}
    listed = path / "metadata.yaml"
    text = read_bytes(listed).decode(errors="replace") if listed.is_file() else ""
    named = {Path(name).name.removesuffix(".zstd") for name in _PART.findall(text)}
    notes = []
    if lacking := sorted(named - files.keys()):
        told = f"{path}: no {', '.join(lacking)}, which metadata.yaml names"
        if not left_out.salvage:
            way = "; --salvage reads the others"
            raise FileError(f"{told}{way if files else ''}", given=path)
        notes.append(told)
    series = {re.sub(r"_\d+$", "", Path(name).stem) for name in files}
    if not files or (len(series) > 1 and not named):
        names = ", ".join(sorted(files)) or "none"
        told = f"{path}: a bag with {len(files)} .mcap files ({names}); allowed: "
        raise FileError(told, given=path, allowed="one")
    return [files[name] for name in sorted(named & files.keys() or files)], notes


def _clock_topic(bag: Bag, columns: ColumnMap, path: Path) -> str:
    candidates = {c.topic for c in bag.channels.values() if bag.kind(c) == JOINT_STATE}
    if not candidates:
        told = f"{path}: no topic of type {JOINT_STATE}; found {bag.topics()}"
        if forms := {c.message_encoding for c in bag.channels.values()} - {"cdr"}:
            told += f"; messages encoded as {', '.join(map(repr, sorted(forms)))} are not read: "
            told += "export them as CSV (PlotJuggler, Foxglove)"
        raise RecordingError(told, allowed=(JOINT_STATE,))
    wanted = columns.settings.clock
    if wanted not in (None, *candidates):
        raise RecordingError.unknown(f"clock of {columns.source}", wanted, candidates)
    for topic in (wanted, _CLOCK_TOPIC):
        if topic in candidates:
            return topic
    if len(candidates) == 1:
        return candidates.pop()
    raise RecordingError(
        f"{path}: several topics of type {JOINT_STATE}, none of them {_CLOCK_TOPIC!r}; choose one "
        f"by clock = ... in a column map: {', '.join(map(repr, sorted(candidates)))}",
        allowed=sorted(candidates),
    )
