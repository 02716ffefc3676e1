"""Text with cells as loggers write it: every variant gives the same recording."""

import gzip
import io

import numpy as np
import pytest

from leglab import data
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording

N = 60
TIME = np.arange(N) / 500
ANGLE = np.round(1.25 * np.sin(9 * TIME) - 0.5, 6)
FORCE = np.round(100 * np.cos(9 * TIME), 3)
ROWS = list(zip(TIME.tolist(), ANGLE.tolist(), FORCE.tolist(), strict=True))


def lines(separator=",", decimal=".", end="\n", tail="", form="{!r}"):
    cells = ([form.format(x).replace(".", decimal) for x in row] for row in ROWS)
    return "".join(separator.join(row) + tail + end for row in cells)


LABVIEW = (
    "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
    "***End_of_Header***\t\n\nChannels\t2\t\nSamples\t60\t60\nDate\t2026/11/28\t2026/11/28\n"
    "Y_Unit_Label\trad\tN\nX0\t0.0\t0.0\nDelta_X\t0.002\t0.002\n***End_of_Header***\t\t\n"
)
NAMES = ["time", "angle", "force"]
PLAIN = {
    "plain": "time,angle,force\n" + lines(),
    "blanks after commas": "time, angle, force\n" + lines(", "),
    "semicolons, decimal commas": "time;angle;force\n" + lines(";", ","),
    "tabs, decimal commas": "time\tangle\tforce\n" + lines("\t", ","),
    "bars": "time|angle|force\n" + lines("|"),
    "blanks": "  time   angle  force\n" + lines("   "),
    "aligned blanks": " time angle force\n" + lines(" ", form="{:12.6f}"),
    "crlf": "time,angle,force\r\n" + lines(end="\r\n"),
    "carriage returns": "time,angle,force\r" + lines(end="\r"),
    "mark": "\ufefftime,angle,force\n" + lines(),
    "numpy": "# time,angle,force\n" + lines(form="{:.18e}"),
    "comments": "# a rig\n% of 3, and more\n# nothing, else, here\ntime,angle,force\n# x\n"
    + lines().replace("0.02,", "# 5, 6\n0.02,", 1),
    "comma at the end": "time,angle,force,\n" + lines(tail=","),
    "comma at the end of rows": "time,angle,force\n" + lines(tail=","),
    "quotes": '"time","angle","force"\n' + lines(form='"{!r}"'),
    "quotes, decimal commas": "time,angle,force\n" + lines(",", ",", form='"{!r}"'),
    "blank lines": "\n\ntime,angle,force\n\n" + lines() + "\n\n",
    "labview": LABVIEW + "time\tangle\tforce\tComment\n" + lines("\t"),
    "head of one width": "rig,7,x\noperator,me,\n\ntime,angle,force\n" + lines(),
    "pandas' index": ",time,angle,force\n"
    + "".join(f"{i},{line}\n" for i, line in enumerate(lines().splitlines())),
}


def read(tmp_path, content, name="a.csv", **options):
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return data.read(tmp_path / name, **options)


def check(found):
    np.testing.assert_allclose(found.time, TIME, atol=1e-12)
    angle, force = (next(c for c in found.columns if name in c) for name in ("angle", "force"))
    np.testing.assert_array_equal(found[angle], ANGLE)
    np.testing.assert_array_equal(found[force], FORCE)


@pytest.mark.parametrize("kind", PLAIN)
def test_each_way_of_writing_gives_the_same_numbers(tmp_path, kind):
    found = read(tmp_path, PLAIN[kind])
    check(found)
    assert [name for name in found.columns if not name.startswith("Unnamed")] == NAMES[1:]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1", "gz"])
def test_encodings_and_packed_text(tmp_path, encoding):
    text = "time,angle °,force µ\n" + lines()
    content = gzip.compress(text.encode()) if encoding == "gz" else text.encode(encoding)
    found = read(tmp_path, content, "a.CSV" if encoding != "gz" else "a.csv.gz")
    check(found)
    assert list(found.columns) == ["angle °", "force µ"]


@pytest.mark.parametrize("suffix", ["txt", "tsv", "log", "dat"])
def test_text_has_many_suffixes(tmp_path, suffix):
    check(read(tmp_path, "time\tangle\tforce\n" + lines("\t"), f"a.{suffix}"))


@pytest.mark.parametrize(
    "head",
    [
        "Model,TDS\nRecord Length,60,\nSample Interval,0.002\n\nTIME,angle,force\ns,deg,N\n",
        "time [s],angle [deg],force [N]\n",
        "time,angle,force\n[s],[deg],[N]\n",
        "Time (s),angle (deg),force (N)\n",
    ],
)
def test_units_stand_in_names_or_below(tmp_path, head):
    found = read(tmp_path, head + lines())
    check(found)
    units = [data.units_in_names.split(name).unit for name in found.columns]
    assert units == ["deg", "N"]


def stamped(form):
    stamps = np.datetime64("2026-11-28T23:59:59.950", "ms") + (1000 * TIME).astype("m8[ms]")
    dates = (str(stamp) for stamp in stamps.astype("M8[ms]"))
    return "".join(
        form(date) + f",{a!r},{f!r}\n" for date, (_, a, f) in zip(dates, ROWS, strict=True)
    )


CLOCKS = {
    "iso": (lambda d: d, "time"),
    "basic iso": (lambda d: d.replace("-", "").replace(":", ""), "time"),
    "iso with a blank": (lambda d: d.replace("T", " "), "Timestamp"),
    "utc": (lambda d: d + "Z", "stamp"),
    "zone": (lambda d: d + "+01:00", "stamp"),
    "zone of hours": (lambda d: d + "+01", "stamp"),
    "microseconds": (lambda d: d + "000", "time"),
    "clock": (lambda d: d[11:], "time"),
    "German": (lambda d: f"{d[8:10]}.{d[5:7]}.{d[:4]} {d[11:]}", "Zeit"),
    "American": (lambda d: f"{d[5:7]}/{d[8:10]}/{d[:4]} {d[11:]}", "date"),
    "two columns": (lambda d: d.replace("T", ","), "Date,Time"),
    "two columns, German": (
        lambda d: f"{d[8:10]}.{d[5:7]}.{d[:4]},{d[11:]}",
        "Datum,Uhrzeit",
    ),
}


@pytest.mark.parametrize("kind", CLOCKS)
def test_dates_and_times_of_day_past_midnight(tmp_path, kind):
    form, name = CLOCKS[kind]
    found = read(tmp_path, f"{name},angle,force\n" + stamped(form))
    check(found)
    start = 1_795_910_399_950_000_000 - (3_600_000_000_000 if kind.startswith("zone") else 0)
    assert found.metadata.get("start_ns") == (start if kind != "clock" else None)


@pytest.mark.parametrize("form", ["[{}, {}]", "({}, {})", "[{} {}]"])
def test_booleans_lists_and_missing_samples(tmp_path, form):
    rows = [("true", (1, 2.5), "-"), ("False", (3, 4), "NULL"), ("on", (5, 6), 7)]
    lists = (f'{i / 10},{on},"{form.format(*q)}",{u}\n' for i, (on, q, u) in enumerate(rows))
    found = read(tmp_path, "time,on,q,u\n" + "".join(lists))
    assert found["on"].tolist() == [1, 0, 1]
    assert found["q[1]"].tolist() == [2.5, 4, 6]
    np.testing.assert_array_equal(found["u"], [np.nan, np.nan, 7])


def test_a_map_says_what_the_text_does_not(tmp_path):
    (tmp_path / "map.toml").write_text(
        'decimal = ","\nseparator = ";"\nencoding = "cp437"\nskip = 1\n[columns]\nx = "a"\n'
    )
    rows = "".join(f"{i / 10};{i + 1},{i:03}\n".replace(".", ",") for i in range(9))
    found = read(tmp_path, f"time;x\ntime;x\n{rows}", columns=tmp_path / "map.toml")
    assert found["a"].tolist() == [i + 1 + i / 1000 for i in range(9)]
    (tmp_path / "map.toml").write_text('encoding = "klingon"\n[columns]\nx = "a"\n')
    with pytest.raises(LeglabError, match="unknown encoding: klingon"):
        read(tmp_path, f"time;x\n{rows}", columns=tmp_path / "map.toml")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("time,angle,force\n" + lines(",", ","), "rows have 6 cells, the line above them has 3"),
        ("time knee angle u force\n" + lines(" "), "'time knee angle u force'.*skip = 1"),
        ("time,q,u\n" + "".join(f"{t},[1, 2],3\n" for t in TIME), "rows have 4 cells, .* has 3"),
        ("time,a\n0,x\n" + "".join(f"{t},2\n" for t in TIME), "'a', row 0: 'x' is not a number"),
        ("time;a\n0;1O,5\n0,1;1,5\n0,2;2,5\n", "'a', row 0: '1O,5' is not a number"),
    ],
)
def test_names_and_rows_that_do_not_fit_are_never_guessed(tmp_path, text, told):
    with pytest.raises(LeglabError, match=told) as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_what_numpy_and_pandas_write(tmp_path):
    stream = io.BytesIO()
    table = np.array(ROWS)
    np.savetxt(stream, table, header="time angle force")
    check(read(tmp_path, stream.getvalue(), "a.txt"))
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(table, columns=NAMES)
    frame["time"] = pandas.Timestamp("2026-11-28", tz="Europe/Berlin") + pandas.to_timedelta(
        frame["time"], unit="s"
    )
    frame.set_index("time").to_csv(tmp_path / "b.csv")
    check(data.read(tmp_path / "b.csv"))
    frame.set_index("time").to_parquet(tmp_path / "b.parquet")
    check(data.read(tmp_path / "b.parquet"))


def test_numbers_keep_every_bit_in_each_separator(tmp_path):
    samples = np.random.default_rng(0).normal(size=N) * 10.0 ** np.arange(-150, 150, 5)
    rows = [
        f"{t!r};{x!r}".replace(".", ",")
        for t, x in zip(TIME.tolist(), samples.tolist(), strict=True)
    ]
    found = read(tmp_path, "time;a\n" + "\n".join(rows))
    assert found == Recording(time=TIME, columns={"a": samples})


@pytest.mark.parametrize(
    ("name", "stem", "factor", "si"),
    [
        ("angle [deg]", "angle", np.pi / 180, "rad"),
        ("stamp_ms", "stamp", 1e-3, "s"),
        ("torque_Nm", "torque", 1.0, "N m"),
        ("speed_rad_s", "speed", 1.0, "rad/s"),
        ("knee_velocity_rpm", "knee_velocity", np.pi / 30, "rad/s"),
        ("p (bar)", "p", 1e5, "Pa"),
        ("phi/deg", "phi", np.pi / 180, "rad"),
        ("knee_pressure_a", "knee_pressure_a", 1.0, ""),
        ("port_A", "port_A", 1.0, ""),
        ("q[0]", "q[0]", 1.0, ""),
        ("time", "time", 1.0, ""),
    ],
)
def test_units_in_names(name, stem, factor, si):
    found = data.units_in_names.split(name)
    assert (found.stem, found.si) == (stem, si)
    assert found.factor == pytest.approx(factor, rel=1e-15)
