import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from benchmarks.measured import shared_data
from leglab import data
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.data.checks import drop_redundant_rows
from tests.helpers.measured import or_skip

FORMATS = ["csv", "parquet"]


def example(n=100, **metadata):
    time = np.arange(n) * 0.001
    columns = {"knee_position": np.sin(7 * time), "knee_valve_command": np.cos(5 * time)}
    return Recording(time=time, columns=columns, metadata=metadata)


def table(**changes):
    recording = example(20)
    return {"time": recording.time.copy(), **recording.columns, **changes}


def kinds(findings):
    return [(f.kind, f.column, f.row, f.count) for f in findings]


@pytest.mark.parametrize("suffix", FORMATS)
@settings(deadline=None)
@given(
    samples=hnp.arrays(
        np.float64,
        st.integers(1, 30),
        elements=st.floats(allow_infinity=True, allow_nan=True, width=64),
    )
)
def test_every_bit_survives_a_file(tmp_path_factory, suffix, samples):
    path = tmp_path_factory.mktemp("data") / f"recording.{suffix}"
    time = np.cumsum(np.full(samples.size, 0.1))
    columns = {"knee_position": samples, "b_command": np.arange(samples.size) * 1.0}
    recording = Recording(time=time, columns=columns)
    data.write(recording, path)
    assert data.read(path) == recording


def test_metadata_survives_parquet(tmp_path):
    recording = example(seed=3, scenario={"name": "seal_wear", "severity": 10.0}, text="°C")
    path = data.write(recording, tmp_path / "recording.parquet")
    assert data.read(path) == recording


def test_same_recording_same_bytes(tmp_path):
    one = data.write(example(b=1, a=2), tmp_path / "one.parquet").read_bytes()
    assert data.write(example(a=2, b=1), tmp_path / "two.parquet").read_bytes() == one


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "metrics.json"
    path.write_text("old")

    def fail(stream):
        stream.write(b"half")
        raise RuntimeError("disk full")

    with pytest.raises(RuntimeError, match="disk full"):
        data.write_atomically(path, fail)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_written_file_has_usual_permissions(tmp_path):
    (tmp_path / "plain").write_text("")
    data.write_atomically(tmp_path / "ours", lambda stream: stream.write(b"x"))
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize("suffix", FORMATS)
def test_missing_file_and_folder(tmp_path, suffix):
    with pytest.raises(LeglabError, match="no such file"):
        data.read(tmp_path / f"none.{suffix}")
    with pytest.raises(LeglabError, match="cannot be written: No such file or directory"):
        data.write(example(), tmp_path / "none" / f"a.{suffix}")


def test_truncated_parquet(tmp_path):
    path = data.write(example(), tmp_path / "a.parquet")
    whole = path.read_bytes()
    for length in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(LeglabError, match="not a complete Parquet file") as caught:
            data.read(path)
        assert "\n" not in str(caught.value)


def test_truncated_csv(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time,knee_position\n0.0,1.0\n0.1,1.5\n0.2")
    with pytest.raises(LeglabError, match=r"row 2 has 1 cells instead of 2 \('0.2'\); .*truncated"):
        data.read(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not a CSV file"),
        ("time,a\n", "no sample"),
        ("t,a\n0,1\n", "no column 'time', found 't', 'a'; --columns FILE says"),
        ("time,a,a\n0,1,2\n", "column 'a' is there 2 times"),
        ("time,Unnamed: 1,Unnamed: 1\n0,,2\n1,,3\n2,4,5\n", "'Unnamed: 1' is there 2 times"),
        ("time,a\n0,1\n1,broken\n2,3\n", "column 'a', row 1: 'broken' is not a number"),
        ("time,a\n0,1,2\n0.1,1\n0.2,1\n0.3,1", "row 0 has 3 cells instead of 2"),
        ("time,a\n0,x\n0.1,1\n0.2,1\n", "column 'a', row 0: 'x' is not a number"),
        ("time;a\n0;1,234\n1;2,345\n", "'1,234' may have a decimal comma or group thousands; wh"),
        ('time,a\n0,"1,234.5"\n1,"2,345.6"\n', "row 0: '1,234.5' is not a number"),
        ("time,a\n0,1\n0.2,2\n0.1,3\n", "column 'time', row 2: 0.1 s comes after 0.2 s"),
        ("time,a\n0,1\n,2\n1,3\n", "column 'time', row 1: nan is not a finite time"),
    ],
)
def test_bad_csv(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(LeglabError, match=message) as caught:
        data.read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_empty_cells_are_missing_samples(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time,a,b\n0,1,\n1,,\n2,NaN,\n3,4,\n")
    columns, _ = data.read_tables(path)[""]
    np.testing.assert_array_equal(columns["a"], [1, np.nan, np.nan, 4])
    assert kinds(data.inspect(columns)) == [("nan_run", "a", 1, 2), ("nan_run", "b", 0, 4)]


def test_clean_data_has_no_finding():
    assert data.inspect(example()) == ()


def test_gap_counts_only_lost_samples():
    time = table()["time"]
    jitter = time + 0.0002 * np.sin(np.arange(20))
    assert data.inspect(table(time=jitter)) == ()
    time[10:] += 0.001
    (finding,) = data.inspect(table(time=time))
    assert kinds([finding]) == [("gap", "time", 10, 1)]
    assert "0.002 s after the row before, usual are 0.001 s" in finding.message
    assert not finding.fatal


def test_repeated_and_reversed_time():
    time = table()["time"]
    time[5] = time[4]
    time[9] = time[7] - 0.0005
    findings = [f for f in data.inspect(table(time=time)) if f.fatal]
    assert kinds(findings) == [("repeated_time", "time", 5, 1), ("reversed_time", "time", 9, 1)]
    with pytest.raises(LeglabError, match=r"row 5: 0.004 s again.*\(1 more such findings\)"):
        data.checks.to_recording(table(time=time), {}, source="x", repair=True)


def test_constant_nan_and_infinite_columns():
    broken = np.sin(np.arange(20.0))
    broken[3:6] = np.nan
    broken[9] = np.inf
    findings = data.inspect(table(a=np.full(20, 2.5), b=broken))
    assert kinds(findings) == [
        ("constant", "a", 0, 20),
        ("nan_run", "b", 3, 3),
        ("infinite", "b", 9, 1),
    ]
    assert "2.5 in every row" in findings[0].message


def test_exact_repetitions_are_dropped_and_noted(tmp_path):
    clean = table()
    order = np.sort(np.append(np.arange(20), [4, 4, 11]))
    dirty = {name: samples[order] for name, samples in clean.items()}
    repaired, notes = drop_redundant_rows(dirty)
    for name, samples in clean.items():
        np.testing.assert_array_equal(repaired[name], samples)
    assert notes == ("dropped 3 exact repetitions of a row, the first is 5",)
    path = tmp_path / "a.csv"
    rows = zip(*dirty.values(), strict=True)
    path.write_text(
        "\n".join([",".join(dirty), *(",".join(map(repr, map(float, r))) for r in rows)])
    )
    assert data.read(path).metadata["repairs"] == list(notes)
    with pytest.raises(LeglabError, match="row 5: repeats row 4 exactly"):
        data.read(path, repair=False)


def test_empty_rows_at_the_end_are_dropped():
    clean = table()
    dirty = {name: np.append(samples, [np.nan, np.nan]) for name, samples in clean.items()}
    repaired, notes = drop_redundant_rows(dirty)
    np.testing.assert_array_equal(repaired["time"], clean["time"])
    assert notes == ("dropped 2 empty rows at the end, from row 20",)


def test_nothing_is_repaired_that_would_be_a_guess():
    time = table()["time"]
    time[5] = time[4]
    samples = np.sin(np.arange(20.0))
    samples[3] = np.nan
    dirty = table(time=time, a=samples)
    repaired, notes = drop_redundant_rows(dirty)
    assert notes == ()
    np.testing.assert_array_equal(repaired["a"], dirty["a"])


def test_the_measured_knee_bench_is_clean():
    paths = sorted(or_skip(shared_data, "knee_bench").glob("*/*.parquet"))
    assert paths
    for path in paths:
        recording = data.read(path)
        assert recording.joints == ("knee",)
        assert recording.actuators == ("knee_valve",)
        assert recording.sampling_period == pytest.approx(0.001)
        assert data.inspect(recording) == ()


def test_no_flipped_bit_of_a_parquet_file_is_read_as_other_numbers(tmp_path):
    recording = example(60, scenario="seal_wear", seed=3)
    path = data.write(recording, tmp_path / "recording.parquet")
    content, refusals = path.read_bytes(), []
    for at in range(0, len(content), 2):
        spoiled = bytearray(content)
        spoiled[at] ^= 1 << at % 8
        path.write_bytes(spoiled)
        try:
            found = data.read(path)
        except LeglabError as error:
            refusals.append(str(error))
        else:
            # A few bits hide the metadata with its checksum.
            assert found.with_metadata(**recording.metadata) == recording, at
    assert len(refusals) > len(content) / 4
    assert all(told.startswith(f"{path}: ") and "\n" not in told for told in refusals)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "Expecting property name"),
        ("[1]", "it holds list, allowed is an object"),
        ('{"a": NaN}', "NaN is not a finite number"),
        ("[" * 100_000, "nested too deep"),
        (b"\xff\xfe\xff", "can't decode"),
    ],
)
def test_parquet_metadata_that_is_not_ours_gets_one_line(tmp_path, text, told):
    path = tmp_path / "a.parquet"
    table = pa.table({"time": [0.0, 1.0], "a": [1.0, 2.0]})
    pq.write_table(table.replace_schema_metadata({b"leglab": text}), path)
    with pytest.raises(LeglabError, match=rf"a\.parquet: metadata 'leglab': .*{told}") as error:
        data.read(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("suffix", [".parquet", ".mcap", ".mat"])
def test_notes_in_metadata_are_lists(suffix, tmp_path):
    recording = Recording(time=[0.0, 1.0], columns={"a_position": [1, 2]}, metadata={"repairs": 3})
    path = data.write(recording, tmp_path / f"a{suffix}")
    with pytest.raises(LeglabError, match="metadata 'alignment' or 'repairs' is no list") as error:
        data.read(path)
    assert str(error.value).startswith(str(path))


def test_a_recording_is_what_pandas_takes():
    pandas = pytest.importorskip("pandas")
    time = np.arange(3) * 0.1
    recording = Recording(time=time, columns={"knee position": np.array([1.0, np.nan, 3.0])})
    frame = pandas.DataFrame(recording)
    assert list(frame.columns) == ["time", "knee position"]
    np.testing.assert_array_equal(frame["time"], time)
    np.testing.assert_array_equal(frame["knee position"], recording["knee position"])
