"""Recordings as MCAP files and ROS 2 bags, through the `mcap-ros2-support` package.

Topics and messages: docs/reference/data_formats.md and docs/guides/recordings.md.
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.records import Schema
from mcap_ros2.writer import Writer

from leglab.base.errors import FileError, RecordingError
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.base.units import unit_of
from leglab.data import ros_messages as ros
from leglab.data.alignment import on_clock
from leglab.data.bag import METADATA_NAME, Bag, decode, scan
from leglab.data.clock import LAST_EXACT, Timed
from leglab.data.column_map import ColumnMap
from leglab.data.files import LeftOut, to_json
from leglab.data.scene import Scene

_CLOCK_TOPIC = "/joint_states"
# Columns of a joint that describe its cylinder, in addition to columns named after its actuator.
_HYDRAULIC = frozenset(
    ("pressure_a", "pressure_b", "spool", "oil_temperature", "seal_clearance", "energy_supply")
)
# Files of a bag; an uncompressed file takes precedence over its compressed copy.
_PARTS = ("*.mcap.zstd", "*.db3.zstd", "*.db3", "*.mcap")
_PART = re.compile(r"[^\s\"'/]+\.(?:mcap|db3)\b")  # in metadata.yaml


def read_table(
    path: Path, left_out: LeftOut, columns: ColumnMap | None
) -> tuple[dict[str, np.ndarray], dict]:
    """Reads all topics of supported types, on the clock of the joint states.

    The metadata describe the resampling under "alignment" and hold `start_ns` if the time axis was
    shifted to 0.

    Raises:
        LeglabError: The file is truncated or broken, has no joint states, or a topic named by the
            map does not overlap with them in time.
    """
    columns = columns or ColumnMap()
    files, lost = _files_of(path, left_out.salvage)
    bag = scan(files, salvage=left_out.salvage)
    clock_topic = _clock_topic(bag, columns)
    series = decode(bag, clock_topic, columns.settings.stamps, left_out)
    clock = series.pop(clock_topic)
    table, notes = on_clock(series.values(), clock, columns, left_out)
    if columns.settings.stamps == "header" and clock.stamped_by == "log":
        notes.insert(0, f"{clock_topic}: no header stamps, log time instead")
    if "time" in table:
        raise RecordingError("a topic is called 'time', which is the time axis", given="time")
    start = int(clock.stamps.min()) if clock.stamps.max(initial=0) > LAST_EXACT * 1e9 else 0
    alignment = [*bag.metadata.get("alignment", ()), *notes]
    told = {"start_ns": start, "salvaged": [*lost, *bag.lost], "alignment": alignment}
    metadata = bag.metadata | {key: note for key, note in told.items() if note}
    return Timed({"time": (clock.stamps - start) / 1e9, **table}), metadata


def write(recording: Recording, path: Path, scene: Scene | None = None) -> None:
    """Writes a recording: joints as JointState, other columns of a joint as one or two messages.

    Columns of no joint get a topic each. Samples and metadata keep every bit, times are rounded
    to 1 ns. A scene becomes `/robot_description` and `/tf`, its efforts go to the JointState.

    Raises:
        LeglabError: The folder cannot be written to, times do not fit into ROS stamps, or a column
            has the name of the JointState topic.
    """
    scaled = np.rint(recording.time * 1e9)
    if scaled[0] < 0 or scaled[-1] >= 2**31 * 1e9:  # Seconds in the header are an int32.
        first, last = recording.time[[0, -1]].tolist()
        text = f"{path}: time covers [{first:g}, {last:g}] s; allowed in a ROS message: "
        raise RecordingError(text, given=(first, last), allowed=f"[0, {2**31}) s")
    stamps = scaled.astype(np.int64)
    if (same := np.flatnonzero(np.diff(stamps) == 0)).size:
        raise RecordingError(f"{path}: rows {same[0]} and {same[0] + 1} are less than 1 ns apart")
    if _CLOCK_TOPIC.removeprefix("/") in recording:
        raise RecordingError(f"{path}: 'joint_states' is taken by a topic", given="joint_states")
    write_atomically(path, lambda stream: _write(recording, stamps.tolist(), stream, scene))


def losses(recording: Recording) -> tuple[str, ...]:
    """Returns phrases for the parts of a recording that the format cannot hold."""
    count = np.sum(np.rint(recording.time * 1e9) / 1e9 != recording.time)
    return (f"{count} times are rounded to 1 ns",) if count else ()


def _write(recording: Recording, stamps: list[int], stream: BinaryIO, scene: Scene | None) -> None:
    units = {name: unit_of(name, recording.metadata) for name in recording.columns}
    with Writer(stream) as writer:
        writer.add_metadata(METADATA_NAME, {"metadata": to_json(recording.metadata)})
        writer.add_metadata("units", {name: unit for name, unit in units.items() if unit})
        topics, schemas = [], dict[str, Schema]()
        for topic, kind, form, fields in _topics(recording, units, scene.efforts if scene else {}):
            if form not in schemas:
                count = sum(schema.name.startswith(kind) for schema in schemas.values())
                schemas[form] = writer.register_msgdef(f"{kind}{count + 1 if count else ''}", form)
            topics.append((topic, schemas[form], fields))
        poses = {int(row): k for k, row in enumerate(scene.rows)} if scene else {}
        if scene:
            text = writer.register_msgdef(ros.STRING, ros.DEFINITIONS[ros.STRING])
            placed = writer.register_msgdef(ros.TRANSFORMS, ros.DEFINITIONS[ros.TRANSFORMS])
            writer.write_message("/robot_description", text, {"data": scene.urdf}, stamps[0])
        for row, stamp in enumerate(stamps):
            for topic, schema, fields in topics:
                message = {field: samples[row] for field, samples in fields.items()}
                message["header"] = ros.header(stamp)
                writer.write_message(topic, schema, message, stamp, stamp, row)
            if scene and row in poses:
                message = _transforms(scene, poses[row], stamp)
                writer.write_message("/tf", placed, message, stamp, stamp, poses[row])


def _topics(
    recording: Recording, units: Mapping[str, str], efforts: Mapping[str, np.ndarray]
) -> Iterator[tuple[str, str, str, dict[str, list]]]:
    """Yields topics with message type, message definition, and samples by field.

    Columns of a joint's hydraulics or drive go to `/<joint>/hydraulics`, the joint's other columns
    to `/<joint>/control`; a topic with a single column is named after the column instead.
    """
    joints = list(recording.joints)
    known = {**recording.columns, **{f"{joint}_effort": x for joint, x in efforts.items()}}
    states = {"name": [joints] * len(recording)}
    for field in ("position", "velocity", "effort") if joints else ():
        # A JointState has velocities of all joints or of none, and efforts of all or of none.
        if all(f"{joint}_{field}" in known for joint in joints):
            states[field] = np.column_stack([known.pop(f"{j}_{field}") for j in joints]).tolist()
    yield _CLOCK_TOPIC, ros.JOINT_STATE, ros.DEFINITIONS[ros.JOINT_STATE], states
    names = {name: known[name].tolist() for name in recording.columns if name in known}
    found: dict[str, dict[str, str]] = {}
    for name in names:
        owners = [joint for joint in joints if name.startswith(f"{joint}_")]
        joint = max(owners, key=len, default="")
        field = name.removeprefix(f"{joint}_")
        allowed = re.fullmatch("[a-z](_?[a-z0-9])*", field)  # by ROS
        if not owners or not allowed or field in ("header", "position", "velocity"):
            continue
        actuator = recording.actuator_of(joint)
        of_drive = actuator is not None and name.startswith(f"{actuator}_")
        part = "hydraulics" if of_drive or field in _HYDRAULIC else "control"
        found.setdefault(f"{joint}/{part}", {})[field] = name
    for topic, fields in found.items():
        if len(fields) > 1 and topic not in recording:
            kind = ros.OWN_PACKAGE + topic.rpartition("/")[2].capitalize()
            form = ros.own_definition({field: units[name] for field, name in fields.items()})
            yield f"/{topic}", kind, form, {field: names.pop(n) for field, n in fields.items()}
    for name, samples in names.items():
        kind, field = ros.scalar(name)
        yield f"/{name}", kind, ros.DEFINITIONS[kind], {field: samples}


def _transforms(scene: Scene, index: int, stamp: int) -> dict[str, Any]:
    """Returns the message with the poses of all links of a scene at one sample, `index`."""
    places, turns = scene.positions[index].tolist(), scene.quaternions[index].tolist()
    placed = []
    for link, parent in enumerate(scene.parents[1:], start=1):
        begin = {**ros.header(stamp), "frame_id": scene.links[parent]}
        translation = dict(zip("xyz", places[link], strict=True))
        pose = {"translation": translation, "rotation": dict(zip("wxyz", turns[link], strict=True))}
        placed.append({"header": begin, "child_frame_id": scene.links[link], "transform": pose})
    return {"transforms": placed}


def _files_of(path: Path, salvage: bool) -> tuple[list[Path], list[str]]:
    """Returns the files of a bag, and a message on missing files, if any."""
    if not path.is_dir():
        return [path], []
    files = {f.name.removesuffix(".zstd"): f for kind in _PARTS for f in path.glob(kind)}
    listed = (f.read_text("utf-8", "replace") for f in path.glob("metadata.yaml"))
    named = set(_PART.findall("".join(listed)))
    lacking = ", ".join(sorted(named - files.keys()))
    lost = [f"no {lacking}, which metadata.yaml names"] if lacking else []
    if lost and not salvage:
        raise FileError(lost[0] + ("; --salvage reads the others" if files else ""))
    series = {re.sub(r"_\d+$", "", Path(name).stem) for name in files}
    if not files or (len(series) > 1 and not named):
        found = ", ".join(sorted(files)) or "none"
        raise FileError(f"a bag with {len(files)} .mcap files ({found}); allowed: ", allowed="one")
    return [files[name] for name in sorted(named & files.keys() or files)], lost


def _clock_topic(bag: Bag, columns: ColumnMap) -> str:
    types = {channel.topic: bag.kind(number) for number, channel in bag.channels.items()}
    candidates = sorted(topic for topic, kind in types.items() if kind == ros.JOINT_STATE)
    if not candidates:
        # In a damaged file the name of a type may contain anything, also line ends.
        found = ", ".join(f"{t!r} ({kind!r})" for t, kind in types.items()) or "no topic"
        text = f"no topic of type {ros.JOINT_STATE}; found {found}"
        if forms := {c.message_encoding for c in bag.channels.values()} - {"cdr"}:
            text += f"; messages encoded as {', '.join(map(repr, sorted(forms)))} are not read: "
            text += "export them as CSV (PlotJuggler, Foxglove)"
        raise RecordingError(text, allowed=(ros.JOINT_STATE,))
    wanted = columns.settings.clock
    clock = wanted or (candidates[0] if len(candidates) == 1 else _CLOCK_TOPIC)
    if clock in candidates:
        return clock
    if wanted:
        raise RecordingError.unknown(f"clock of {columns.source}", wanted, candidates)
    text = f"several topics of type {ros.JOINT_STATE}, none of them {_CLOCK_TOPIC!r}; choose one "
    text += f"by clock = ... in a column map: {', '.join(map(repr, candidates))}"
    raise RecordingError(text, allowed=candidates)
