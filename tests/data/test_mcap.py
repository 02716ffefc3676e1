import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer

from leglab import data
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.data.ros_messages import DEFINITIONS as OURS
from leglab.data.ros_messages import FLOAT64, JOINT_STATE

DEFINITIONS = {
    **{kind: OURS[kind] for kind in (JOINT_STATE, FLOAT64, "sensor_msgs/msg/FluidPressure")},
    "std_msgs/msg/Float64MultiArray": "float64[] data\n",
    "std_msgs/msg/String": "string data\n",
}
MS = 10**6
EPOCH = 1_760_000_000 * 10**9


def stamp(time):
    return {"stamp": {"sec": time // 10**9, "nanosec": time % 10**9}, "frame_id": ""}


def joints(time, **fields):
    return {"header": stamp(time), "name": ["knee"], "position": [0.0], **fields}


def write_bag(path, messages, **options):
    """Writes (topic, type, log time in ns, message)."""
    with path.open("wb") as stream, Writer(stream, **options) as writer:
        schemas = {kind: writer.register_msgdef(kind, text) for kind, text in DEFINITIONS.items()}
        for topic, kind, time, message in messages:
            writer.write_message(topic, schemas[kind], message, time)
    return path


def joint_messages(times, latency=0):
    return [
        ("/joint_states", JOINT_STATE, t + latency, joints(t, position=[t / 1e9])) for t in times
    ]


def example():
    time = np.arange(40) * 0.001
    columns = {
        "knee_position": np.sin(7 * time),
        "knee_velocity": 7 * np.cos(7 * time),
        "hip_position": np.cos(time),
        "knee_valve_command": np.cos(5 * time),
        "knee_pressure_a": 1e7 + time / 3,
    }
    return Recording(time=time, columns=columns, metadata={"seed": 3, "text": "°C"})


@settings(max_examples=25, deadline=None)
@given(samples=hnp.arrays(np.float64, st.integers(1, 8), elements=st.floats(width=64)))
def test_every_bit_survives_a_file(tmp_path_factory, samples):
    path = tmp_path_factory.mktemp("data") / "recording.mcap"
    time = 0.25 * np.arange(samples.size)
    columns = dict.fromkeys(("a_position", "a_velocity", "b_position", "v_command"), samples)
    recording = Recording(time=time, columns=columns, metadata={"seed": 1})
    data.write(recording, path)
    assert data.read(path) == recording


def test_round_trip_of_a_recording_with_partial_velocities(tmp_path):
    recording = example()
    read = data.read(data.write(recording, tmp_path / "a.mcap"))
    np.testing.assert_allclose(read.time, recording.time, rtol=0, atol=1e-15)
    assert read.columns.keys() == recording.columns.keys()
    for name, samples in recording.columns.items():
        np.testing.assert_array_equal(read[name], samples)
    assert read.metadata == recording.metadata
    two = data.write(recording, tmp_path / "b.mcap").read_bytes()
    assert (tmp_path / "a.mcap").read_bytes() == two


def test_other_readers_understand_what_is_written(tmp_path):
    path = data.write(example(), tmp_path / "a.mcap")
    reader = make_reader(io.BytesIO(path.read_bytes()), decoder_factories=[DecoderFactory()])
    decoded = [m for m in reader.iter_decoded_messages() if m.channel.topic == "/joint_states"]
    assert len(decoded) == 40
    message = decoded[3].decoded_message
    assert decoded[3].schema.name == "sensor_msgs/msg/JointState"
    assert message.name == ["knee", "hip"]
    assert message.position == [np.sin(0.021), np.cos(0.003)]
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (0, 3 * MS)


def test_units_stand_in_the_file_for_every_reader(tmp_path):
    recording = example().with_metadata(units={"knee_position": "rad"})
    with data.write(recording, tmp_path / "a.mcap").open("rb") as stream:
        found = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}
    assert found["units"] == {
        "knee_position": "rad",
        "knee_velocity": "rad/s or m/s",
        "hip_position": "rad or m",
        "knee_valve_command": "1",
        "knee_pressure_a": "Pa",
    }


def test_recording_without_joints(tmp_path):
    recording = Recording(time=[0.0, 0.5], columns={"oil_temperature": [20.0, 21.0]})
    assert data.read(data.write(recording, tmp_path / "a.mcap")) == recording


@pytest.mark.parametrize(
    ("time", "columns", "message"),
    [
        ([-1.0, 0.0], {}, r"covers \[-1, 0\] s; allowed"),
        ([0.0, 3e9], {}, "allowed in a ROS message"),
        ([0.0, 1e-10], {}, "rows 0 and 1 are less than 1 ns apart"),
        ([0.0], {"joint_states": [1.0]}, "'joint_states' is taken"),
    ],
)
def test_what_ros_cannot_hold_is_refused(tmp_path, time, columns, message):
    with pytest.raises(LeglabError, match=message):
        data.write(Recording(time=time, columns=columns), tmp_path / "a.mcap")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("compression", list(CompressionType))
def test_topics_of_other_rates(tmp_path, compression):
    messages = joint_messages(range(EPOCH, EPOCH + 20 * MS, MS), latency=MS // 2)
    # Slower than the joints, and linear in time: drawn exactly.
    for t in range(EPOCH + MS // 4, EPOCH + 16 * MS, 5 * MS):
        pressure = {"header": stamp(t), "fluid_pressure": 1e5 + (t - EPOCH), "variance": 0.0}
        messages.append(("/cap", "sensor_msgs/msg/FluidPressure", t, pressure))
    for k, t in enumerate((EPOCH + 3 * MS, EPOCH + 9 * MS)):
        messages.append(("/u", "std_msgs/msg/Float64MultiArray", t, {"data": [k, 10.0 + k]}))
    messages.append(("/talk", "std_msgs/msg/String", EPOCH, {"data": "hello"}))
    path = write_bag(tmp_path / "a.mcap", messages, compression=compression)
    (tmp_path / "map.toml").write_text(
        '[columns]\ncap = {name = "knee_pressure_a", factor = 2.0}\n"u[1]" = "knee_valve_command"\n'
    )
    recording = data.read(path, columns=tmp_path / "map.toml")
    row = np.arange(20)
    np.testing.assert_allclose(recording.time, 1e-3 * row, atol=1e-15)
    assert recording.metadata["start_ns"] == EPOCH
    expected = np.where((row >= 1) & (row <= 15), 2.0 * (1e5 + row * MS), np.nan)
    np.testing.assert_allclose(recording["knee_pressure_a"], expected, rtol=1e-14)
    expected = np.where(row < 3, np.nan, np.where(row < 9, 10.0, 11.0))
    np.testing.assert_array_equal(recording["knee_valve_command"], expected)
    cap, _, command = recording.metadata["alignment"]
    assert cap.startswith("cap: 4 samples by header time, linear on the 20 stamps of /joint_st")
    assert cap.endswith("5 rows without a value")
    assert command.startswith("u[1]: 2 samples by log time, last value held")


def test_nothing_is_drawn_across_a_gap(tmp_path):
    messages = joint_messages(range(0, 40 * MS, MS))
    for t in [*range(0, 10 * MS, 2 * MS), *range(30 * MS, 40 * MS, 2 * MS)]:
        messages.append(("/p", FLOAT64, t, {"data": t / MS}))
    samples = data.read(write_bag(tmp_path / "a.mcap", messages))["p"]
    row = np.arange(40)
    known = (row <= 8) | ((row >= 30) & (row <= 38))
    np.testing.assert_array_equal(samples, np.where(known, row, np.nan))


def test_partial_joint_states_leave_missing_samples(tmp_path):
    messages = joint_messages(range(0, 4 * MS, MS))
    messages[2][3].update(name=["hip", "knee"], position=[5.0, 6.0])
    recording = data.read(write_bag(tmp_path / "a.mcap", messages))
    np.testing.assert_array_equal(recording["hip_position"], [np.nan, np.nan, 5.0, np.nan])
    assert recording["knee_position"][2] == 6.0


def test_empty_headers_fall_back_to_the_log_time(tmp_path):
    times = range(EPOCH, EPOCH + 3 * MS, MS)
    messages = [("/joint_states", JOINT_STATE, t, joints(0)) for t in times]
    recording = data.read(write_bag(tmp_path / "a.mcap", messages))
    np.testing.assert_allclose(recording.time, [0, 0.001, 0.002])
    assert recording.metadata["alignment"] == ["/joint_states: no header stamps, log time instead"]


def test_clocks_that_do_not_meet(tmp_path):
    messages = joint_messages(range(0, 5 * MS, MS), latency=EPOCH)
    messages += [("/u", FLOAT64, EPOCH + t * MS, {"data": t}) for t in range(5)]
    path = write_bag(tmp_path / "a.mcap", messages)
    recording = data.read(path)
    assert tuple(recording.columns) == ("knee_position",)
    assert "left out, no time in common: 'u' covers" in recording.metadata["alignment"][0]
    (tmp_path / "map.toml").write_text('[columns]\nu = "v_command"\n')
    with pytest.raises(LeglabError, match="'u' covers .* by log stamps, .*try stamps = \"log\""):
        data.read(path, columns=tmp_path / "map.toml")
    (tmp_path / "map.toml").write_text('stamps = "log"\n[columns]\nu = "v_command"\n')
    recording = data.read(path, columns=tmp_path / "map.toml")
    np.testing.assert_array_equal(recording["v_command"], range(5))


def test_several_joint_state_topics(tmp_path):
    messages = []
    for t in range(3):
        for topic in ("/left", "/right"):
            messages.append((topic, JOINT_STATE, t * MS, joints(t * MS, effort=[t])))
    path = write_bag(tmp_path / "a.mcap", messages)
    with pytest.raises(LeglabError, match="several topics .*clock = .*: '/left', '/right'"):
        data.read(path)
    text = 'clock = "/right"\n[columns]\n"left/knee/effort" = "knee_valve_command"\n'
    (tmp_path / "map.toml").write_text(text)
    recording = data.read(path, columns=tmp_path / "map.toml")
    assert {"knee_position", "knee_effort", "left/knee/position"} <= recording.columns.keys()
    np.testing.assert_array_equal(recording["knee_valve_command"], range(3))
    (tmp_path / "map.toml").write_text(text.replace("/right", "/rihgt"))
    with pytest.raises(LeglabError, match="unknown clock .*'/rihgt'.*did you mean '/right'"):
        data.read(path, columns=tmp_path / "map.toml")


@pytest.mark.parametrize(
    ("messages", "message"),
    [
        ([("/u", FLOAT64, 0, {"data": 1})], r"no topic of type .*; found '/u' \('std_msgs/msg/Fl"),
        ([], "no topic of type sensor_msgs/msg/JointState; found no topic"),
        (joint_messages([0, 2, 1]), "column 'time', row 2: 1e-09 s comes after 2e-09 s"),
        (
            [("/j", JOINT_STATE, 0, joints(0, position=[1.0, 2.0]))],
            "topic '/j', message 0: 2 values of position for 1 joints",
        ),
        (
            [("/j", JOINT_STATE, 0, joints(0, name=["a", "a"], position=[1.0, 2.0]))],
            r"topic '/j', message 0: joints \['a', 'a'\] are not all different",
        ),
        (
            [("/knee_position", FLOAT64, 1, {"data": 1}), *joint_messages(range(1, 3))],
            "'/knee_position' and another one both give column 'knee_position'",
        ),
        (
            [("/time", FLOAT64, 1, {"data": 1}), *joint_messages(range(1, 3))],
            "a topic is called 'time'",
        ),
    ],
)
def test_bags_that_cannot_be_used(tmp_path, messages, message):
    # The log order is the list's, so that header stamps may go backwards.
    messages = [(topic, kind, k + 1, m) for k, (topic, kind, _, m) in enumerate(messages)]
    path = write_bag(tmp_path / "a.mcap", messages)
    with pytest.raises(LeglabError, match=message) as caught:
        data.read(path)
    assert str(path) in str(caught.value)


def test_the_folder_of_a_bag(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    with pytest.raises(LeglabError, match=r"a bag with 0 .mcap files \(none\); allowed: one"):
        data.read(folder)
    data.write(example(), folder / "bag_0.mcap")
    assert data.read(folder) == data.read(folder / "bag_0.mcap")


@pytest.mark.parametrize("text", ["", "[1]", '{"a": NaN}'])
def test_broken_metadata(tmp_path, text):
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream, Writer(stream) as writer:
        writer.add_metadata("leglab", {"metadata": text})
    with pytest.raises(LeglabError, match="a.mcap: not a complete MCAP file: after 0"):
        data.read(path)
