"""MATLAB files: names, files of others, versions that are refused, broken files."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import loadmat, savemat

from leglab import data
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.data.matlab import field_names
from tests.data.test_data_fuzz import mutate, mutations, read_or_refuse
from tests.data.test_interop import NAMES, example


@settings(deadline=None)
@given(names=st.lists(NAMES, unique=True, max_size=12))
def test_field_names_are_allowed_and_different(names):
    fields = field_names(names)
    assert list(fields) == names
    assert len(set(fields.values())) == len(names)
    for field in fields.values():
        assert len(field) <= 63
        assert field.isascii()
        assert field.isidentifier()
        assert not field.startswith("_")
        assert field not in {"end", "function"}


def test_allowed_names_stay_as_they_are():
    assert field_names(["a b", "a_b", "end", "7"]) == {
        "a b": "a_b_2", "a_b": "a_b", "end": "x_end", "7": "x_7",
    }  # fmt: skip


def test_what_a_user_of_matlab_sees(tmp_path):
    path = data.write(example(), tmp_path / "run.mat")
    found = loadmat(path, simplify_cells=True)["recording"]
    assert set(found) == {"time", "signals", "units", "name_map", "metadata"}
    assert found["units"]["knee_pressure_a"] == "Pa"
    assert np.array_equal(found["signals"]["supply_pressure"], example()["supply_pressure"])
    assert loadmat(path)["recording"]["time"][0, 0].shape == (200, 1)


def test_units_of_metadata_survive(tmp_path):
    recording = example().with_metadata(units={"knee_position": "deg"})
    path = data.write(recording, tmp_path / "run.mat")
    assert data.read(path) == recording


def test_a_column_added_in_matlab(tmp_path):
    path = data.write(example(), tmp_path / "run.mat")
    found = loadmat(path, simplify_cells=True)["recording"]
    found["signals"]["power"] = np.arange(200.0)
    found["units"]["power"] = "W"
    savemat(path, {"recording": found})
    read = data.read(path)
    assert read["power"].tolist() == list(range(200))
    assert read.metadata["units"] == {"power": "W"}


def test_vectors_of_others(tmp_path):
    path = tmp_path / "theirs.mat"
    t = np.arange(5) / 10
    savemat(path, {"t": t, "u": np.arange(5), "x": np.eye(5)[:, :2], "Ts": 0.1, "who": "me"})
    (tmp_path / "map.toml").write_text('[columns]\nt = "time"\nu = "knee_valve_command"\n')
    read = data.read(path, columns=tmp_path / "map.toml")
    assert list(read.columns) == ["knee_valve_command", "x[0]", "x[1]"]
    assert read["x[1]"].tolist() == [0, 1, 0, 0, 0]
    assert read.metadata["left_out"] == ["Ts", "who"]
    assert data.read(path).time.tolist() == t.tolist()
    savemat(path, {"log": {"time": t, "u": t}})
    assert list(data.read(path).columns) == ["u"]
    savemat(path, {"time": t, "u": np.arange(4)})
    with pytest.raises(LeglabError, match="'time' 5, 'u' 4"):
        data.read(path)


@pytest.mark.parametrize("offset", [0, 512])
def test_version_7_3_is_refused_with_the_way_out(tmp_path, offset):
    path = tmp_path / "new.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: x".ljust(offset) + b"\x89HDF\r\n\x1a\n" * 9)
    with pytest.raises(LeglabError, match=r"7\.3 \(HDF5\).*'-v7'"):
        data.read(path)


def whole_file(path, compressed):
    recording = Recording(
        time=[0.0, 0.1, 0.2],
        columns={"knee_position": [1.0, np.nan, 2.0], "ü": [3.0, 4.0, 5.0]},
        metadata={"seed": 1, "repairs": []},
    )
    if compressed:
        return data.write(recording, path).read_bytes()
    # The same without compression: mutations reach the parser.
    data.write(recording, path)
    content = loadmat(path, simplify_cells=True)["recording"]
    savemat(path, {"recording": content, "more": [1.0, 2.0], "text": "x", "cell": [1, "a"]})
    assert len(data.read(path)) == 3
    return path.read_bytes()


@pytest.mark.parametrize("compressed", [True, False])
def test_a_truncated_file_is_refused(tmp_path, compressed):
    whole = whole_file(tmp_path / "whole.mat", compressed)
    path = tmp_path / "cut.mat"
    for length in [0, 127, 130, len(whole) - 2]:
        path.write_bytes(whole[:length])
        read_or_refuse(path)


def test_a_file_that_ends_the_reader_is_refused(tmp_path):
    path = tmp_path / "broken.mat"
    whole = whole_file(path, compressed=False)
    path.write_bytes(whole[:273] + bytes([159]) + whole[274:])  # ends scipy's reader
    with pytest.raises(LeglabError, match="broken.mat: not a complete MATLAB file: it stops"):
        data.read(path)


@settings(max_examples=5, deadline=None)
@given(changes=mutations)
def test_mutated_files(tmp_path_factory, changes):
    path = tmp_path_factory.getbasetemp() / "mutated.mat"
    whole = whole_file(path, compressed=False)
    path.write_bytes(mutate(whole[:128], []) + mutate(whole[128:], changes))
    read_or_refuse(path)
