"""Files by the writers that users have, read with no option or with the map that is proposed."""

import io
import json
import sqlite3
import struct
import zipfile
from contextlib import closing

import duckdb
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_ros2.writer import Writer as RosWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from leglab import data
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.data.ros_messages import DEFINITIONS, FLOAT64, JOINT_STATE
from tests.cli.test_cli import leglab
from tests.data.test_mcap import joints

RATE, ROWS = 50, 300
TIME = np.arange(ROWS) / RATE
POSITION = np.sin(3 * TIME)
EPOCH = 1_700_000_000 * 10**9


def lerobot(root, version, names=("knee.pos", "gripper.pos"), episodes=(0, 1, 2)):
    """A dataset as LeRobot lays it out; positions are smaller by a tenth an episode."""
    rows = [
        {"observation.state": [scale * q, 0.0], "action": [q, 0.0], "timestamp": t}
        | {"frame_index": k, "episode_index": e}
        for e, scale in ((e, 1 - e / 10) for e in episodes)
        for k, (t, q) in enumerate(zip(TIME.tolist(), POSITION.tolist(), strict=True))
    ]
    rows = [r | {"index": i, "task_index": 0, "next.done": False} for i, r in enumerate(rows)]
    pair = pa.list_(pa.float32(), 2) if version == "v3.0" else pa.list_(pa.float32())
    counters = ("frame_index", "episode_index", "index", "task_index")
    fields = {"observation.state": pair, "action": pair, "timestamp": pa.float32()}
    schema = pa.schema(fields | dict.fromkeys(counters, pa.int64()) | {"next.done": pa.bool_()})
    folder = root / "data/chunk-000"
    folder.mkdir(parents=True)
    if version == "v3.0":
        pq.write_table(pa.Table.from_pylist(rows, schema=schema), folder / "file-000.parquet")
    for e in episodes if version == "v2.1" else ():
        own = [row for row in rows if row["episode_index"] == e]
        table = pa.Table.from_pylist(own, schema=schema)
        pq.write_table(table, folder / f"episode_{e:06}.parquet")
    feature = {"dtype": "float32", "shape": [2], "names": names}
    info = {"codebase_version": version, "fps": RATE, "features": {}}
    info["features"] = {"observation.state": feature, "action": feature}
    (root / "meta").mkdir()
    (root / "meta/info.json").write_text(json.dumps(info))
    return root


@pytest.mark.parametrize("names", [["knee.pos", "grip"], {"motors": ["knee.pos", "grip"]}])
@pytest.mark.parametrize("version", ["v3.0", "v2.1"])
def test_an_episode_of_lerobot_is_a_recording_with_columns_by_name(tmp_path, version, names):
    found = data.read_all(lerobot(tmp_path, version, names))
    assert list(found) == ["episode_0", "episode_1", "episode_2"]
    last = found["episode_2"]
    assert {"observation.state/knee.pos", "action/grip"} < last.columns.keys()
    assert not {"index", "timestamp", "frame_index"} & last.columns.keys()
    assert last.time == pytest.approx(TIME, abs=1e-6)
    assert last["observation.state/knee.pos"] == pytest.approx(0.8 * POSITION, abs=1e-6)


def test_a_file_alone_is_cut_into_episodes(tmp_path):
    lerobot(tmp_path / "set", "v3.0")
    file = tmp_path / "alone.parquet"
    (tmp_path / "set/data/chunk-000/file-000.parquet").rename(file)
    found = data.read_all(file)
    assert list(found) == ["episode_0", "episode_1", "episode_2"]
    assert found["episode_1"]["observation.state[0]"] == pytest.approx(0.9 * POSITION, abs=1e-6)


def test_one_file_of_a_dataset_and_the_map_that_is_proposed(tmp_path, capsys):
    lerobot(tmp_path / "set", "v3.0")
    file = str(tmp_path / "set/data/chunk-000/file-000.parquet")
    code, shown, _ = leglab("inspect", file, "--recording", "episode_1", capsys=capsys)
    assert code == 0
    assert "3 recordings" in shown
    assert "50 Hz" in shown
    code, _, error = leglab("convert", file, str(tmp_path / "out.csv"), capsys=capsys)
    assert code == 2
    assert "choose by --recording episode_0, episode_1, episode_2" in error
    with pytest.raises(LeglabError, match="unknown recording"):
        data.read(file, recording="episode_9")


def simulink(time, *signals):
    """What To Workspace saves as a structure with time: values, label of each signal."""
    fields = [("values", "O"), ("dimensions", "O"), ("label", "O"), ("blockName", "O")]
    rows = [(values, float(values.ndim), label, "rig/scope") for values, label in signals]
    return {"time": time[:, None], "signals": np.array(rows, dtype=fields)}


MATRICES = np.moveaxis(np.arange(ROWS * 4.0).reshape(ROWS, 2, 2), 0, -1)


@pytest.mark.parametrize(
    ("variables", "columns"),
    [
        ({"q": simulink(TIME, (POSITION[:, None], "angle"))}, {"q": POSITION}),
        (
            {"scope": simulink(TIME, (POSITION[:, None], "angle"), (TIME[:, None], ""))},
            {"scope/angle": POSITION, "scope[1]": TIME},
        ),
        ({"m": simulink(TIME, (MATRICES, ""))}, {"m[0]": MATRICES[0, 0], "m[3]": MATRICES[1, 1]}),
        (
            {"q": {"Time": TIME, "Data": POSITION}, "tout": TIME, "yout": np.c_[TIME, POSITION]},
            {"q": POSITION, "yout[0]": TIME, "yout[1]": POSITION},
        ),
        ({"tout": TIME, "yout": POSITION, "Ts": 0.02}, {"yout": POSITION}),
    ],
    ids=("one signal", "several signals", "matrices", "beside tout", "tout alone"),
)
def test_forms_of_simulink(tmp_path, variables, columns):
    savemat(tmp_path / "log.mat", variables)
    found = data.read(tmp_path / "log.mat")
    assert found.time == pytest.approx(TIME, abs=1e-12)
    assert len(found.columns) == (4 if "m" in variables else len(columns))
    for name, samples in columns.items():
        assert found[name].tolist() == samples.tolist(), name


def test_series_of_several_clocks_come_onto_the_fastest_one(tmp_path):
    slow = {"time": TIME[::5], "data": TIME[::5]}
    variables = {"knee_position": {"time": TIME, "data": POSITION}, "p": slow, "u_command": slow}
    savemat(tmp_path / "log.mat", variables)
    found = data.read(tmp_path / "log.mat")
    last = (ROWS - 1) // 5 * 5
    assert found["p"][:last] == pytest.approx(TIME[:last], abs=1e-9)
    assert found["u_command"] == pytest.approx(np.floor(np.arange(ROWS) / 5) / 10)
    (note,) = [line for line in found.metadata["alignment"] if line.startswith("u_command: ")]
    assert "60 samples by its own time, last value held on the 300 stamps of" in note


def test_a_struct_that_no_writer_makes_is_refused_with_a_line(tmp_path):
    savemat(tmp_path / "log.mat", {"q": {"time": TIME, "signals": 5.0}})
    with pytest.raises(LeglabError, match=r"log.mat: not a complete .mat file: "):
        data.read(tmp_path / "log.mat")


def element(kind, content):
    return struct.pack("<2I", kind, len(content)) + content + b"\0" * (-len(content) % 8)


@pytest.mark.parametrize(
    ("kind", "way"),
    [
        ("timeseries", r"s.out = struct\('time', out.Time, 'data', out.Data\); save\("),
        ("Simulink.SimulationData.Dataset", r"for k = 1:out.numElements, e = out{k}; s"),
        ("timetable", r"s = table2struct\(timetable2table\(out\), 'ToScalar', true\); save\("),
    ],
)
def test_objects_of_matlab_are_refused_with_the_way_out(tmp_path, kind, way):
    path = tmp_path / "log.mat"
    savemat(path, {"time": TIME})
    texts = b"".join(element(1, text.encode()) for text in ("out", "MCOS", kind))
    numbers = element(6, struct.pack("<2I", 13, 0)) + element(5, struct.pack("<2i", 1, 1))
    content = element(14, numbers + element(1, b"") + element(6, struct.pack("<I", 1)))
    opaque = element(6, struct.pack("<2I", 17, 0)) + texts + content  # as MATLAB writes it
    path.write_bytes(path.read_bytes() + element(14, opaque))
    with pytest.raises(LeglabError, match=f"variable 'out' is a {kind}, .*in MATLAB: {way}"):
        data.read(path)


def test_arrays_of_numpy_by_name(tmp_path):
    path = tmp_path / "log.npz"
    pair = np.zeros(ROWS, dtype=[("p", "f4"), ("i", "i4")])
    stamps = (EPOCH + np.arange(ROWS) * 20_000_000).astype("M8[ns]")
    qpos = np.c_[POSITION, TIME]
    np.savez(path, time=stamps, qpos=qpos, ctrl=POSITION[:, None], pair=pair, joints=["a", "b"])
    found = data.read(path)
    assert list(found.columns) == ["qpos[0]", "qpos[1]", "ctrl", "pair/p", "pair/i"]
    assert found.time == pytest.approx(TIME, abs=1e-9)
    assert found["qpos[0]"].tolist() == POSITION.tolist()
    assert found.metadata["start_ns"] == EPOCH


def test_arrays_of_numpy_that_do_not_fit(tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, time=TIME, knee_position=POSITION[1:])
    with pytest.raises(LeglabError, match="different lengths: 'time' 300, 'knee_position' 299"):
        data.read(path)
    np.savez(path, time=TIME, q=np.array([{}], dtype=object))
    with pytest.raises(LeglabError, match="array 'q' holds Python objects"):
        data.read(path)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(LeglabError, match=r"not a complete .npz file"):
        data.read(path)


STORE = get_typestore(Stores.ROS2_HUMBLE)
STATE, NUMBER = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64"


def rosbag(folder, storage, mode=CompressionMode.NONE, rows=slice(None)):
    """A bag by rosbags: joint states and a command."""
    state, number, header, time = (
        STORE.types[name]
        for name in (STATE, NUMBER, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    writer = Writer(folder, version=8, storage_plugin=storage)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer as bag:
        states = bag.add_connection("/joint_states", STATE, typestore=STORE)
        sent = bag.add_connection("/knee_command", NUMBER, typestore=STORE)
        for t, q in zip(TIME[rows].tolist(), POSITION[rows].tolist(), strict=True):
            ns, none = EPOCH + round(1e9 * t), np.empty(0)
            stamp = header(time(ns // 10**9, ns % 10**9), "")
            message = state(stamp, ["knee"], np.array([q]), none, none)
            bag.write(states, ns, STORE.serialize_cdr(message, STATE))
            bag.write(sent, ns, STORE.serialize_cdr(number(-q), NUMBER))
    return folder


def check_bag(found):
    assert found.time == pytest.approx(TIME, abs=1e-9)
    assert found["knee_position"].tolist() == POSITION.tolist()
    assert found["knee_command"].tolist() == (-POSITION).tolist()


@pytest.mark.parametrize(
    "mode", [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE]
)
@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_bags_of_rosbags(tmp_path, storage, mode):
    folder = rosbag(tmp_path / "bag", storage, mode)
    before = sorted(folder.iterdir())
    check_bag(data.read(folder))
    (folder / "metadata.yaml").unlink()
    check_bag(data.read(folder))
    assert sorted(folder.iterdir()) == [p for p in before if p.name != "metadata.yaml"]


def split_bag(tmp_path):
    """Three files of one bag, as rosbag2 splits it by size."""
    lines = ["rosbag2_bagfile_information:", "  relative_file_paths:"]
    folder = tmp_path / "bag"
    folder.mkdir()
    for k in range(3):
        part = rosbag(tmp_path / f"p{k}", StoragePlugin.MCAP, rows=slice(100 * k, 100 * k + 100))
        (part / f"p{k}.mcap").rename(folder / f"bag_{k}.mcap")
        lines.append(f"  - bag_{k}.mcap")
    (folder / "metadata.yaml").write_text("\n".join(lines) + "\n")
    return folder


def test_a_split_bag_is_one_recording_and_a_lost_part_is_said(tmp_path):
    folder = split_bag(tmp_path)
    check_bag(data.read(folder))
    (folder / "bag_1.mcap").unlink()
    with pytest.raises(LeglabError, match=r"no bag_1.mcap, which metadata.yaml names; --salvage"):
        data.read(folder)
    found = data.read(folder, salvage=True)
    assert len(found) == 200
    assert "no bag_1.mcap" in found.metadata["salvaged"][0]


def test_the_parts_of_a_bag_count_their_types_each_anew(tmp_path):
    for part, kinds in enumerate(((JOINT_STATE, FLOAT64), (FLOAT64, JOINT_STATE))):
        with (tmp_path / f"bag_{part}.mcap").open("wb") as stream, RosWriter(stream) as writer:
            schemas = {kind: writer.register_msgdef(kind, DEFINITIONS[kind]) for kind in kinds}
            message = joints(part + 1, position=[part])
            writer.write_message("/joint_states", schemas[JOINT_STATE], message, part + 1)
            writer.write_message("/u", schemas[FLOAT64], {"data": 5.0 + part}, part + 1)
    found = data.read(tmp_path)
    assert found["knee_position"].tolist() == [0, 1]
    assert found["u"].tolist() == [5, 6]


def chunked(path):
    """A file of many chunks; returns where the data of each begins."""
    data.write(Recording(time=TIME, columns={"knee_position": POSITION}), path)
    source = make_reader(io.BytesIO(path.read_bytes()))
    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=1500, compression=CompressionType.NONE)
        writer.start()
        for schema, channel, message in source.iter_messages():
            if message.sequence == 0:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                number = writer.register_channel(channel.topic, channel.message_encoding, kind)
            writer.add_message(number, message.log_time, message.data, message.publish_time)
        writer.finish()
    with path.open("rb") as stream:
        return [c.chunk_start_offset + 100 for c in make_reader(stream).get_summary().chunk_indexes]


def test_what_is_whole_of_a_broken_file_is_salvaged(tmp_path, capsys):
    path = tmp_path / "log.mcap"
    chunks = chunked(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: chunks[5]] + b"\xff" * 40 + whole[chunks[5] + 40 :])
    code, _, error = leglab("inspect", str(path), capsys=capsys)
    assert code == 2
    assert "--salvage reads what is whole" in error
    code, shown, _ = leglab("inspect", str(path), "--salvage", capsys=capsys)
    assert code == 0
    found = data.read(path, salvage=True)
    (line,) = found.metadata["salvaged"]
    assert line in shown
    assert f"1 of {len(chunks)} chunks are broken" in line
    assert f"{ROWS - len(found)} messages lost" in line
    path.write_bytes(whole[: chunks[-3]])
    cut = data.read(path, salvage=True)
    assert ROWS / 2 < len(cut) < ROWS
    assert f"{len(cut)} readable messages" in cut.metadata["salvaged"][0]


def test_rows_that_are_not_whole_are_salvaged(tmp_path):
    path = tmp_path / "log.csv"
    FRAME.to_csv(path, index=False)
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(LeglabError, match="--salvage leaves such rows out"):
        data.read(path)
    found = data.read(path, salvage=True)
    assert len(found) == ROWS - 1
    assert "1 rows are left out, the first: row 299" in found.metadata["salvaged"][0]


def test_a_message_that_is_not_whole_is_salvaged(tmp_path):
    folder = rosbag(tmp_path / "bag", StoragePlugin.SQLITE3)
    with closing(sqlite3.connect(folder / "bag.db3")) as database, database:
        database.execute("UPDATE messages SET data = x'00' WHERE rowid = 5")
    with pytest.raises(LeglabError, match="topic '/joint_states', message 2"):
        data.read(folder)
    found = data.read(folder, salvage=True)
    assert len(found) == ROWS - 1
    assert "1 messages cannot be decoded" in found.metadata["salvaged"][0]


def test_messages_of_another_encoding_are_refused_with_the_way_out(tmp_path):
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        kind = writer.register_schema("knee", "jsonschema", b"{}")
        number = writer.register_channel("/knee", "json", kind)
        writer.add_message(number, EPOCH, b'{"position": 1.0}', EPOCH)
        writer.finish()
    with pytest.raises(LeglabError, match="encoded as 'json' are not read: export them as CSV"):
        data.read(path)


FRAME = pd.DataFrame({"time": TIME, "knee_position": POSITION, "knee_command": -POSITION})
INDEXED = FRAME.set_index(pd.to_datetime(EPOCH + np.arange(ROWS) * 20_000_000)).drop(columns="time")


def duck(path, options):
    frame = FRAME  # noqa: F841 (DuckDB finds it by name)
    duckdb.sql(f"COPY frame TO '{path}' ({options})")


WRITERS = {
    "pandas.csv": lambda path: FRAME.to_csv(path),
    "index.csv": lambda path: INDEXED.to_csv(path),
    "semicolon.csv": lambda path: FRAME.to_csv(path, sep=";", decimal=",", index=False),
    "pandas.parquet": lambda path: INDEXED.to_parquet(path),
    "duckdb.parquet": lambda path: duck(path, "FORMAT parquet"),
    "duckdb.tsv": lambda path: duck(path, "FORMAT csv, DELIMITER '\t'"),
    "UPPER.CSV": lambda path: FRAME.to_csv(path, index=False),
    "savetxt.csv": lambda path: np.savetxt(
        path, FRAME, delimiter=",", header=",".join(FRAME), comments=""
    ),
    "numpy.npz": lambda path: np.savez(path, **FRAME),
    "scipy.mat": lambda path: savemat(path, {name: FRAME[name].to_numpy() for name in FRAME}),
    "wrong_suffix.csv": lambda path: FRAME.to_parquet(path),
    "bag": lambda path: rosbag(path, StoragePlugin.MCAP),
    "sqlite": lambda path: rosbag(path, StoragePlugin.SQLITE3),
}


@pytest.mark.parametrize("name", WRITERS)
def test_files_of_real_writers_need_no_option(tmp_path, name):
    WRITERS[name](tmp_path / name)
    found = data.read(tmp_path / name, partial=True)
    assert found.time == pytest.approx(TIME, abs=1e-9)
    assert {"knee_position", "knee_command"} <= found.columns.keys()
    assert found["knee_position"] == pytest.approx(POSITION, abs=1e-15)


@pytest.mark.parametrize(
    ("name", "head", "way"),
    [
        ("a.h5", b"\x89HDF\r\n\x1a\n", "python -c .*h5py.File.*numpy.savez"),
        ("a.xlsx", None, "python -c .*read_excel.*to_csv"),
        ("a.parquet.gz", b"\x1f\x8b\x08", "gunzip -k .*a.parquet.gz"),
        ("log", b"\x1f\x8b\x08", "gunzip -k .*log"),
        ("a.csv", b"\x28\xb5\x2f\xfd", "unzstd"),
        ("a.npy", b"\x93NUMPY", "numpy.savez"),
        ("a.bag", b"#ROSBAG V2.0\n", "rosbags-convert --src .* --dst"),
        ("a.xls", b"text", "not a complete .xls file"),
        ("a.docx", b"text", "'.docx' is not a known format, allowed: .parquet"),
    ],
)
def test_what_is_not_read_is_refused_with_the_way_out(tmp_path, name, head, way):
    path = tmp_path / name
    if head is None:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("[Content_Types].xml", "")
            archive.writestr("xl/workbook.xml", "")
    else:
        path.write_bytes(head)
    with pytest.raises(LeglabError, match=way) as caught:
        data.read(path)
    assert str(path) in str(caught.value)
