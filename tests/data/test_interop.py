"""Recordings to and from the formats of other tools."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.reader import SeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory
from mujoco.sysid._src.timeseries import SignalType, TimeSeries

from leglab import data
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.base.units import unit_of

# Not all of Unicode: its tables take Hypothesis seconds on a busy machine.
CHARACTERS = st.sampled_from("aZ9_ .,;:'\"\\/[]{}%\t\n\x01äΩ膝\u2028😀")
TEXT = st.text(CHARACTERS, max_size=5)
NAMES = st.one_of(
    st.sampled_from(["knee_position", "knee_velocity", "knee_valve_command", "knee_pressure_a"]),
    st.sampled_from(["supply_pressure", "end", "Drehzahl für 2", "膝_command", "a/b", "x" * 70]),
    st.text(CHARACTERS, min_size=1, max_size=8),
)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
    | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner),
    max_leaves=5,
)  # fmt: skip
METADATA = st.dictionaries(
    TEXT.filter(lambda key: key not in {"units", "repairs", "alignment"}),
    JSON,
)


@st.composite
def recordings(draw, names=NAMES, metadata=METADATA):
    """Any recording whose last row is not empty, for those are dropped as a repair."""
    rows = draw(st.integers(1, 6))
    steps = draw(hnp.arrays(float, rows, elements=st.floats(1e-6, 10.0)))
    columns = draw(
        st.dictionaries(names, hnp.arrays(float, rows, elements=st.floats(width=64)), max_size=4)
    )
    return Recording(time=np.cumsum(steps), columns=columns, metadata=draw(metadata))


def bits(recording):
    """The samples as their bits, NaN as one: -0.0 is not 0.0 here."""
    columns = {"time": recording.time, **recording.columns}
    return {n: np.where(np.isnan(c), np.nan, c).tobytes() for n, c in columns.items()}


def example(rows=200):
    time = 3.0 + np.arange(rows) * 0.002
    angle = np.sin(7 * time)
    angle[5:9] = np.nan
    return Recording(
        time=time,
        columns={
            "knee_position": angle,
            "knee_velocity": 7 * np.cos(7 * time),
            "knee_valve_command": np.tanh(angle),
            "knee_pressure_a": 1e6 * (5 + angle) / 3,
            "supply_pressure": np.full(rows, 1e7 / 3),
            "oil_temperature": 40 + time / 7,
        },
        metadata={"seed": 3, "note": "Öl ☂", "nested": {"list": [1, None, 0.1]}},
    )


@pytest.mark.parametrize("suffix", ["parquet", "mat", "npz"])
@settings(max_examples=10, deadline=None)
@given(drawn=st.data())
def test_every_bit_survives(suffix, drawn, tmp_path_factory):
    recording = drawn.draw(recordings(metadata=st.just({}) if suffix == "npz" else METADATA))
    path = data.write(recording, tmp_path_factory.getbasetemp() / f"any.{suffix}")
    found = [data.read(path, repair=False)]
    if suffix == "npz":
        found.append(data.from_time_series(data.to_time_series(recording)))
    for read in found:
        assert bits(read) == bits(recording)
        assert list(read.columns) == list(recording.columns)
        assert dict(read.metadata) == dict(recording.metadata)


def test_time_series_has_signals_of_mujoco():
    recording = example()
    series = data.to_time_series(recording)
    assert isinstance(series, TimeSeries)
    kinds = {name: kind for name, (kind, _) in series.signal_mapping.items()}
    assert kinds == {
        "knee_qpos": SignalType.MjStateQPos,
        "knee_qvel": SignalType.MjStateQVel,
        "knee_valve_ctrl": SignalType.MjCtrl,
        "knee_pressure_a": SignalType.CustomObs,
        "supply_pressure": SignalType.CustomObs,
        "oil_temperature": SignalType.CustomObs,
    }
    controls = data.to_time_series(recording.select(["knee_valve_command"]))
    held = controls.get(np.array([3.0031]), method="zoh")[1]
    assert held[0, 0] == recording["knee_valve_command"][1]


def test_time_series_of_a_model(knee_model):
    names = ["knee_qpos", "knee_qvel"]
    samples = np.arange(6.0).reshape(3, 2)
    series = TimeSeries.from_names(np.arange(3) / 10, samples, knee_model, names)
    recording = data.from_time_series(series)
    assert recording["knee_position"].tolist() == [0, 2, 4]
    assert recording["knee_velocity"].tolist() == [1, 3, 5]
    unnamed = data.from_time_series(TimeSeries(np.arange(3) / 10, samples))
    assert list(unnamed.columns) == ["signal[0]", "signal[1]"]


@pytest.fixture
def knee_model():
    import mujoco

    return mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='knee'/><geom size='1'/></body></worldbody></mujoco>"
    )


def test_time_series_errors(tmp_path):
    recording = Recording(time=[0.0], columns={"a_position": [1.0], "a_qpos": [2.0]})
    with pytest.raises(LeglabError, match="'a_qpos'"):
        data.to_time_series(recording)
    outside = TimeSeries(np.arange(2.0), np.ones((2, 1)), {"a": (SignalType.MjCtrl, [3])})
    with pytest.raises(LeglabError, match="column 3 of 1"):
        data.from_time_series(outside)


def test_mcap_is_what_foxglove_opens(tmp_path):
    """By the reader of the `mcap` package that seeks by the index, as Foxglove does."""
    recording = example(rows=30_000)
    path = data.write(recording, tmp_path / "run.mcap")
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        assert isinstance(reader, SeekingReader)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert len(summary.chunk_indexes) > 1
        assert summary.statistics.message_count == 30_000 * 4
        assert all(chunk.message_index_offsets for chunk in summary.chunk_indexes)
        schemas = {c.topic: summary.schemas[c.schema_id] for c in summary.channels.values()}
        assert {topic: schema.name for topic, schema in schemas.items()} == {
            "/joint_states": "sensor_msgs/msg/JointState",
            "/knee/hydraulics": "leglab_msgs/msg/Hydraulics",
            "/supply_pressure": "sensor_msgs/msg/FluidPressure",
            "/oil_temperature": "sensor_msgs/msg/Temperature",
        }
        assert {schema.encoding for schema in schemas.values()} == {"ros2msg"}
        pressure = [
            (message.log_time, content.pressure_a)
            for _, _, message, content in reader.iter_decoded_messages(
                topics="/knee/hydraulics", starting_at=10 * 10**9, ending_before=11 * 10**9
            )
        ]
    assert len(pressure) == 500
    rows = [round((stamp / 1e9 - 3.0) / 0.002) for stamp, _ in pressure]
    assert [value for _, value in pressure] == recording["knee_pressure_a"][rows].tolist()
    assert bits(data.read(path).select(recording.columns)) | {"time": b""} == (
        bits(recording) | {"time": b""}
    )


@pytest.mark.parametrize("suffix", [".parquet", ".mat", ".npz", ".csv", ".mcap"])
def test_same_recording_same_bytes(suffix, tmp_path):
    one = data.write(example(), tmp_path / f"one{suffix}").read_bytes()
    assert data.write(example(), tmp_path / f"two{suffix}").read_bytes() == one


def test_units_by_name_and_by_metadata():
    assert unit_of("knee_pressure_a", {}) == "Pa"
    assert unit_of("knee_position", {"units": {"knee_position": "deg"}}) == "deg"
    assert unit_of("oil_temperature", {"units": 3}) == "degC"
    assert unit_of("whatever", {}) == ""


def test_unknown_format(tmp_path):
    with pytest.raises(LeglabError, match="unknown format 'matlb'.*did you mean 'matlab'"):
        data.write(example(), tmp_path / "x.mat", "matlb")
