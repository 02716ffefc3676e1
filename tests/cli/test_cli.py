"""The command line as a user meets it: files, exit status, one-line errors."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import leglab.models as leglab_models
from leglab import data
from leglab.cli import main
from leglab.control.contract import CONTROLLERS
from leglab.controllers.pd import Pd
from leglab.runs.record import AdaptationMetrics

RUN = ["run", "seal_wear", "--model", "knee_bench", "--duration", "4", "--no-figures"]


def leglab(*arguments, capsys) -> tuple[int, str, str]:
    """Exit status, standard output and standard error of a command."""
    try:
        main([str(argument) for argument in arguments])
        status = 0
    except SystemExit as exit_:
        status = exit_.code or 0
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_run_writes_everything(tmp_path, capsys):
    out = tmp_path / "deep" / "run"
    arguments = [a for a in RUN if a != "--no-figures"]
    status, printed, _ = leglab(*arguments, "--out", str(out), "--seed", "7", capsys=capsys)
    assert status == 0
    assert "knee" in printed
    names = {path.name for path in out.iterdir()}
    assert {"metrics.json", "recording.parquet", "run.json", "tracking.png"} <= names
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["scenario"] == "seal_wear"
    assert metrics["controller"] == "pd"
    assert metrics["model"] == "knee_bench"
    assert metrics["seed"] == 7
    assert metrics["duration"] == pytest.approx(4.0)
    assert metrics["real_time_factor"] > 0
    times = metrics["command_time_s"]
    assert 0 < times["median"] <= times["worst"]
    assert times["late"] < 0.01
    assert [phase["name"] for phase in metrics["phases"]] == ["before", "after"]
    for name in ("rms_rad", "peak_rad", "p95_rad", "effort", "valve_activity_per_s", "energy_j"):
        assert set(metrics["phases"][0][name]) == {"knee", "all"}
    assert metrics["excess_error_area_rad_s"] >= 0
    assert set(metrics["adaptation"]) == set(AdaptationMetrics.model_fields)
    run = json.loads((out / "run.json").read_text())
    assert run["settings"]["seed"] == 7
    assert run["versions"]["mujoco"]
    assert run["elements"]["knee_valve"]["bore"] == 0.016
    recording = data.read(out / "recording.parquet")
    for column in ("knee_position", "knee_valve_command", "knee_pressure_a", "knee_reference"):
        assert column in recording
    assert recording.duration == pytest.approx(4.0)


def test_a_fault_that_is_named_while_running_stands_with_its_effect(tmp_path, capsys):
    arguments = ["run", "seal_wear", "--model", "knee_bench", "--controller", "bsnn_arx_bank"]
    words = [*arguments, "--no-figures", "--out", str(tmp_path / "run")]
    status, printed, _ = leglab(*words, capsys=capsys)
    assert status == 0
    assert "seal_wear [internal_leakage] " in printed


def test_list_as_json(capsys):
    status, printed, _ = leglab("list", "--json", capsys=capsys)
    names = json.loads(printed)
    assert status == 0
    assert {"nominal", "seal_wear", "cold_oil", "hot_oil"} <= set(names["scenarios"])
    assert {"pd", "static_feedforward"} <= set(names["controllers"])
    assert {"leg", "leg_rail", "knee_bench"} <= set(names["models"])
    assert {"file", "multisine", "walking_stride", "squat", "step"} <= set(names["references"])


def test_parameters_of_one_plugin(capsys):
    status, printed, _ = leglab("parameters", "leglab.supply", capsys=capsys)
    assert status == 0
    assert "accumulator_precharge" in printed


def test_list_as_markdown(capsys):
    _, printed, _ = leglab("list", "--markdown", capsys=capsys)
    assert "| `seal_wear` |" in printed
    assert "internal leakage ratio: 10 |" in printed


def test_an_existing_folder_is_left_alone(tmp_path, capsys):
    out = tmp_path / "run"
    assert leglab(*RUN, "--out", str(out), capsys=capsys)[0] == 0
    before = (out / "metrics.json").read_text()
    status, _, errors = leglab(*RUN, "--out", str(out), capsys=capsys)
    assert status == 2
    assert "exists" in errors
    assert (out / "metrics.json").read_text() == before
    assert leglab(*RUN, "--out", str(out), "--overwrite", capsys=capsys)[0] == 0
    other = tmp_path / "precious"
    other.mkdir()
    (other / "thesis.tex").write_text("years")
    status, _, errors = leglab(*RUN, "--out", str(other), "--overwrite", capsys=capsys)
    assert status == 2
    assert (other / "thesis.tex").read_text() == "years"


def test_what_a_failed_run_recorded_is_kept(tmp_path, capsys, monkeypatch):
    def command(self, measurement, reference):
        return reference.position * float("nan" if measurement.time > 1 else 0)

    monkeypatch.setattr(Pd, "command", command)
    out = tmp_path / "run"
    status, _, errors = leglab(*RUN, "--out", str(out), capsys=capsys)
    assert status == 2
    assert "gave nan for joint 'knee' at 1.002 s" in errors
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["completed"] is False
    assert data.read(out / "recording.parquet").duration == pytest.approx(1.0)


def test_a_run_that_blows_up_says_when_and_which_joint(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (Path(leglab_models.__path__[0]) / "knee_bench.xml").read_text()
    # A spring that pushes away from its rest, without stops: the knee runs off.
    text = text.replace('key="k2" value="60"', 'key="k2" value="-1e6"')
    text = text.replace('key="stop_stiffness" value="2000"', 'key="stop_stiffness" value="0"')
    Path("runaway.xml").write_text(text)
    arguments = ["run", "nominal", "--model", "runaway.xml", "--duration", "2", "--no-figures"]
    status, _, errors = leglab(*arguments, "--out", "run", capsys=capsys)
    assert status == 2
    found = re.search(r"blew up at (\S+) s: velocity of joint 'knee'", errors)
    assert found
    recording = data.read("run/recording.parquet")
    assert 0.1 < recording.time[-1] == pytest.approx(float(found[1]) - 0.002)
    assert np.abs(recording["knee_truth_velocity"]).max() < 1000
    assert {path.name for path in tmp_path.iterdir()} == {"runaway.xml", "run"}


def test_a_scenario_runs_as_a_script(tmp_path):
    arguments = ["--model", "knee_bench", "--duration", "0.3", "--no-figures", "--out", "run"]
    subprocess.run(
        [sys.executable, "-m", "leglab.scenarios.cold_start", *arguments],
        cwd=tmp_path,
        check=True,
        capture_output=True,
    )
    metrics = json.loads((Path(tmp_path) / "run" / "metrics.json").read_text())
    assert metrics["scenario"] == "cold_start"


@pytest.mark.parametrize("model", ["knee_bench", "leg", "leg_rail"])
def test_every_hydraulic_model_runs_reports_and_converts(model, tmp_path, capsys):
    """Also the one with a joint that nothing drives and that follows no reference."""
    folder = tmp_path / "run"
    arguments = ["nominal", "--model", model, "--reference", "squat", "--duration", "1"]
    main(["run", *arguments, "--out", str(folder)])
    assert (folder / "tracking.png").stat().st_size > 0
    main(["report", str(folder), "--no-video"])
    assert (folder / "report.html").stat().st_size > 0
    main(["convert", str(folder / "recording.parquet"), str(tmp_path / "run.mcap")])
    assert ("rail_position" in data.read(folder / "recording.parquet")) == (model == "leg_rail")


def test_diagnose_refuses_a_recording_of_both_machines(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    columns = "time,knee_position,knee_valve_command\n"
    rows = "".join(f"{0.001 * k},{0.1},{0.0}\n" for k in range(9))
    (tmp_path / "walk.csv").write_text(columns + rows)
    command = ("diagnose", "knee_bench", "walk.csv", "--out", "out", "--healthy", "walk.csv")
    status, _, error = leglab(*command, capsys=capsys)
    assert status == 2
    assert "walk.csv is given as a recording and as --healthy" in " ".join(error.split())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("value", ["float('nan')", "1 / 0"])
def test_a_comparison_of_which_all_runs_fail_does_not_end_well(
    value, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(CONTROLLERS, "_entries", dict(CONTROLLERS._entries))
    (tmp_path / "broken.py").write_text(
        "import numpy as np\n"
        "from leglab.control import register_controller\n\n\n"
        f"@register_controller('broken_{len(value)}', summary='breaks')\n"
        "class Broken:\n"
        "    def __init__(self, setup, config):\n        pass\n\n"
        "    def reset(self, measurement):\n        pass\n\n"
        "    def command(self, measurement, reference):\n"
        f"        return reference.position * ({value})\n"
    )
    arguments = ("nominal", "--model", "knee_bench", "--duration", "0.5", "--jobs", "1")
    own = ("--controllers", f"broken_{len(value)}", "--load", str(tmp_path / "broken.py"))
    out = ("--seeds", "1", "--no-figures", "--out", str(tmp_path / "c"))
    status, _, told = leglab("compare", *arguments, *own, *out, capsys=capsys)
    assert status in (1, 2)
    assert told.count("\n") == 1
    assert "Traceback" not in told
