"""Comparisons: the matrix of runs, its storage, the figures drawn from it, the command."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict

import numpy as np
import pytest
from matplotlib.colors import to_hex

import leglab.controllers
from leglab import RunSettings, run_scenario
from leglab.base.errors import LeglabError
from leglab.jobs import fingerprint
from leglab.report.figures import comparison_figure
from leglab.report.style import VERMILION
from leglab.runs import preparation
from leglab.runs.comparison import Comparison, compare, estimate, run_all
from leglab.runs.sweeps import making
from tests.cli.test_cli import leglab as command_line


def bench(**changes) -> Comparison:
    base = {
        "scenarios": ("seal_wear",),
        "controllers": ("pd",),
        "model": "knee_bench",
        "duration": 5.0,
    }
    return Comparison(**{**base, **changes})


def test_the_matrix_has_every_combination_once():
    runs = bench(scenarios=("seal_wear", "hot_oil"), seeds=3).runs()
    combinations = {(run.scenario, run.controller, run.seed) for run in runs}
    assert combinations == {(s, "pd", i) for s in ("seal_wear", "hot_oil") for i in range(3)}
    assert len(runs) == 6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seeds": 0}, "seeds is 0; allowed: 1 to 100000"),
        ({"controllers": ()}, "no controllers to compare"),
        ({"controllers": ("pd", "pd")}, "controllers: 'pd' is given twice"),
        ({"controllers": ("pdd",)}, "unknown controller 'pdd'.*did you mean 'pd'"),
        ({"scenarios": ("seal_waer",)}, "unknown scenario 'seal_waer'"),
        ({"severity": 1e9}, "severity.*outside"),
        ({"duration": -1.0}, "duration -1.0 s is not allowed"),
    ],
)
def test_bad_comparisons(change, message):
    with pytest.raises(LeglabError, match=message):
        bench(**change)


def test_estimate_equals_brute_force():
    found = estimate([1.0, None, 2.0, 4.0])
    assert found["values"] == [1.0, 2.0, 4.0]
    assert found["mean"] == pytest.approx(7 / 3)
    deviation = np.sqrt(sum((v - 7 / 3) ** 2 for v in (1, 2, 4)) / 2)
    # Student's t at 97.5 % with two degrees of freedom, from the tables: 4.3027.
    assert found["half_width"] == pytest.approx(4.3027 * deviation / np.sqrt(3), rel=1e-4)
    assert estimate([3.0]) == {"mean": 3.0, "half_width": None, "values": [3.0]}
    assert estimate([None]) == {"mean": None, "half_width": None, "values": []}


def test_intervals_cover_the_mean_as_often_as_they_say():
    random = np.random.default_rng(0)
    inside = 0
    for _ in range(1000):
        found = estimate(random.normal(5.0, 2.0, 6))
        inside += abs(found["mean"] - 5.0) <= found["half_width"]
    # Three standard deviations of a binomial share are 2.1 %.
    assert inside / 1000 == pytest.approx(0.95, abs=0.021)


def test_results_are_those_of_the_runs_themselves(tmp_path):
    (result,) = run_all(bench().runs(), tmp_path, jobs=1)
    alone = run_scenario(RunSettings(scenario="seal_wear", model="knee_bench", duration=5.0))
    wanted = json.loads(json.dumps(alone.metrics))
    for metrics in (result["metrics"], wanted):
        del metrics["real_time_factor"], metrics["command_time_s"]
    assert result["metrics"] == wanted
    assert result["changes"] == [2.5]
    assert len(result["time"]) == len(result["windowed_error_rad"]) == 251
    # At the end the window holds the last stride.
    part = alone.history.error[alone.history.time > 5.0 - alone.window]
    assert result["windowed_error_rad"][-1] == pytest.approx(np.sqrt(np.mean(part**2)), rel=1e-3)
    assert result["windowed_error_rad"][0] is None


def test_finished_runs_are_not_repeated(tmp_path, monkeypatch):
    calls = []

    def counted(settings, **shared):
        calls.append(settings)
        return run_scenario(settings, **shared)

    monkeypatch.setattr(making, "run_scenario", counted)
    first = run_all(bench(seeds=2).runs(), tmp_path, jobs=1)
    assert len(calls) == 2
    told = []
    again = run_all(
        bench(seeds=3).runs(), tmp_path, jobs=1, progress=lambda *report: told.append(report[:2])
    )
    assert [call.seed for call in calls] == [0, 1, 2]
    assert again[:2] == first
    assert told == [(2, 3), (3, 3)]
    # Another duration is another run, and so is a file that was cut off.
    run_all(bench(duration=4.0).runs(), tmp_path, jobs=1)
    assert len(calls) == 4
    (tmp_path / "seal_wear-pd-knee_bench-1.json").write_text('{"settings": ')
    run_all(bench(seeds=3).runs()[1:], tmp_path, jobs=1)
    assert len(calls) == 5
    run_all(bench(seeds=3).runs()[1:], tmp_path, jobs=1, overwrite=True)
    assert len(calls) == 7
    # Results of other code do not count.
    monkeypatch.setattr(preparation, "fingerprint", lambda: "other")
    run_all(bench(seeds=1).runs(), tmp_path, jobs=1)
    assert len(calls) == 8


def test_a_run_that_fails_stops_no_other_and_is_made_again(tmp_path, monkeypatch, capsys):
    from leglab.runs.run import run_scenario as made

    def sometimes(settings, **shared):
        if settings.controller == "static_feedforward" and settings.seed == 1:
            raise ZeroDivisionError("by nought")
        return made(settings, **shared)

    monkeypatch.setattr(making, "run_scenario", sometimes)
    runs = bench(controllers=("pd", "static_feedforward"), seeds=2, duration=2.0).runs()
    results = run_all(runs, tmp_path, jobs=1)
    whole = [result["metrics"]["completed"] for result in results]
    assert whole == [True, True, True, False]
    told = results[-1]["metrics"]["failure"]
    assert told.startswith("ZeroDivisionError: by nought (test_comparison.py, line ")
    assert len(list(tmp_path.glob("*.json"))) == 3
    with pytest.raises(LeglabError, match="ZeroDivisionError: by nought"):
        run_all(runs[3:], tmp_path, jobs=1)
    out = tmp_path / "compare"
    words = ("compare", "seal_wear", "--controllers", "pd,static_feedforward", "--seeds", "2")
    options = ("--model", "knee_bench", "--duration", "5", "--jobs", "1", "--out", str(out))
    status, printed, warned = command_line(*words, *options, capsys=capsys)
    assert status == 0
    assert "failed 1/2" in printed
    assert "seal_wear, static_feedforward: 1 of 2 runs failed: ZeroDivisionError" in warned
    assert (out / "seal_wear.png").exists()
    cell = json.loads((out / "compare.json").read_text())["results"]["seal_wear"]
    assert cell["static_feedforward"]["runs"] == 2
    assert len(cell["static_feedforward"]["failures"]) == 1
    assert len(cell["static_feedforward"]["after_rad"]["values"]) == 1
    monkeypatch.undo()
    assert all(r["metrics"]["completed"] for r in run_all(runs, tmp_path, jobs=1))


def test_the_fingerprint_covers_controllers_models_and_the_compiled_core(tmp_path, monkeypatch):
    before = fingerprint.fingerprint()
    extra = tmp_path / "extra.py"
    monkeypatch.setattr(leglab.controllers, "__path__", [*leglab.controllers.__path__, tmp_path])
    fingerprint.own_fingerprint.cache_clear()
    assert fingerprint.fingerprint() == before
    extra.write_text("gain = 1")
    fingerprint.own_fingerprint.cache_clear()
    assert fingerprint.fingerprint() != before
    fingerprint.own_fingerprint.cache_clear()


def fake(controller, seed, after, *, t90=0.5, completed=True):
    return {
        "metrics": {
            "scenario": "seal_wear",
            "controller": controller,
            "seed": seed,
            "completed": completed,
            "failure": None if completed else "blew up",
            "phases": [
                {"name": "before", "rms_rad": {"all": 1.0}},
                {"name": "after", "rms_rad": {"all": after}},
            ],
            "adaptation": {
                "before_rad": {"all": 0.5},
                "end_rad": {"all": after / 2},
                "damage_rad": 4.0,
                "recovered": 0.9,
                "t90_s": t90,
                "reason": None,
            },
            "excess_error_area_rad_s": 2.0,
        }
    }


def test_ratios_are_taken_seed_by_seed_and_failures_are_left_out():
    results = [
        fake("pd", 0, 2.0),
        fake("pd", 1, 4.0),
        fake("pd", 2, 8.0),
        fake("static_feedforward", 0, 1.0, t90=None),
        fake("static_feedforward", 1, 1.0),
        fake("static_feedforward", 2, 9.0, completed=False),
    ]
    comparison = bench(controllers=("pd", "static_feedforward"), seeds=3)
    summary = compare(comparison, results)
    cell = summary["results"]["seal_wear"]["static_feedforward"]
    assert cell["ratio"]["values"] == [0.5, 0.25]
    assert cell["after_rad"]["values"] == [1.0, 1.0]
    assert cell["end_rad"]["values"] == [0.5, 0.5]
    assert cell["before_rad"]["mean"] == 0.5
    assert (cell["never_undone"], cell["failures"], cell["runs"]) == (1, ["blew up"], 3)
    assert cell["t90_s"]["values"] == [0.5]
    assert summary["results"]["seal_wear"]["pd"]["ratio"]["values"] == [1.0] * 3
    assert summary["controllers"] == asdict(comparison)["controllers"]
    json.dumps(summary, allow_nan=False)


def test_the_figure_shows_the_mean_of_the_seeds_and_marks_the_change():
    def run(controller, level):
        return {
            "metrics": {"controller": controller},
            "changes": [2.0],
            "window": 1.0,
            "time": [0.0, 1.0, 2.0, 3.0],
            "windowed_error_rad": [None, level, level, 2 * level],
        }

    figure = comparison_figure([run("pd", 0.1), run("pd", 0.3), run("arx", 0.01)])
    pd, arx, change = figure.axes[0].lines
    np.testing.assert_allclose(pd.get_ydata(), [np.nan, 200, 200, 400])
    np.testing.assert_allclose(arx.get_ydata(), [np.nan, 10, 10, 20])
    assert to_hex(change.get_color()) == VERMILION.lower()
    assert set(change.get_xdata()) == {2.0}
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["pd", "arx", "change of the machine"]
    with pytest.raises(LeglabError, match="no run lasts a window"):
        comparison_figure([{**run("pd", 0.1), "windowed_error_rad": [None] * 4}])


def test_the_command_writes_table_figures_and_json(tmp_path, capsys):
    arguments = ["compare", "seal_wear", "nominal", "--controllers", "pd, static_feedforward"]
    arguments += ["--model", "knee_bench", "--duration", "4", "--seeds", "2", "--out"]
    out = tmp_path / "deep" / "compare"
    status, printed, _ = command_line(*arguments, str(out), capsys=capsys)
    assert status == 0
    assert "static_feedforward" in printed
    assert "±" in printed
    assert "…" not in printed
    names = {path.name for path in out.iterdir()}
    assert names == {"compare.json", "seal_wear.png", "nominal.png", "runs"}
    summary = json.loads((out / "compare.json").read_text())
    cell = summary["results"]["seal_wear"]["static_feedforward"]
    assert cell["ratio"]["mean"] < 0.5
    assert summary["results"]["nominal"]["pd"]["before_rad"]["mean"] is None
    status, printed, _ = command_line(*arguments, str(out), "--json", capsys=capsys)
    assert json.loads(printed) == summary
    assert command_line("compare", "nominal", "--jobs", "0", capsys=capsys)[0] == 2


@pytest.mark.parametrize(
    "group",
    [True, pytest.param(False, marks=pytest.mark.slow("a second interrupted command"))],
    ids=["terminal", "one process"],
)
def test_an_interrupted_comparison_keeps_what_is_done(tmp_path, group):
    command = [sys.executable, "-m", "leglab", "compare", "seal_wear", "--out", str(tmp_path)]
    command += ["--model", "knee_bench", "--controllers", "pd", "--seeds", "200", "--jobs", "2"]
    # A shell's background job passes on that it ignores Ctrl-C: not so this one.
    process = subprocess.Popen(
        command,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    deadline = time.monotonic() + 120
    while len(list(tmp_path.glob("runs/seal*.json"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    if group:  # as Ctrl-C does
        os.killpg(process.pid, signal.SIGINT)
    else:
        process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "interrupted after" in errors
    assert "Traceback" not in errors
    stored = list(tmp_path.glob("runs/seal*.json"))
    assert 2 <= len(stored) < 200
    assert all(json.loads(path.read_text())["metrics"]["completed"] for path in stored)
    assert not (tmp_path / "compare.json").exists()
