"""`leglab diagnose` end to end on MCAP recordings that name and scale things in their own way."""

import json
from pathlib import Path

import numpy as np
import pytest

from leglab import data
from leglab.base.recording import Recording
from leglab.cli import main

FOLDER = Path(__file__).parents[1] / "data" / "diagnosis"
NAMES = ("multisine", "slow", "walk")
TRUE_LAP = 0.065  # truth.toml of d2

COLUMN_MAP = """
[columns]
axis_3_position = {name = "knee_position", factor = 0.017453292519943295, offset = 0.2}
"valve/percent" = {name = "knee_valve_command", factor = 0.01}
cap_bar = {name = "knee_pressure_a", factor = 1e5}
rod_bar = {name = "knee_pressure_b", factor = 1e5}
"""


def written(case, folder):
    """Recordings as another laboratory would have made them: degrees, per cent, bar."""
    files = []
    for name in NAMES:
        ours = data.read(FOLDER / f"{case}_{name}.parquet")
        theirs = {
            "axis_3_position": np.rad2deg(ours["knee_position"] - 0.2),
            "valve/percent": 100.0 * ours["knee_valve_command"],
            "cap_bar": 1e-5 * ours["knee_pressure_a"],
            "rod_bar": 1e-5 * ours["knee_pressure_b"],
        }
        path = folder / f"{name}.mcap"
        files.append(str(data.write(Recording(time=ours.time, columns=theirs), path)))
    return files


@pytest.mark.slow("a whole diagnosis by the command, as in test_diagnosis.py")
def test_a_bag_with_a_column_map_is_diagnosed(tmp_path):
    files = written("d2", tmp_path)
    (tmp_path / "map.toml").write_text(COLUMN_MAP)
    options = ["--columns", str(tmp_path / "map.toml"), "--out", str(tmp_path / "out")]
    options += ["--held-out", "walk", "--effect", "valve_bias", "--effect", "valve_deadband"]
    main(["diagnose", "knee_bench", *files, *options])
    content = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert content["verdict"] == "named"
    assert [effect["name"] for effect in content["effects"]] == ["valve_deadband"]
    assert content["effects"][0]["parameters"]["lap"]["value"] == pytest.approx(TRUE_LAP, rel=2e-3)
    assert content["gap"]["held_out"] == ["walk.mcap"]
    assert content["gap"]["closed_fraction"] > 0.999
    assert (tmp_path / "out" / "diagnosis.html").stat().st_size > 10_000


def test_without_the_map_the_names_of_both_sides_are_listed(tmp_path, capsys):
    files = written("d2", tmp_path)
    with pytest.raises(SystemExit) as exit_:
        main(["diagnose", "knee_bench", *files, "--out", str(tmp_path / "out")])
    assert exit_.value.code
    shown = " ".join(capsys.readouterr().err.split())
    assert "knee_valve_command" in shown
    assert "valve/percent" in shown
    assert not (tmp_path / "out").exists()
