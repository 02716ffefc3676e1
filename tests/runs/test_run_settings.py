"""Settings of a run from files and entries, and the same bits again."""

import json

import numpy as np
import pytest

from leglab import RunSettings, data, run_scenario
from leglab.base.errors import LeglabError
from leglab.cli import main
from leglab.runs.folder import default_folder
from leglab.runs.run_settings import read_settings, with_entries

TOML = """
scenario = "seal_wear"
model = "knee_bench"
duration = 1.0
seed = 4

[controller]
name = "bsnn_arx"
memory = 1500
change_windows = [30, 900]

[reference]
name = "sine_sweep"
amplitude = 0.2

[sensors]
latency = 0.002
"""


def call(*arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["run", *map(str, arguments), "--no-figures"])
    return stopped.value.code, capsys.readouterr().err.strip()


def recordings_of(*folders):
    return [data.read(folder / "recording.parquet") for folder in folders]


def test_a_toml_file_is_the_run_that_python_makes(tmp_path):
    file, out = tmp_path / "config.toml", tmp_path / "out"
    file.write_text(TOML)
    main(["run", str(file), "--out", str(out), "--no-figures"])
    (got,) = recordings_of(out)
    run = run_scenario(
        RunSettings(
            scenario="seal_wear",
            model="knee_bench",
            duration=1.0,
            seed=4,
            controller="bsnn_arx",
            controller_config={"memory": 1500, "change_windows": [30, 900]},
            reference="sine_sweep",
            reference_config={"amplitude": 0.2},
            sensors={"latency": 0.002},
        )
    )
    assert got.columns.keys() == run.recording.columns.keys()
    for name in got.columns:
        np.testing.assert_array_equal(got[name], run.recording[name])


@pytest.mark.parametrize(
    "options",
    [
        ("cold_oil", "--controller", "bsnn_arx", "--seed", "3", "--tolerance", "0.1", "--vary"),
        ("nominal", "--reference", "random_stride", "--set", "sensors.latency=0"),
        ("encoder_shift", "--set", "controller.position_gain=[0.5]", "--ramp", "0.2"),
    ],
    ids=lambda options: options[0],
)
def test_run_json_makes_the_same_bits_again(tmp_path, options):
    first, again = tmp_path / "first", tmp_path / "again"
    common = ("--model", "knee_bench", "--duration", "1", "--no-figures")
    main(["run", *options, *common, "--out", str(first)])
    main(["run", str(first / "run.json"), "--no-figures", "--out", str(again)])
    one, two = recordings_of(first, again)
    assert one.columns.keys() == two.columns.keys()
    for name in one.columns:
        np.testing.assert_array_equal(one[name], two[name])
    # And it is described alike, what it was asked for included.
    described = [json.loads((folder / "run.json").read_text()) for folder in (first, again)]
    assert described[0]["settings"] == described[1]["settings"]
    assert described[0]["changes"] == described[1]["changes"]


def test_a_native_machine_is_made_again(tmp_path):
    first, again = tmp_path / "first", tmp_path / "again"
    options = ("--model", "leg_motor", "--duration", "0.5", "--no-figures")
    main(["run", "payload", *options, "--out", str(first)])
    main(["run", str(first / "run.json"), "--no-figures", "--out", str(again)])
    one, two = recordings_of(first, again)
    assert one == two


def test_options_hold_over_the_file_and_entries_over_both(tmp_path):
    file, out = tmp_path / "config.toml", tmp_path / "out"
    file.write_text(TOML)
    arguments = ["--seed", "7", "--controller", "arx", "--set", "controller.memory=900"]
    arguments += ["--set", "reference.end_frequency=2", "--set", "controller.limit=0.5"]
    main(["run", str(file), *arguments, "--out", str(out), "--no-figures"])
    settings = json.loads((out / "run.json").read_text())["settings"]
    assert (settings["seed"], settings["controller"]) == (7, "arx")
    assert (settings["duration"], settings["model"]) == (1.0, "knee_bench")
    assert settings["controller_config"] == {
        "memory": 900,
        "change_windows": [30, 900],
        "limit": 0.5,
    }
    assert settings["reference_config"] == {"amplitude": 0.2, "end_frequency": 2}


def test_another_controller_takes_those_settings_of_the_file_that_it_has(tmp_path, capsys):
    file, out = tmp_path / "config.toml", tmp_path / "out"
    file.write_text(TOML)
    main(["run", str(file), "--controller", "pd", "--out", str(out), "--no-figures"])
    assert json.loads((out / "run.json").read_text())["settings"]["controller_config"] == {}
    assert "the setting 'memory' of controller 'bsnn_arx' is left out" in capsys.readouterr().err


def test_a_trajectory_over_the_file_keeps_none_of_the_reference_that_it_replaces(tmp_path, capsys):
    file, out, walk = tmp_path / "config.toml", tmp_path / "out", tmp_path / "walk.CSV"
    file.write_text(TOML)
    walk.write_text("time,knee\n" + "\n".join(f"{t},{1 + 0.01 * t}" for t in range(6)))
    main(["run", str(file), "--reference", str(walk), "--out", str(out), "--no-figures"])
    settings = json.loads((out / "run.json").read_text())["settings"]
    assert settings["reference"] == "file"
    assert set(settings["reference_config"]) == {"file", "digest"}
    told = capsys.readouterr()
    assert "the setting 'amplitude' of reference" in told.err
    assert "walk.CSV: knee follows 'knee'" in told.out


def test_entries_are_toml_values_or_text_and_may_be_nested():
    base = {"scenario": "nominal", "controller_config": {"monitor": {"block": 5}}}
    found = with_entries(
        base,
        [
            "controller.monitor.level=2.5",
            "controller.route=forward",
            "controller.supervised=false",
            "sensors.encoder_counts=0",
        ],
    )
    assert found["controller_config"] == {
        "monitor": {"block": 5, "level": 2.5},
        "route": "forward",
        "supervised": False,
    }
    assert found["sensors"] == {"encoder_counts": 0}
    assert base["controller_config"] == {"monitor": {"block": 5}}


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("memory=3", "--set 'memory=3': allowed is SECTION.SETTING=VALUE.*controller, reference"),
        ("controller.memory", "allowed is SECTION.SETTING=VALUE"),
        ("valve.lap=3", "allowed is SECTION.SETTING=VALUE"),
        ("controller.memory.more=3", "'memory' has a value already"),
    ],
)
def test_a_wrong_entry_is_named(entry, message):
    with pytest.raises(LeglabError, match=message):
        with_entries({"controller_config": {"memory": 2}}, [entry])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("scenario = ", "is not TOML"),
        ('model = "leg"', "needs the setting 'scenario'"),
        ('scenario = "nominal"\nsede = 3', "unknown setting of a run 'sede'.*did you mean 'seed'"),
        ('scenario = "nominal"\nseed = "three"', "setting 'seed' is 'three': input should be"),
        ('scenario = "nominal"\nduration = true', "setting 'duration' is True: input should be"),
    ],
)
def test_a_wrong_file_is_one_line_and_nothing_is_written(tmp_path, capsys, content, message):
    file, out = tmp_path / "config.toml", tmp_path / "out"
    file.write_text(content)
    with pytest.raises(LeglabError, match=message):
        read_settings(file)
    code, error = call(file, "--out", out, capsys=capsys)
    assert code == 2
    assert error.startswith("error: ")
    assert "config.toml" in error.replace("\n", "")
    assert not out.exists()


def test_a_missing_file_and_a_wrong_setting_get_one_line(tmp_path, capsys):
    code, error = call(tmp_path / "none.toml", capsys=capsys)
    assert (code, "none.toml: cannot be read" in error.replace("\n", "")) == (2, True)
    code, error = call("nominal", "--model", "knee_bench", "--set", "controller.x=1", capsys=capsys)
    assert (code, "unknown setting of controller 'pd' 'x'" in error) == (2, True)


def test_folders_of_other_settings_have_other_names():
    def named(**config):
        return default_folder(RunSettings(scenario="nominal", **config)).name

    assert named() == "nominal-pd-leg-0"
    assert named(sensors={"latency": 0.0}) == "nominal-pd-leg-0-sensors.latency0.0"
    many = {"position_gain": [1.0, 2.0], "velocity_gain": [0.0, 0.1]}
    assert named(controller_config=many).startswith("nominal-pd-leg-0-settings")
    assert named(controller_config=many) != named(controller_config={**many, "velocity_gain": []})
