"""The time of logs as they come: types, units, which column, where it begins."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from leglab import data
from leglab.base.errors import LeglabError

START = 1_772_600_767_123_456_000  # ns since 1970
ROWS = np.arange(300)
NANO = 20_000_000 * ROWS  # 50 Hz
DAY = 86_400_000_000_000


def write(path, **columns):
    pq.write_table(pa.table({**columns, "a_position": np.sin(ROWS / 9)}), path)
    return path


def parquet_times():
    per = {"s": 10**9, "ms": 10**6, "us": 1000, "ns": 1}
    for unit, each in per.items():
        ticks = ROWS if unit == "s" else NANO // each
        for zone in (None, "UTC", "Europe/Berlin"):
            yield (
                f"timestamp[{unit}] {zone}",
                pa.array(START // each + ticks, pa.timestamp(unit, zone)),
            )
        yield f"duration[{unit}]", pa.array(ticks, pa.duration(unit))
        clock = (DAY // each - 40 + ticks) % (DAY // each)  # past midnight
        kind = pa.time32 if unit in ("s", "ms") else pa.time64
        width = np.int32 if unit in ("s", "ms") else np.int64
        yield f"time[{unit}]", pa.array(clock.astype(width)).cast(kind(unit))
    yield "date32", pa.array(20_000 + ROWS.astype(np.int32)).cast(pa.date32())
    yield "date64", pa.array(86_400_000 * (20_000 + ROWS)).cast(pa.date64())


PARQUET = dict(parquet_times())


@pytest.mark.parametrize("kind", PARQUET)
def test_every_time_type_of_parquet_is_a_time(tmp_path, kind):
    found = data.read(write(tmp_path / "a.parquet", time=PARQUET[kind]))
    period = 86400 if kind.startswith("date") else 1.0 if "[s]" in kind else 0.02
    np.testing.assert_allclose(found.time, period * ROWS, rtol=1e-12)
    assert ("start_ns" in found.metadata) == kind.startswith(("date", "timestamp"))
    assert " since " in found.metadata["time"]


@pytest.mark.parametrize(
    ("name", "samples", "said"),
    [
        ("stamp", START + NANO, "stamp in ns since 1970, 50 Hz"),
        ("stamp", (START + NANO).astype(np.uint64), "stamp in ns since 1970, 50 Hz"),
        ("timestamp", (START + NANO) // 1000, "timestamp in us since 1970, 50 Hz"),
        ("timestamp", (START + NANO) / 1e9, "timestamp in s since 1970, 50 Hz"),
        ("t", NANO // 10**6, "t in ms since the start, 50 Hz"),
        ("stamp_ms", NANO // 10**6, "stamp_ms in ms since the start, 50 Hz"),
        ("stamp_ms", ROWS * 100, "stamp_ms in ms since the start, 10 Hz"),
        ("Time [us]", NANO / 1e3, "Time [us] in us since the start, 50 Hz"),
        ("time", ROWS, "time in ms since the start, 1000 Hz"),
        ("micros", ROWS * 2000, "micros in micros since the start, 500 Hz"),
        ("knee", (START + NANO).view("M8[ns]"), "knee in ns since 1970, 50 Hz"),
        ("__index_level_0__", ROWS / 50, "__index_level_0__ in s since the start, 50 Hz"),
        ("time_s", ROWS * 2, "time_s in s since the start, 0.5 Hz: is this its unit?"),
    ],
)  # fmt: skip
def test_the_unit_is_taken_and_said(tmp_path, name, samples, said):
    found = data.read(write(tmp_path / "a.parquet", **{name: samples}))
    assert found.metadata["time"] == said
    assert list(found.columns) == ["a_position"]
    assert f"{1 / found.sampling_period:.6g} Hz" in said
    if "1970" in said:
        assert abs(found.metadata["start_ns"] - START) < 1000
        np.testing.assert_allclose(found.time, NANO / 1e9, atol=1e-6)


def test_seconds_and_their_fraction_and_no_digit_is_lost(tmp_path):
    stamps = START + NANO + ROWS  # a float64 resolves 256 ns there
    both = {"header.stamp.sec": stamps // 10**9, "header.stamp.nanosec": stamps % 10**9}
    for columns in (both, {"stamp": stamps}, {"stamp": stamps.view("M8[ns]")}):
        found = data.read(write(tmp_path / "a.parquet", **columns))
        assert found.time.tolist() == ((NANO + ROWS) / 1e9).tolist()
        assert found.metadata["start_ns"] == START


@pytest.mark.parametrize(
    ("columns", "told"),
    [
        ({"t": ROWS * 100}, r"'t' is the time, in steps of 100: in ms 10 Hz, in us 10000 Hz; "),
        ({"t": ROWS / 50, "stamp": ROWS / 50}, r"columns 't' and 'stamp' can be the time; which"),
        ({"index": ROWS}, r"no column 'time', found 'index'"),
        ({"frame_index": ROWS, "index": ROWS}, r"no column 'time', found 'frame_index'"),
        ({"t": ((START + NANO) / 1e9).astype("f4")}, r"float32 resolves 128 s at 1.77e\+09: no"),
        ({"t": (START + NANO).view("M8[ns]").astype("M8[s]")}, r"steps are 1 s: no use"),
    ],
)  # fmt: skip
def test_what_leaves_a_question_is_one(tmp_path, columns, told):
    with pytest.raises(LeglabError, match=told) as caught:
        data.read(write(tmp_path / "a.parquet", **columns))
    assert "\n" not in str(caught.value)
    table, _ = data.read_tables(tmp_path / "a.parquet", partial=True, timed=False)[""]
    assert list(table) == [*columns, "a_position"]
    assert "a_position" in table


def test_a_question_is_answered_by_a_map(tmp_path):
    path = write(tmp_path / "a.parquet", t=ROWS * 100, stamp=START + NANO)
    for text, period in (('t = {name = "time", factor = 1e-6}', 1e-4), ('stamp = "time"', 0.02)):
        (tmp_path / "map.toml").write_text(f"[columns]\n{text}\n")
        found = data.read(path, columns=tmp_path / "map.toml")
        np.testing.assert_allclose(found.time, period * ROWS, rtol=1e-12)


@pytest.mark.parametrize("period", [0.002, 0.001])
def test_an_even_clock_of_float32_has_its_true_rate(tmp_path, period):
    found = data.read(write(tmp_path / "a.parquet", time=(20_000 + period * ROWS).astype("f4")))
    assert found.sampling_period == pytest.approx(period, rel=1e-3)
    assert "float32 resolves 0.00195 s at 2e+04; the rows are even" in found.metadata["time"]


def test_stamps_with_few_digits_have_their_true_rate_or_are_refused(tmp_path):
    angle = np.sin(ROWS / 9).tolist()
    for form, start, told in (
        ("{:.3f}", 0.0, None),
        ("{:.6g}", 123_456.0, "no use; log more digits"),
    ):
        stamps = (form.format(start + k / 2000) for k in ROWS.tolist())
        rows = "".join(f"{t},{a!r}\n" for t, a in zip(stamps, angle, strict=True))
        (tmp_path / "a.csv").write_text("time,a\n" + rows)
        if told:
            with pytest.raises(LeglabError, match=told):
                data.read(tmp_path / "a.csv")
        else:
            found = data.read(tmp_path / "a.csv")
            assert found.sampling_period == pytest.approx(0.0005, rel=1e-3)


def test_rows_that_are_there_twice_are_no_rounded_stamps(tmp_path):
    pq.write_table(pa.table({"time": ROWS // 2, "a": ROWS // 2}), tmp_path / "a.parquet")
    found = data.read(tmp_path / "a.parquet")
    assert len(found) == 150
    assert found.sampling_period == 1e-3
