"""The benchmark of adaptation: its faults, its sums, and the command on the bench."""

import json

import pytest

from benchmarks.adaptation_faults import adaptation_plan, faults, scores
from leglab.base.errors import LeglabError
from leglab.base.scenario import scenario_severity
from leglab.runs.sweeps.engine import read_sweep
from tests.cli.test_cli import leglab as command_line


def test_sixteen_faults_have_three_sizes_that_the_scenarios_allow():
    found = faults()
    assert len(found) == 16
    for name, sizes in found.items():
        told = scenario_severity(name)
        assert len(set(sizes)) == 3
        assert all(told.lowest <= size <= told.highest for size in sizes)
        # From small to large: all on one side, away from what changes nothing.
        assert sizes in (tuple(sorted(sizes)), tuple(sorted(sizes, reverse=True)))


def test_every_controller_meets_the_same_machines():
    plan, missing = adaptation_plan(["arx"], model="knee_bench", specimens=2)
    assert missing == ("supply_droop",)
    assert len(plan) == 15 * 3 * 3 * 2
    by = {}
    for run in plan:
        by.setdefault(run.controller, set()).add((run.scenario, run.severity, run.seed, run.vary))
    assert set(by) == {"static_feedforward", "pd", "arx"}
    assert by["arx"] == by["pd"] == by["static_feedforward"]
    for bad, message in (
        ({"controllers": ["arxx"]}, "unknown controller 'arxx'"),
        ({"controllers": ["pd", "pd"]}, "'pd' is given twice"),
        ({"controllers": []}, "no controllers"),
        ({"controllers": ["pd"], "specimens": 0}, "specimens is 0; allowed: 1 to 1000"),
        ({"controllers": ["pd"], "only": ["rust"]}, "unknown fault of the benchmark 'rust'"),
        ({"controllers": ["pd"], "model": "knee_bench", "only": ["supply_droop"]}, "can have none"),
    ):
        with pytest.raises(LeglabError, match=message):
            adaptation_plan(**bad)


def row(controller, seed, *, t90=None, recovered=None, worst=(0.1, 0.1), travel=1.0, ok=True):
    return {
        "scenario": "seal_wear",
        "severity": 3.0,
        "seed": seed,
        "controller": controller,
        "status": "ok" if ok else "failed",
        "before_rad": 0.001 * (seed + 1),
        "recovered": recovered,
        "t90_s": t90,
        "valve_travel": travel,
        "energy_j": 10.0 * travel,
        "trace_s": [6.9, 7.0, 8.0],
        "worst_rad": [9.0, *worst],
    }


def test_scores_are_those_that_one_sums_up_by_hand():
    rows = [
        *(row("static_feedforward", seed, worst=(0.2, 0.4)) for seed in range(3)),
        *(row("pd", seed, travel=4.0) for seed in range(3)),
        row("arx", 0, t90=1.0, recovered=0.9, worst=(0.3, 0.2), travel=6.0),
        row("arx", 1, recovered=0.5, worst=(0.1, 0.6), travel=2.0),
        row("arx", 2, ok=False),
    ]
    found = {(one.controller, one.fault): one for one in scores(rows)}
    arx = found["arx", "all"]
    assert found["arx", "seal_wear"].t90_worst_s == arx.t90_worst_s == 1.0
    assert (arx.runs, arx.failed, arx.told, arx.never) == (3, 1, 2, 1)
    assert arx.before_mrad == pytest.approx(1.5)
    assert arx.recovered == pytest.approx(0.7)
    assert arx.t90_median_s == float("inf")
    assert arx.worst_over_static == pytest.approx(1.5)  # 0.3 / 0.2 and 0.6 / 0.4; not before 7 s
    assert arx.travel_over_pd == pytest.approx(1.0)
    assert arx.energy_over_pd == pytest.approx(1.0)
    assert found["pd", "all"].told == 0
    assert found["pd", "all"].recovered is None


@pytest.mark.slow("a sweep of many faults")
def test_the_command_runs_once_and_goes_on(tmp_path, capsys):
    arguments = ["benchmark", "adaptation", "--model", "knee_bench", "--specimens", "1"]
    arguments += ["--faults", "seal_wear, supply_droop", "--out", tmp_path / "a"]
    status, printed, told = command_line(*arguments, "--json", capsys=capsys)
    assert status == 0, told
    assert "knee_bench cannot have supply_droop: left out" in told
    content = json.loads(printed)
    assert content["runs"] == 9
    by = {one["controller"]: one for one in content["scores"] if one["fault"] == "all"}
    # What adapting is there for; orders of magnitude, not digits.
    assert by["bsnn_arx"]["recovered"] > 0.8 > 0.5 > by["static_feedforward"]["recovered"]
    assert by["bsnn_arx"]["before_mrad"] < 0.3 * by["pd"]["before_mrad"]
    assert by["static_feedforward"]["worst_over_static"] == 1.0
    assert by["pd"]["travel_over_pd"] == by["pd"]["energy_over_pd"] == 1.0
    made = read_sweep(tmp_path / "a").table().column("made_at").to_pylist()
    status, printed, _ = command_line(*arguments, "--by-fault", capsys=capsys)
    assert status == 0
    assert printed.count("bsnn_arx") == 2
    assert read_sweep(tmp_path / "a").table().column("made_at").to_pylist() == made
    arguments[7] = "cold_oil"
    assert "run 0 is not in the new plan" in command_line(*arguments, capsys=capsys)[2]
