"""Sweeps that tune: what is proposed, what a kill leaves, and what tuning finds."""

import math
import multiprocessing
import os
import signal
import statistics
import tomllib
from pathlib import Path

import pytest

from leglab.base.errors import LeglabError
from leglab.runs.sweeps import tuning
from leglab.runs.sweeps.engine import read_sweep, run_sweep
from leglab.runs.sweeps.plan import SweepPlan
from leglab.runs.sweeps.query import ask
from tests.runs.test_sweeps import rows

BENCH = {
    "model": "knee_bench",
    "scenario": "friction_rise",
    "controller": "bsnn_arx",
    "duration": 0.6,
}
GAIN = "controller_config.initial_gain"


def plan_of(points=6, *, settings=BENCH, ranges=None, seeds=2, tune=None, **block) -> SweepPlan:
    tune = {"metric": "rms_rad", **(tune or {})}
    ranges = ranges or {GAIN: {"low": 1e-3, "high": 10.0, "log": True}}
    grid = {"seed": {"count": seeds}}
    block = {"grid": grid, "ranges": ranges, "draw": "tpe", "points": points, "tune": tune, **block}
    return SweepPlan({"settings": settings, "block": [block]})


def value(x: float) -> float:
    """A valley at 0.2 that a run of seed 1 shares, a little higher."""
    return (math.log10(x) - math.log10(0.2)) ** 2 + 0.1


def proposals(plan: SweepPlan, figure=lambda run, x: value(x)) -> list[float]:
    """All proposals of the only block where figures are made up."""
    (points,) = plan.tuned
    figures = {}
    while batch := tuning.due(points):
        for point in batch:
            points.proposals[point] = tuning.propose(points, figures)
            for run in points.runs(point):
                figures[run] = figure(run, points.proposals[point][GAIN])
    return [points.proposals[point][GAIN] for point in sorted(points.proposals)]


def test_proposals_come_near_the_best_value_and_depend_on_the_seed():
    found = proposals(plan_of(41, seeds=1))
    assert len(found) == 40
    assert all(1e-3 <= x <= 10.0 for x in found)
    away = [abs(math.log10(x / 0.2)) for x in found]
    assert min(away) < 0.05
    # Without figures the points stay as far away as at the beginning.
    assert statistics.median(away[20:]) < 0.7 * statistics.median(away[:10])
    assert proposals(plan_of(41, seeds=1)) == found
    assert proposals(plan_of(41, seeds=1, draw_seed=1))[0] != found[0]


def test_the_highest_is_found_where_it_is_asked_for():
    lowest = proposals(plan_of(31, seeds=1))
    assert (
        proposals(plan_of(31, seeds=1, tune={"aim": "highest"}), lambda _, x: -value(x)) == lowest
    )


def test_points_of_a_batch_know_nothing_of_each_other():
    plan = plan_of(25, seeds=1, tune={"together": 12})
    found = proposals(plan)
    assert len(set(found)) == 24
    # The second batch knows the first, and nothing of what its own points bring about.
    assert (
        proposals(
            plan_of(25, seeds=1, tune={"together": 12}),
            lambda run, x: value(x) if run <= 12 else 5.0,
        )
        == found
    )
    other = proposals(plan_of(25, seeds=1, tune={"together": 12}), lambda run, x: -value(x))
    assert other[:12] == found[:12]
    assert other[12:] != found[12:]


def test_the_value_of_a_point_is_the_mean_or_the_worst_of_its_runs():
    for over, aim, wanted in (
        ("mean", "lowest", 2.0),
        ("worst", "lowest", 3.0),
        ("worst", "highest", 1.0),
    ):
        (points,) = plan_of(3, tune={"over": over, "aim": aim}).tuned
        assert list(points.runs(1)) == [1, 4]
        assert tuning.value_of(points, 1, {1: 1.0, 4: 3.0}) == wanted
        assert tuning.value_of(points, 1, {1: 1.0, 4: None}) is None


def test_a_point_with_a_failed_run_is_given_up_and_avoided():
    def broken(run, x):
        return None if x > 0.05 else value(x)

    avoided = [x for x in proposals(plan_of(41, seeds=1), broken)[20:] if x > 0.05]
    chosen = [x for x in proposals(plan_of(41, seeds=1))[20:] if x > 0.05]
    assert len(avoided) < len(chosen) - 5


def _be_killed(plan, folder, after):
    """Tunes until so many runs are made, and is killed then."""

    def kill(done, total, told):
        if told and done == after:
            os.kill(os.getpid(), signal.SIGKILL)

    run_sweep(plan, folder, workers=1, progress=kill)


def test_the_file_of_the_page_can_be_read():
    text = (Path(__file__).parents[2] / "docs/guides/sweeps.md").read_text()
    (block,) = [
        part for part in text.split("```") if 'draw = "tpe"' in part and "[settings]" in part
    ]
    plan = SweepPlan(tomllib.loads(block))
    assert len(plan) == 41 * 6


@pytest.mark.slow("a whole tuning")
def test_tuning_on_the_bench_beats_the_controller_as_it_is_and_a_kill_changes_nothing(tmp_path):
    # From a first gain that is far too small, learning is slow: there is something to find.
    plan = plan_of(settings={**BENCH, "controller_config": {"initial_gain": 1e-3}})
    whole = run_sweep(plan, tmp_path / "whole", workers=2)
    (found,) = whole.tuned()
    assert (found.points, found.given_up, found.runs) == (6, 0, 2)
    (best,) = ask(
        tmp_path / "whole",
        "SELECT point, avg(rms_rad), any_value(controller_config_initial_gain) FROM runs"
        " GROUP BY 1 ORDER BY 2 LIMIT 1",
    ).rows
    assert (found.point, found.best) == (best[0], pytest.approx(best[1], rel=1e-12))
    assert found.point > 0
    assert found.best < 0.99 * found.as_it_is
    assert found.values == {GAIN: best[2]}
    assert "point" in str(found)
    # Killed in the middle.
    # Forked, so that it has the plug-ins that other tests may have loaded here.
    process = multiprocessing.get_context("fork").Process(
        target=_be_killed, args=(plan, tmp_path / "cut", 5)
    )
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    again = run_sweep(plan, tmp_path / "cut", workers=2)
    assert again.made == len(plan) - 5
    assert rows(tmp_path / "cut") == rows(tmp_path / "whole")
    # The same command has nothing to do, and the best run can be recorded.
    assert run_sweep(plan, tmp_path / "cut").made == 0
    assert read_sweep(tmp_path / "cut").tuned() == [found]


def test_a_default_that_nothing_beats_is_said_to_be_so():
    plan = plan_of(3, seeds=1, ranges={"controller_config.position_gain.x": [0.0, 1.0]})
    (points,) = plan.tuned
    made = [{"run": n, "status": "ok", "rms_rad": 1.0 + n} for n in points.runs(0)]
    made += [
        {"run": n, "status": "ok", "rms_rad": 3.0, "controller_config_position_gain_x": 0.5}
        for p in (1, 2)
        for n in points.runs(p)
    ]
    (found,) = tuning.tuned(plan, made)
    assert found.point == 0
    assert str(found) == (
        "block 1: none of 3 points is better than the block as it is: mean rms_rad of 1 run 1"
    )


@pytest.mark.parametrize(
    ("block", "message"),
    [
        (
            {"tune": {"metric": "rms"}},
            "block 1: tune: unknown number 'rms'.*did you mean 'rms_rad'",
        ),
        ({"draw": "sobol"}, "block 1: tune needs draw = 'tpe' or 'gp', not 'sobol'"),
        ({"ranges": {}, "points": None}, "draw is 'tpe': needs ranges and tune.metric"),
        ({"tune": {"metric": "rms_rad", "aim": "least"}}, "'lowest' or 'highest'"),
        ({"ranges": {"controller_config": {"memori": [1, 2]}}}, "run 1 .*memori"),
        ({"ranges": {"controller_config": {"memory": [-5, 2]}}}, "run 1 .*memory"),
        (
            {"ranges": {"controller_config": {"initial_gain": [1, 2]}, "severity": [2, 1e9]}},
            "run 2",
        ),
    ],
)
def test_what_cannot_be_tuned_is_refused_before_the_first_run(block, message):
    known = {
        "grid": {"seed": {"count": 2}},
        "ranges": {"controller_config": {"memory": [500, 3000]}},
        "draw": "tpe",
        "points": 5,
        "tune": {"metric": "rms_rad"},
    }
    content = {k: v for k, v in {**known, **block}.items() if v is not None}
    with pytest.raises(LeglabError, match=message):
        SweepPlan({"settings": BENCH, "block": [content]}).check()


def test_packages_that_are_missing_are_named(monkeypatch):
    monkeypatch.setattr(tuning, "find_spec", lambda name: None)
    with pytest.raises(LeglabError, match=r"draw = 'tpe' needs .*leglab\[tune\]"):
        tuning.check_optuna({"tpe"})
    monkeypatch.setattr(tuning, "find_spec", lambda name: name == "optuna" or None)
    with pytest.raises(LeglabError, match="draw = 'gp' needs the package torch"):
        tuning.check_optuna({"gp"})
