"""Errors as a caller of the public names sees them: class, what was given and what is allowed."""

import pickle

import pytest

import leglab
from leglab.machine.plugin import attribute_names
from tests.helpers.plugin_models import slides, valve

ATTRIBUTES = tuple(sorted(attribute_names("leglab.cylinder")))


def model(**attributes):
    return lambda folder: leglab.load_model(
        saved(folder / "m.xml", slides(valve("v", **attributes)))
    )


def saved(path, text):
    path.write_text(text)
    return path


def scenario(name, **options):
    return lambda _: leglab.get_scenario(name, **options)


def column(folder):
    leglab.read(saved(folder / "a.csv", "time,knee_position\n0.0,1\n0.1,2\n"))["knee_postion"]


def cell(folder):
    leglab.read(saved(folder / "a.csv", "time,knee_position\n0.0,high\n0.1,2\n"))


def diverged(_):
    simulation = leglab.Simulation(leglab.load_model("knee_bench"))
    simulation.data.qvel[0] = -2e3
    simulation.check()


MAP_SETTINGS = ("clock", "columns", "decimal", "encoding", "separator", "skip", "stamps")
TEXT = (".csv", ".txt", ".tsv", ".log", ".dat", ".asc")


def suffix(folder):
    leglab.read(saved(folder / "a.docx", ""))


def mapped(folder):
    leglab.read_column_map(saved(folder / "map.toml", "columns = {a = 'b'}\nclok = '/imu'"))


@pytest.mark.parametrize(
    ("provoke", "kind", "given", "allowed"),
    [
        (model(boore=0.016), leglab.ModelError, "boore", ATTRIBUTES),
        (model(internal_leakage=-1), leglab.ModelError, "-1", "[0, 1e-09] m^3/s/Pa"),
        (model(rod=0.016), leglab.ModelError, "0.016", "less than bore = 0.016 m"),
        (column, leglab.RecordingError, "knee_postion", ("knee_position",)),
        (cell, leglab.RecordingError, "high", "a number"),
        (scenario("seal_waer"), leglab.SettingsError, "seal_waer", leglab.scenario_names()),
        (scenario("seal_wear", severity=0.5), leglab.SettingsError, 0.5, "[1, 1000]"),
        (mapped, leglab.SettingsError, "clok", MAP_SETTINGS),
        (diverged, leglab.SimulationError, -2e3, "below 1000"),
        (suffix, leglab.FileError, ".docx", (".parquet", *TEXT, ".mcap", ".mat", ".npz")),
        (lambda folder: leglab.read(folder / "a.csv"), leglab.FileError, "a.csv", None),
    ],
)
def test_class_and_attributes_survive_another_process(tmp_path, provoke, kind, given, allowed):
    with pytest.raises(leglab.LeglabError) as caught:
        provoke(tmp_path)
    # As joblib and Dask bring it back.
    error = pickle.loads(pickle.dumps(caught.value))
    assert type(error) is type(caught.value) is kind
    assert str(error) == str(caught.value)
    assert error.given in (given, tmp_path / str(given))
    assert error.allowed == allowed
