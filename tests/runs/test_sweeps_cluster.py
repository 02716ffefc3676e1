"""The same sweep on a Dask cluster: a scheduler and two workers as processes of their own."""

import json
import os
import signal
import time

import pytest
from pydantic import TypeAdapter

from benchmarks.self_test.outcomes import run_missing
from benchmarks.self_test.rough import RoughTestCase
from benchmarks.sweeps import cluster
from leglab.base.errors import LeglabError
from leglab.runs.sweeps.engine import read_sweep, run_sweep
from tests.cli.test_cli import leglab as command_line
from tests.runs.test_sweeps import BENCH, SweepPlan, rows, wrong  # noqa: F401

distributed = pytest.importorskip("distributed")


def wait_for_each_worker(address, patience=60.0):
    """Waits until each worker holds an answer."""
    end = time.monotonic() + patience
    with distributed.Client(address, timeout=patience, set_as_default=False) as client:
        while not all(client.has_what().values()):
            assert time.monotonic() < end
            time.sleep(0.05)


@pytest.fixture
def two(tmp_path):
    with cluster(tmp_path) as found:
        yield found


@pytest.mark.slow("a cluster")
def test_a_cluster_gives_the_same_rows_and_one_of_its_workers_may_be_killed(two, tmp_path):
    address, (_, *workers) = two
    grid = {"controller": ["pd", "pid"], "seed": {"count": 40}}
    plan = SweepPlan({"settings": BENCH, "block": [{"grid": grid}]})
    killed = []

    def kill(done, total, label):
        if done == 1:  # One that starts late would find all made.
            wait_for_each_worker(address)
        if done == 15 and not killed:
            killed.append(workers[0].pid)
            os.kill(workers[0].pid, signal.SIGKILL)

    result = run_sweep(plan, tmp_path / "there", scheduler=address, progress=kill)
    assert (result.made, result.failed) == (80, 0)
    by = read_sweep(tmp_path / "there").table().column("made_by").to_pylist()
    assert len(set(by)) == 2
    assert killed
    assert workers[0].wait(10) == -signal.SIGKILL
    run_sweep(plan, tmp_path / "here", workers=2)
    assert rows(tmp_path / "there") == rows(tmp_path / "here")


@pytest.mark.slow("a cluster")
def test_a_comparison_and_a_self_test_run_on_a_cluster(two, tmp_path, capsys):
    address, _ = two
    words = ("compare", "seal_wear", "--controllers", "pd,pid", "--seeds", "2", "--duration", "3")
    common = (*words, "--model", "knee_bench", "--no-figures", "--json", "--out")
    there = command_line(*common, tmp_path / "there", "--scheduler", address, capsys=capsys)
    here = command_line(*common, tmp_path / "here", "--jobs", "2", capsys=capsys)
    assert (there[0], json.loads(there[1])) == (0, json.loads(here[1]))
    status, _, told = command_line(
        *common, tmp_path / "both", "--scheduler", address, "--jobs", "2", capsys=capsys
    )
    assert (status, "go without a scheduler" in told) == (2, True)
    outcomes = run_missing(
        tmp_path / "outcomes.jsonl",
        [RoughTestCase(kind="null", number=n, specimen=n, faults=()) for n in range(3)],
        told_case,
        parse=TypeAdapter(RoughTestCase).validate_python,
        settings={"add": 4},
        scheduler=address,
    )
    assert [outcome.specimen for outcome in outcomes] == [4, 5, 6]


def told_case(given):
    """A case that is quickly done."""
    return {**given["case"], "specimen": given["case"]["specimen"] + given["settings"]["add"]}


@pytest.mark.slow("a cluster")
def test_runs_that_go_wrong_leave_the_workers_alone(two, tmp_path, wrong):  # noqa: F811
    address, (_, *workers) = two
    plan = SweepPlan(
        {
            "settings": {**BENCH, "controller": wrong},
            "block": [{"grid": {"controller_config.how": ["not", "kill", "crash"]}}],
        }
    )
    assert run_sweep(plan, tmp_path / "s", scheduler=address).failed == 2
    assert [row["failure"] for row in rows(tmp_path / "s")] == [None, "died", "died"]
    assert [worker.poll() for worker in workers] == [None, None]


@pytest.mark.slow("a cluster")
def test_a_scheduler_that_ends_is_told_and_the_sweep_goes_on_later(tmp_path, capfd):
    plan = SweepPlan({"settings": BENCH, "block": [{"grid": {"seed": {"count": 60}}}]})
    with cluster(tmp_path, workers=1) as (address, (scheduler, _)):

        def end(done, total, label):
            if done == 5:
                scheduler.kill()

        with pytest.raises(LeglabError, match=r"is gone: the same command goes on"):
            run_sweep(plan, tmp_path / "s", scheduler=address, progress=end)
        assert capfd.readouterr().err == ""
    kept = len(rows(tmp_path / "s"))
    assert kept >= 5
    assert run_sweep(plan, tmp_path / "s", workers=2).made == 60 - kept


def test_what_cannot_be_reached_is_told_in_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("leglab.jobs.cluster._PATIENCE", 2.0)
    file = tmp_path / "sweep.toml"
    file.write_text("settings = {scenario='nominal', model='knee_bench'}\n[[block]]\n")
    for address in ("tcp://127.0.0.1:9", "nonsense://x", "127.0.0.1"):
        arguments = ("sweep", file, "--out", tmp_path / "s", "--scheduler", address)
        status, _, told = command_line(*arguments, capsys=capsys)
        assert status == 2
        assert told.splitlines()[-1].startswith(f"error: scheduler {address!r} cannot be reached")
