"""`leglab convert` and `leglab inspect`."""

import json

import numpy as np
import pytest

from leglab import data
from leglab.base.recording import Recording
from tests.cli.test_cli import leglab
from tests.data.test_interop import bits, example


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data.write(example(), "run.parquet")
    return tmp_path


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".npz", ".mcap"])
def test_there_and_back(suffix, capsys):
    status, printed, _ = leglab("convert", "run.parquet", f"x{suffix}", capsys=capsys)
    assert status == 0
    assert f"written to x{suffix}" in printed
    assert leglab("convert", f"x{suffix}", "back.parquet", capsys=capsys)[0] == 0
    back, first = data.read("back.parquet"), example()
    np.testing.assert_allclose(back.time, first.time, rtol=1e-15, atol=1e-9)
    for name in first.columns:
        assert bits(back)[name] == bits(first)[name]
    kept = suffix in (".mat", ".mcap")
    assert dict(back.metadata) == (dict(first.metadata) if kept else {})


def test_losses_are_said(capsys):
    status, printed, errors = leglab("convert", "run.parquet", "x.csv", capsys=capsys)
    assert status == 0
    assert errors == "lost: metadata\n"
    assert "lost" not in printed
    arguments = ("convert", "run.parquet", "y.txt", "--to", "csv", "--json")
    _, printed, errors = leglab(*arguments, capsys=capsys)
    found = json.loads(printed)
    assert errors == ""
    assert found["format"] == "csv"
    assert found["lost"] == ["metadata"]
    assert found["samples"] == 200
    assert "knee_position" in found["columns"]


def test_repairs_are_said(capsys, folder):
    (folder / "dirty.csv").write_text("time,a\n0,1\n0.1,2\n0.1,2\n0.2,3\n")
    _, _, errors = leglab("convert", "dirty.csv", "clean.parquet", capsys=capsys)
    assert errors == "repaired: dropped 1 exact repetitions of a row, the first is 2\n"


def test_a_column_map(capsys, folder):
    (folder / "theirs.csv").write_text("t,angle\n0,90\n0.1,180\n")
    (folder / "map.toml").write_text(
        '[columns]\nt = "time"\nangle = {name = "knee_position", factor = 0.017453292519943295}\n'
    )
    arguments = ("convert", "theirs.csv", "ours.mat", "--columns", "map.toml")
    assert leglab(*arguments, capsys=capsys)[0] == 0
    np.testing.assert_allclose(data.read("ours.mat")["knee_position"], [np.pi / 2, np.pi])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run.parquet", "x.xyz"), "suffix '.xyz'"),
        (("run.parquet", "x.csv", "--to", "matlb"), "did you mean 'matlab'"),
        (("no.csv", "x.mat"), "there is no such file"),
        (("run.parquet", "no/such/folder.mat"), "cannot be written"),
        (("run.parquet", "run.parquet"), "run.parquet exists; --overwrite replaces it"),
    ],
)
def test_errors(arguments, message, capsys, folder):
    before = (folder / "run.parquet").read_bytes()
    status, printed, errors = leglab("convert", *arguments, capsys=capsys)
    assert (status, printed, errors.count("\n")) == (2, "", 1)
    assert message in errors
    assert {path.name for path in folder.iterdir()} == {"run.parquet"}
    assert (folder / "run.parquet").read_bytes() == before


def test_overwrite(capsys):
    assert leglab("convert", "run.parquet", "x.csv", capsys=capsys)[0] == 0
    again = ("convert", "run.parquet", "x.csv", "--overwrite")
    assert leglab(*again, capsys=capsys)[0] == 0


def test_inspect(capsys):
    status, printed, _ = leglab("inspect", "run.parquet", capsys=capsys)
    assert status == 0
    first, *lines = printed.splitlines()
    assert first == "run.parquet: 200 samples over 0.398 s from 3 s, 500 Hz (0.002 s), no gaps"
    assert any(line.split() == ["knee_pressure_a", "Pa", *line.split()[2:]] for line in lines)
    assert "nan_run: column 'knee_position', row 5: 4 samples without a number" in printed
    assert 'note = "Öl ☂"' in printed


def test_inspect_as_json(capsys):
    time = np.r_[np.arange(10) * 0.01, 0.5 + np.arange(10) * 0.01]
    recording = Recording(
        time=time,
        columns={"knee_position": np.arange(20.0), "nothing": np.full(20, np.nan)},
        metadata={"units": {"knee_position": "deg"}},
    )
    data.write(recording, "gap.parquet")
    status, printed, errors = leglab("inspect", "gap.parquet", "--json", capsys=capsys)
    assert (status, errors) == (0, "")
    found = json.loads(printed)
    assert found["samples"] == 20
    assert found["gaps"] == 1
    assert found["rate_hz"] == pytest.approx(100)
    assert found["duration_s"] == pytest.approx(0.59)
    knee, nothing = found["columns"]
    assert knee == {"name": "knee_position", "unit": "deg", "min": 0, "max": 19, "missing": 0}
    assert nothing["min"] is None
    assert nothing["missing"] == 20
    assert {f["kind"] for f in found["findings"]} == {"gap", "nan_run"}


EVIL = "\x1b]0;mine\x07\x1b[2J\x9b31m\u202e[/b]"


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_nothing_in_a_file_reaches_the_terminal_as_a_command(folder, capsys, options):
    time = np.arange(5) * 0.1
    evil = Recording(time=time, columns={EVIL: time}, metadata={EVIL: EVIL, "repairs": [EVIL]})
    data.write(evil, folder / "evil.parquet")
    for arguments in (
        ("inspect", "evil.parquet"),
        ("convert", "evil.parquet", f"{EVIL.replace('/', '')}.csv"),
        ("convert", f"{EVIL}.parquet", "x.csv"),
    ):
        _, printed, told = leglab(*arguments, *options, capsys=capsys)
        assert printed + told
        assert not [c for c in printed + told if c in "\x1b\x07\x9b\u202e"]
        if options and printed:
            json.loads(printed)


def test_a_folder_that_looks_like_markup_is_shown_as_it_is(folder, capsys):
    run = ("run", "nominal", "--model", "knee_bench", "--duration", "1", "--no-figures")
    for name in ("q[/b]", "[red]x"):
        status, printed, told = leglab(*run, "--out", name, capsys=capsys)
        assert (status, told) == (0, "")
        assert printed.endswith(f"written to {name}\n")
