"""Whatever is in a file, only a LeglabError comes out."""

import random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType

from leglab import data
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.data.ros_messages import FLOAT64, JOINT_STATE
from tests.data.test_mcap import joints, write_bag

MESSAGES = [
    message
    for t in range(1, 4)
    for message in (
        ("/joint_states", JOINT_STATE, t, joints(t, velocity=[0.5], effort=[1.5])),
        ("/u", FLOAT64, t, {"data": 0.25}),
    )
]


# Without checksums mutations get through to the decompressors and to the messages.
KINDS = [(CompressionType.ZSTD, True), *((kind, False) for kind in CompressionType)]


@pytest.fixture(scope="module", params=KINDS, ids=lambda k: f"{k[0].name}-{k[1]}")
def bag(request, tmp_path_factory):
    compression, checksums = request.param
    path = tmp_path_factory.mktemp("bag") / "whole.mcap"
    write_bag(path, MESSAGES, compression=compression, enable_crcs=checksums)
    assert len(data.read(path)) == 3
    return path


def outcome(read, path):
    """Returns what was read, or the message of the refusal."""
    try:
        return read(path)
    except LeglabError as error:
        return str(error)


def read_or_refuse(path):
    found = outcome(data.read, path)
    assert isinstance(found, Recording) or (str(path) in found and "\n" not in found)


def test_a_truncated_bag_is_refused(bag):
    whole = bag.read_bytes()
    path = bag.with_name("cut.mcap")
    for length in [0, 1, 8, 20, *range(30, len(whole), 37), len(whole) - 1]:
        path.write_bytes(whole[:length])
        with pytest.raises(LeglabError, match="not a complete MCAP file") as caught:
            data.read(path)
        assert "\n" not in str(caught.value)


mutations = st.lists(
    st.tuples(
        st.sampled_from(["flip", "huge", "cut", "repeat", "insert"]),
        st.integers(0, 1 << 20),
        st.integers(0, 1 << 20),
    ),
    min_size=1,
    max_size=4,
)


def mutate(content, changes):
    content = bytearray(content)
    for kind, where, what in changes:
        i = where % max(len(content), 1)
        j = i + what % 40
        if kind == "flip":
            content[i : i + 1] = bytes([what % 256])
        elif kind == "huge":
            content[i : i + 8] = b"\xff" * (what % 9)
        elif kind == "cut":
            del content[i:j]
        elif kind == "repeat":
            content[j:j] = content[i:j]
        else:
            content[i:i] = random.Random(what).randbytes(what % 12)
    return bytes(content)


@settings(max_examples=150, deadline=None)
@given(changes=mutations)
@example(changes=[("flip", 228, 30)])  # a line end in the name of a type
def test_mutated_bags(bag, changes):
    path = bag.with_name("mutated.mcap")
    path.write_bytes(mutate(bag.read_bytes(), changes))
    read_or_refuse(path)


@pytest.mark.parametrize(
    ("suffix", "start"), [("mcap", b"\x89MCAP0\r\n"), ("csv", b""), ("mat", b"")]
)
@settings(max_examples=60, deadline=None)
@given(content=st.binary(max_size=300))
@example(content=b"#")
def test_any_bytes(tmp_path_factory, suffix, start, content):
    path = tmp_path_factory.getbasetemp() / f"any.{suffix}"
    path.write_bytes(start + content)
    read_or_refuse(path)


CELLS = st.one_of(
    st.sampled_from(
        ["", "nan", "1e999", "-0", "0x1F", "true", "2020-01-01", "2020-01-01 00:00:00", "12:30:00"]
    ),
    st.sampled_from(
        ["99999999999999999999", "1,5", '"', "'", "\ufeff", "\x00", "1_0", "∞", "null"]
    ),
    st.floats().map(repr),
    st.integers().map(str),
    st.text(max_size=5),
)


@settings(max_examples=150, deadline=None)
@given(
    header=st.lists(st.one_of(st.sampled_from(["time", "a", "b"]), CELLS), max_size=4),
    rows=st.lists(st.lists(CELLS, max_size=4), max_size=5),
    end=st.sampled_from(["\n", "\r\n", ""]),
)
def test_any_table_as_csv(tmp_path_factory, header, rows, end):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    text = (end or "\n").join(",".join(row) for row in [header, *rows]) + end
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    read_or_refuse(path)


@settings(max_examples=100, deadline=None)
@given(changes=mutations)
def test_mutated_csv(tmp_path_factory, changes):
    path = tmp_path_factory.getbasetemp() / "mutated.csv"
    path.write_bytes(mutate(b"time,a,b\n0,1,2\n0.1,1.5,nan\n0.2,,3e5\n", changes))
    read_or_refuse(path)


@settings(max_examples=40, deadline=None)
@given(content=st.one_of(st.text(max_size=40), st.binary(max_size=40)))
def test_any_text_as_a_column_map(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "any.toml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "replace"))
    found = outcome(data.read_column_map, path)
    assert isinstance(found, data.ColumnMap) or (str(path) in found and "\n" not in found)
