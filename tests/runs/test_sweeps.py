"""Sweeps: plans, rows, what a kill leaves, runs that go wrong, questions to the rows."""

import json
import multiprocessing
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.stats import qmc

from leglab import RunSettings, run_scenario
from leglab.base import plugins
from leglab.base.errors import LeglabError
from leglab.base.output import claimed_folder, write_json
from leglab.control.contract import CONTROLLERS
from leglab.jobs import engine as jobs
from leglab.runs.sweeps import engine, store
from leglab.runs.sweeps.engine import read_sweep, run_sweep
from leglab.runs.sweeps.plan import SweepPlan, read_plan
from leglab.runs.sweeps.query import ask
from leglab.runs.sweeps.rows import MADE, row_of
from tests.cli.test_cli import leglab as command_line

BENCH = {"model": "knee_bench", "scenario": "seal_wear", "controller": "pd", "duration": 0.3}

# A controller that goes wrong as it is told, 0.1 s after the start.
BAD = '''
import ctypes, os, signal, time
from pathlib import Path
import numpy as np
from leglab import Configuration, register_controller

class Wrong(Configuration):
    """Settings of `wrong`."""
    how: str = "not"
    mark: str = ""

@register_controller("wrong", summary="goes wrong", configuration=Wrong)
class Controller:
    def __init__(self, setup, config):
        self.joints, self.config = len(setup.joints), config
    def reset(self, measurement):
        pass
    def command(self, measurement, reference):
        command, how = np.zeros(self.joints), self.config.how
        if measurement.time > 0.1:
            if how == "nan":
                command[:] = np.nan
            elif how == "raise":
                raise RuntimeError("it raises")
            elif how == "hang":
                time.sleep(1000)
            elif how == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            elif how == "crash":
                ctypes.string_at(0)
            elif how == "memory":
                np.ones(10**10)
            elif how == "print":
                print('{"result": {}}', flush=True)
            elif how == "once" and not Path(self.config.mark).exists():
                Path(self.config.mark).touch()
                os.kill(os.getpid(), signal.SIGKILL)
        return command
    def diagnostics(self):
        return {}
'''


def plan_of(**content) -> SweepPlan:
    base = {"settings": BENCH, "block": [{"grid": {"seed": {"count": 4}}}]}
    return SweepPlan({**base, **content})


def rows(folder: Path) -> list[dict]:
    """All rows of a sweep without what differs from one making to the next."""
    found = read_sweep(folder).table().to_pylist()
    return [{k: v for k, v in row.items() if k not in MADE} for row in found]


def test_a_grid_has_every_combination_once_and_blocks_follow_each_other():
    plan = plan_of(
        block=[
            {"grid": {"scenario": ["seal_wear", "cold_oil"], "seed": {"first": 3, "count": 2}}},
            {"settings": {"scenario": "nominal"}, "grid": {"controller_config": {"a.b": [1, 2]}}},
        ]
    )
    made = [(s.scenario, s.seed, dict(s.controller_config)) for s in plan]
    assert made == [
        *((name, seed, {}) for name in ("seal_wear", "cold_oil") for seed in (3, 4)),
        ("nominal", 0, {"a.b": 1}),
        ("nominal", 0, {"a.b": 2}),
    ]
    assert plan.axes == ("scenario", "seed", "controller_config.a.b")


def test_drawn_points_are_those_of_scipy_and_meet_every_combination():
    block = {
        "grid": {"controller": ["pd", "pid"]},
        "ranges": {"severity": {"low": 2.0, "high": 32.0, "log": True}, "tolerance": [0.0, 0.2]},
        "points": 5,
        "draw_seed": 7,
    }
    made = list(plan_of(block=[block]))
    unit = qmc.Sobol(2, seed=7).random(8)[:5]
    for half, controller in ((made[:5], "pd"), (made[5:], "pid")):
        assert {run.controller for run in half} == {controller}
        np.testing.assert_allclose([run.severity for run in half], 2 * 16 ** unit[:, 0])
        np.testing.assert_allclose([run.tolerance for run in half], 0.2 * unit[:, 1])
    drawn = plan_of(block=[{**block, "draw": "random"}])
    unit = np.random.default_rng(7).random((5, 2))
    np.testing.assert_allclose([run.tolerance for run in drawn][:5], 0.2 * unit[:, 1])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("block = []", "setting 'block' is .*: list should have at least 1 item"),
        ("blok = 1\nblock = [{}]", "unknown setting of .* 'blok'.*did you mean 'block'"),
        ("[[block]]", "block 1: needs 'scenario', in settings or grid"),
        ("[[block]]\ngrid.scenaro = ['x']", "block 1: grid: unknown setting .* 'scenaro'.*did you"),
        ("[[block]]\ngrid.scenario = ['seal_waer']", r"run 0 \(scenario seal_waer\): unknown scen"),
        ("[[block]]\ngrid.scenario = 'seal_wear'", "block 1: grid.scenario is 'seal_wear'; allow"),
        ("[[block]]\ngrid.seed = [1, 1]", "block 1: grid.seed: 1 is given twice"),
        ("[[block]]\ngrid.seed = [0, -1]", r"run 1 .*: seed -1 is negative"),
        ("[[block]]\ngrid.seed = [1.5]", r"grid.seed\[0\] is 1.5: input should be a valid integer"),
        ("[[block]]\ngrid.severity = [3, nan]", r"grid.severity\[1\] is nan; allowed: a finite"),
        ("[[block]]\nranges.severity = [2, 5]", "block 1: ranges need 'points'"),
        ("[[block]]\nranges.severity = [5, 2]\npoints = 2", "low 5 is not below high 2"),
        ("[[block]]\nranges.seed = [0, 5]\npoints = 2", "ranges.seed is 0.0: .*valid integer"),
        (
            "[[block]]\nranges.severity = {low=0, high=5, log=true}\npoints = 2",
            "allowed: more than",
        ),
        ("[[block]]\ngrid.severity = [3, 1e9]", "run 1 .*severity 1000000000.0 is outside"),
        ("[[block]]\ngrid.controller_config.gian = [1]", "run 0 .*unknown setting of controller"),
        ("[[block]]\ngrid.element = ['hip']", "run 0 .*hip"),
        ("[[block]]\ngrid.parameters.bore = [9]", r"run 0 .*bore = 9; allowed \[0.001, 0.5\] m"),
        ("[[block]]\ngrid.parameters.bohr = [9]", "run 0 .*'bohr'"),
        ("[[block]]\nsettings.seed = 'a'", "block 1: settings.seed is 'a': input should be"),
        ("[[block]]\nsettings.sensors = 3", "block 1: settings: sensors is 3; allowed: a table"),
        ("[[block]]\ngrid.seed = {count=100_000_000}", "less than or equal to 10000000"),
        ("a = [", "is not TOML"),
    ],
)
def test_a_bad_file_is_refused_in_one_line_before_anything_runs(tmp_path, content, message, capsys):
    file = tmp_path / "F"
    shared = "[settings]\nmodel = 'knee_bench'\nduration = 0.3\n"
    if "scena" not in content + message:
        shared += "scenario = 'seal_wear'\n"
    file.write_text(shared + content if content.startswith("[[") else content)
    out = tmp_path / "out"
    status, _, told = command_line("sweep", file, "--out", out, capsys=capsys)
    assert status == 2
    assert str(file) in told
    assert told.count("\n") == 1
    with pytest.raises(LeglabError, match=message):
        read_plan(file).check()
    assert not out.exists()


def test_rows_hold_the_figures_of_the_runs_themselves(tmp_path):
    plan = plan_of(
        settings={**BENCH, "duration": 5.0, "tolerance": 0.1},
        block=[
            {"grid": {"controller": ["pd", "bsnn_arx"], "seed": [0, 3]}},
            {"settings": {"scenario": "nominal", "parameters": {"knee_spring.k1": 31.0}}},
        ],
        keep=["metrics", "traces", "recordings"],
    )
    result = run_sweep(plan, tmp_path / "s", workers=2)
    assert (result.made, result.done, result.failed) == (5, 5, 0)
    found = result.table().to_pylist()
    assert [row["run"] for row in found] == [0, 1, 2, 3, 4]
    for row, settings in zip(found, plan, strict=True):
        run = run_scenario(settings)
        clock = {"real_time_factor": 0, "command_time_s": 0}
        metrics = {**run.metrics, **clock}
        assert {**json.loads(row["metrics"]), **clock} == metrics
        told = run.record.adaptation
        assert row["before_rad"] == (told.before_rad and told.before_rad["all"])
        assert (row["recovered"], row["t90_s"]) == (told.recovered, told.t90_s)
        assert row["rms_rad"] == pytest.approx(np.sqrt(np.mean(run.history.error**2)))
        travel = np.abs(np.diff(run.history.command, axis=0)).sum()
        assert row["valve_travel"] == pytest.approx(travel)
        energy = sum(phase.energy_j["all"] for phase in run.record.phases)
        assert row["energy_j"] == pytest.approx(energy)
        late = run.history.time > 5.0 - run.window  # which sample is the first may differ
        assert row["windowed_rad"][-1] == pytest.approx(
            np.sqrt(np.mean(run.history.error[late] ** 2)), rel=3e-3
        )
        assert row["duration"] == 5.0
        assert row["severity"] == run.scenario.severity
        recording = tmp_path / "s" / "recordings" / "00000" / str(row["run"]) / "metrics.json"
        assert json.loads(recording.read_text())["seed"] == settings.seed
    assert found[4]["parameters"] == '{"knee_spring.k1": 31.0}'
    assert found[4]["parameters_knee_spring_k1"] == 31.0
    # Known by any reader of partitioned Parquet.
    assert len(pq.read_table(tmp_path / "s" / "runs")) == 5


def test_a_sweep_goes_on_where_it_was_and_knows_its_folder(tmp_path, monkeypatch):
    plan, folder = plan_of(), tmp_path / "s"
    whole = run_sweep(plan, tmp_path / "whole", workers=1)
    asked = []

    processes = jobs._processes

    @contextmanager
    def noted(count, terms):
        with processes(count, terms) as answered:
            yield lambda tasks: answered(
                task for task in tasks if not asked.append(task[1]["settings"]["seed"])
            )

    def stop(done, total, label):
        if done == 2 and label:
            raise KeyboardInterrupt

    monkeypatch.setattr(jobs, "_processes", noted)
    with pytest.raises(KeyboardInterrupt):
        run_sweep(plan, folder, workers=1, progress=stop)
    assert len(rows(folder)) == 2
    asked.clear()
    again = run_sweep(plan, folder, workers=1)
    assert asked == [2, 3]
    assert (again.made, again.done) == (2, 4)
    assert rows(folder) == rows(whole.folder)
    assert run_sweep(plan, folder, workers=1).made == 0
    # Another sweep, another folder.
    other = plan_of(block=[{"grid": {"seed": {"count": 3}}}])
    with pytest.raises(
        LeglabError, match="run 3 is not in the new plan: give another folder, or -"
    ):
        run_sweep(other, folder)
    monkeypatch.setattr(engine, "fingerprint", lambda: "other")
    with pytest.raises(LeglabError, match="was begun with other code"):
        run_sweep(plan, folder)
    monkeypatch.undo()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years")
    with pytest.raises(LeglabError, match="holds no sweep but other files"):
        run_sweep(plan, tmp_path / "mine", overwrite=True)
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "years"


def test_a_sweep_that_is_replaced_stays_until_the_new_one_is_whole(tmp_path, monkeypatch):
    folder = tmp_path / "s"
    plan, other = plan_of(), plan_of(block=[{"grid": {"seed": {"count": 3}}}])
    run_sweep(plan, folder, workers=1)
    before, page = rows(folder), folder / "report.html"
    page.write_text("a page of this folder")

    def stop(done, total, label):
        if done == 1:
            raise KeyboardInterrupt

    # A file cannot be moved; the process is interrupted; the rest is made by the same command.
    moved = Path.rename

    def fails(path, target):
        if path.name == "runs":
            raise OSError(28, "No space left on device")
        return moved(path, target)

    with monkeypatch.context() as broken:
        broken.setattr(Path, "rename", fails)
        with pytest.raises(LeglabError, match="cannot be written"):
            run_sweep(other, folder, workers=1, overwrite=True)
    assert rows(folder) == before
    with pytest.raises(KeyboardInterrupt):
        run_sweep(other, folder, workers=1, overwrite=True, progress=stop)
    assert (len(rows(folder)), rows(folder / ".earlier")) == (1, before)
    assert run_sweep(other, folder, workers=1).made == 2
    assert len(rows(folder)) == 3
    assert page.read_text() == "a page of this folder"
    assert not list(folder.glob(".*"))


def test_a_sweep_grows_by_seeds_and_settings(tmp_path):
    folder = tmp_path / "s"
    less = plan_of(block=[{"grid": {"seed": [0, 2]}}])
    added = {"grid": {"seed": [0, 1, 2], "severity": [5.0, 20.0]}}
    more = plan_of(block=[added, {"grid": {"seed": [2, 0]}}])
    before = run_sweep(less, folder, workers=1).table().to_pylist()
    grown = run_sweep(more, folder, workers=1)
    assert (grown.made, grown.done) == (6, 8)
    assert rows(folder) == rows(run_sweep(more, tmp_path / "anew", workers=1).folder)
    kept = {row["seed"]: row["made_at"] for row in grown.table().to_pylist()[6:]}
    assert kept == {row["seed"]: row["made_at"] for row in before}
    assert not list(folder.glob(".*"))


def there(folder: Path) -> list[dict]:
    """Rows of a sweep that may not have begun."""
    return rows(folder) if store.is_sweep(folder) else []


def _be_killed(content, folder):
    os.setsid()
    run_sweep(SweepPlan(content), folder, workers=2)


@pytest.mark.parametrize(
    ("sweeps", "each", "seeds"),
    [(1, 6, 60), pytest.param(2, 15, 300, marks=pytest.mark.slow("thirty kills"))],
)
def test_kills_lose_nothing_and_double_nothing(tmp_path, sweeps, each, seeds):
    """Sweeps, killed at random moments: while they start, run, write and put files together."""
    chance, kills = random.Random(5), 0
    content = {
        "settings": {**BENCH, "duration": 0.3},
        "block": [{"grid": {"controller": ["pd", "pid"], "seed": {"count": seeds}}}],
    }
    whole = tmp_path / "whole"
    run_sweep(SweepPlan(content), whole, workers=2)
    wanted = rows(whole)
    assert [row["run"] for row in wanted] == list(range(2 * seeds))
    # Forked: what is imported here need not be imported thirty times.
    context = multiprocessing.get_context("fork")
    for number in range(sweeps):
        folder, before = tmp_path / f"s{number}", 0
        for kill in range(each):
            process = context.Process(target=_be_killed, args=(content, folder))
            process.start()
            time.sleep(chance.uniform(0.02, 1.7))
            # Every other one while rows come, however long the start takes.
            while kill % 2 and process.is_alive() and len(there(folder)) <= before:
                time.sleep(0.01)
            process.kill()
            process.join()
            kills += process.exitcode == -signal.SIGKILL
            found = there(folder)
            assert len(found) >= before  # Rows that were there stay.
            assert len({row["run"] for row in found}) == len(found)
            assert kill % 2 == 0 or len(found) > before
            before = len(found)
        last = run_sweep(SweepPlan(content), folder, workers=2)
        assert last.made == 2 * seeds - before
        assert rows(folder) == wanted
        parts = sorted(path.name for path in (folder / "runs").rglob("*") if path.is_file())
        assert len(parts) == 2
        assert {p.name for p in folder.iterdir()} == {"sweep.json", "dataset.json", "runs"}
    assert kills == sweeps * each


@pytest.mark.parametrize("at", range(1, 12))
def test_an_end_at_any_step_of_the_books_keeps_every_row(tmp_path, monkeypatch, at):
    """The process ends before or after the n-th step that changes files.

    Of a sweep that becomes whole, of which the failed runs are made again.
    """
    plan = plan_of(block=[{"grid": {"seed": {"count": 3}, "controller": ["pd/%", "pid"]}}])
    record = store.SweepRecord(
        plan=plan.content, digest="", code="", models={}, runs=6, axes=[], version=""
    )
    write_json(tmp_path / store.SWEEP, record.model_dump(), indent=1)
    names = ("rms_rad", "peak_rad", "came_to_s", "valve_travel", "effort")
    figures = {**dict.fromkeys(names, 1 / 7), "named": ["x at y"]}
    steps = 0

    class End(BaseException):
        pass

    def ending(step):
        def taken(*arguments, **options):
            nonlocal steps
            steps += 1
            if steps == at and at % 2:
                raise End
            found = step(*arguments, **options)
            if steps == at:
                raise End
            return found

        return taken

    def make(failing=()):
        books = store.Store(tmp_path, plan)
        if not failing:
            books.forget_failed()
        made = list(books.missing())
        for number in made:
            failed = {"error": "it is made to fail", "kind": "died"}
            books.add(number, failed if number in failing else {"result": figures}, "here")
        books.finish()
        return made

    with monkeypatch.context() as ends, suppress(End):
        for name in ("write_atomically", "remove", "_connect"):
            ends.setattr(store, name, ending(getattr(store, name)))
        ends.setattr(Path, "unlink", ending(Path.unlink))
        make(failing=(1, 4))
        make()
    known = {row["run"] for row in there(tmp_path) if row["status"] == "ok"}
    assert known in ({*()}, {0, 2, 3, 5}, {*range(6)})
    assert set(make()) == {*range(6)} - known
    found = rows(tmp_path)
    assert [(row["run"], row["seed"], row["controller"]) for row in found] == [
        (number, number // 2, ("pd/%", "pid")[number % 2]) for number in range(6)
    ]
    for row in found:
        assert {name: row[name] for name in figures} == figures
        assert (row["vary"], row["status"], row["t90_s"]) == (False, "ok", None)
    assert len(list((tmp_path / "runs").glob("*/*/*"))) == 2
    assert not list(tmp_path.glob(f"*{store.ROWS}*"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A sweep of six runs, and its plan."""
    plan = plan_of(block=[{"grid": {"controller": ["pd", "pid"], "seed": {"count": 3}}}])
    folder = tmp_path_factory.mktemp("sweep") / "whole"
    run_sweep(plan, folder, workers=1)
    return plan, folder


def test_rows_of_an_earlier_leglab_are_read_or_refused(whole, tmp_path, capsys):
    shutil.copytree(whole[1], tmp_path, dirs_exist_ok=True)
    wanted, file = rows(tmp_path), tmp_path / "dataset.json"
    earlier = {"generation": 7, **json.loads(file.read_text())}
    del earlier["proposals"]
    file.write_text(json.dumps(earlier))
    assert rows(tmp_path) == wanted
    (tmp_path / "journal-7.jsonl").write_bytes(b"0a1b2c3d {}\n")
    status, _, told = command_line("query", tmp_path, "SELECT * FROM runs", capsys=capsys)
    assert (status, told.count("\n")) == (2, 1)
    assert "journal-7.jsonl: an earlier leglab has not made this sweep to its end" in told
    assert run_sweep(whole[0], tmp_path, workers=1, overwrite=True).made == 6
    assert rows(tmp_path) == wanted


def test_no_flipped_bit_is_read_as_other_rows(whole, tmp_path):
    shutil.copytree(whole[1], tmp_path, dirs_exist_ok=True)
    (part,) = (tmp_path / "runs").rglob("*=pid/*.parquet")
    before, chance = part.read_bytes(), random.Random(1)
    for _ in range(60):
        content = bytearray(before)
        content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        part.write_bytes(content)
        with pytest.raises(LeglabError, match="damaged"):
            rows(tmp_path)


@pytest.mark.parametrize("damage", ["cut off", "changed", "missing"])
def test_a_damaged_file_is_named_and_its_runs_are_made_again(whole, tmp_path, damage, capsys):
    plan, made = whole
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    wanted = rows(tmp_path)
    (part,) = (tmp_path / "runs").glob("*/controller=pid/*")
    content = bytearray(part.read_bytes())
    if damage == "missing":
        part.unlink()
    else:
        content[len(content) // 3] ^= 4
        part.write_bytes(content[: len(content) // 2] if damage == "cut off" else content)
    status, _, told = command_line("query", tmp_path, "SELECT * FROM runs", capsys=capsys)
    assert status == 2
    assert told.count("\n") == 1
    with pytest.raises(LeglabError, match=r"part-0.parquet.*makes its runs again"):
        rows(tmp_path)
    again = run_sweep(plan, tmp_path, workers=1)
    assert again.made == 3
    assert "controller=pid/part-0.parquet is damaged" in again.damaged[0]
    assert rows(tmp_path) == wanted


@pytest.fixture(scope="module")
def wrong(tmp_path_factory):
    """Name of a controller that goes wrong, loaded here."""
    file = tmp_path_factory.mktemp("plugins") / "wrong.py"
    file.write_text(BAD)
    plugins.load(str(file))
    yield "wrong"
    # Other tests loop over all controllers.
    for place in (CONTROLLERS._entries, CONTROLLERS._definitions, sys.modules):
        place.pop("wrong", None)
    sys.path.remove(str(file.parent))
    plugins._sources.pop(str(file))
    plugins._files.pop(file, None)


def test_runs_that_go_wrong_are_rows_and_stop_nothing(tmp_path, wrong):
    hows = ["not", "nan", "raise", "kill", "crash", "memory", "print", "once"]
    mark = str(tmp_path / "mark")
    plan = plan_of(
        settings={**BENCH, "controller": wrong, "controller_config": {"mark": mark}},
        block=[{"grid": {"controller_config.how": hows}}],
        memory=3000.0,
    )
    result = run_sweep(plan, tmp_path / "s", workers=2)
    found = {row["controller_config_how"]: row for row in result.table().to_pylist()}
    assert {how: row["failure"] for how, row in found.items()} == {
        "not": None,
        "nan": "ended early",
        "raise": "ended early",
        "kill": "died",
        "crash": "died",
        "memory": "memory",
        "print": None,
        "once": None,  # A process that somebody else killed gets a second try.
    }
    assert "gave nan for joint 'knee' at 0.102 s" in found["nan"]["error"]
    assert "RuntimeError: it raises" in found["raise"]["error"]
    assert "signal 9 SIGKILL" in found["kill"]["error"]
    assert "signal 11 SIGSEGV" in found["crash"]["error"]
    assert "MemoryError" in found["memory"]["error"]
    assert Path(mark).exists()
    assert result.failed == 5
    assert all((row["status"] == "failed") == bool(row["failure"]) for row in found.values())
    assert found["nan"]["rms_rad"] is None
    assert found["print"]["rms_rad"] == found["not"]["rms_rad"]


def test_a_run_that_hangs_is_ended_after_the_time_out(tmp_path, wrong):
    # Alone: on a busy machine a good run, too, may take longer than so short a time-out.
    plan = plan_of(
        settings={**BENCH, "controller": wrong, "controller_config": {"how": "hang"}},
        block=[{}],
        timeout=1.0,
    )
    (row,) = run_sweep(plan, tmp_path / "s", workers=1).table().to_pylist()
    assert (row["failure"], row["error"]) == ("time-out", "it took longer than 1 s")


def test_failed_runs_are_made_again_if_asked_for(tmp_path, wrong):
    mark = tmp_path / "mark"
    plan = plan_of(
        settings={**BENCH, "controller": wrong, "controller_config": {"mark": str(mark)}},
        block=[{"grid": {"controller_config.how": ["raise", "not"], "seed": [0, 1]}}],
    )
    assert run_sweep(plan, tmp_path / "s", workers=1).failed == 2
    assert run_sweep(plan, tmp_path / "s", workers=1).made == 0
    again = run_sweep(plan, tmp_path / "s", workers=1, retry_failed=True)
    assert (again.made, again.done, again.failed) == (2, 4, 2)
    assert [row["run"] for row in rows(tmp_path / "s")] == [0, 1, 2, 3]


@pytest.mark.parametrize(
    "lie",
    [
        {"result": {"rms_rad": 1.0}},
        {"result": {"rms_rad": "low"}},
        {"result": [1]},
        {"error": 3},
        {},
    ],
)
def test_what_a_process_says_is_not_trusted(lie):
    row = row_of(plan_of(), 0, lie, "x")
    assert row["status"] == "failed"
    assert row["error"]
    assert row["rms_rad"] is None if "rms_rad" in row else True


def test_a_second_sweep_on_a_folder_is_refused_while_the_first_runs(tmp_path, capsys, monkeypatch):
    file = tmp_path / "sweep.toml"
    file.write_text(
        "[settings]\nmodel='knee_bench'\nduration=0.3\nscenario='seal_wear'\n"
        "[[block]]\ngrid.seed = {count=5000}\n"
    )
    out = tmp_path / "out"
    command = [sys.executable, "-m", "leglab", "sweep", str(file), "--out", str(out)]
    first = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + 60
        while not there(out):
            assert time.monotonic() < deadline
            assert first.poll() is None, first.communicate()
            time.sleep(0.05)
        status, _, told = command_line("sweep", file, "--out", out, capsys=capsys)
        assert status == 2
        assert f"{out}: process {first.pid} on " in told
        # Asking is allowed meanwhile.
        assert ask(out, "SELECT count(*) FROM runs").rows[0][0] > 0
        with monkeypatch.context() as elsewhere:
            elsewhere.setattr("socket.gethostname", lambda: "elsewhere")
            with pytest.raises(LeglabError, match=r"process \d+ on .* is writing it; ask on that"):
                rows(out)
        first.send_signal(signal.SIGINT)
        errors = first.communicate(timeout=60)[1]
    finally:
        first.kill()
    assert first.returncode == 130
    assert "the same command goes on from there" in errors
    assert "Traceback" not in errors
    with claimed_folder(out):
        pass
    assert rows(out)


def test_questions_are_answered_and_nothing_else_is_done(whole, tmp_path, capsys):
    shutil.copytree(whole[1], tmp_path, dirs_exist_ok=True)
    secret = tmp_path / "secret.csv"
    secret.write_text("a\n1\n")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    sql = "SELECT controller, count(*) AS n, max(seed) AS top FROM runs GROUP BY 1 ORDER BY 1"
    assert ask(tmp_path, sql).rows == (("pd", 3, 2), ("pid", 3, 2))
    status, printed, _ = command_line("query", tmp_path, sql, "--json", capsys=capsys)
    assert json.loads(printed)[1] == {"controller": "pid", "n": 3, "top": 2}
    assert command_line("query", tmp_path, sql, capsys=capsys)[1].split()[-3:] == ["pid", "3", "2"]
    # What is wider than the terminal stands one field a line, each whole.
    wide = command_line("query", tmp_path, "SELECT * FROM runs LIMIT 2", capsys=capsys)[1]
    assert len(wide.splitlines()) == 2 * (1 + len(ask(tmp_path, "SELECT * FROM runs").names))
    assert re.search(r"^  controller +p(d|id)$", wide, re.MULTILINE)
    status, printed, _ = command_line("query", tmp_path, sql, "--csv", "-", capsys=capsys)
    assert printed == "controller,n,top\npd,3,2\npid,3,2\n"
    out = tmp_path / "answer.csv"
    assert command_line("query", tmp_path, sql, "--csv", out, capsys=capsys)[0] == 0
    assert out.read_text() == printed
    out.unlink()
    for bad in (
        f"COPY runs TO '{tmp_path}/x.csv'",
        f"SELECT * FROM read_csv('{secret}')",
        f"SELECT * FROM '{secret}'",
        f"ATTACH '{tmp_path}/x.db'",
        "SELECT * FROM glob('/*')",
        "SELECT * FROM plan",
        "SET enable_external_access = true",
        "SELECT 1; SELECT 2",
        "SELECT nothing FROM runs",
        "DROP VIEW runs",
        "",
    ):
        status, _, told = command_line("query", tmp_path, bad, capsys=capsys)
        assert status == 2, bad
        assert told.startswith("error: ")
        assert told.count("\n") == 1
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_settings_come_back_as_they_were(tmp_path):
    plan = plan_of(block=[{"grid": {"seed": [5]}, "settings": {"sensors": {"latency": 0.001}}}])
    (settings,) = plan
    assert settings == RunSettings(**{**BENCH, "seed": 5, "sensors": {"latency": 0.001}})
    assert RunSettings(**json.loads(json.dumps(asdict(settings)))) == settings
    assert SweepPlan(plan.content).digest == plan.digest
