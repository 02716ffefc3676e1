"""What nobody means: every command says in one line what is wrong, and leaves nothing behind."""

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from leglab import data
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.controllers.pd import Pd
from leglab.data import matlab
from tests.cli.test_cli import leglab
from tests.helpers.report_folders import write_folder

BENCH = Path(__file__).parents[1] / "data" / "knee_bench_walk.parquet"
RUN = ("run", "nominal", "--model", "knee_bench", "--no-figures", "--out", "new")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("kept")
    time = np.arange(5) * 0.1
    odd = {"a,b": time, 'q"x': time}
    data.write(Recording(time=time, columns=odd), "odd.parquet")
    data.write(Recording(time=time, columns={"a\nb": time}), "line.parquet")
    (tmp_path / "deep.toml").write_text("columns = " + "[" * 3000 + "]" * 3000)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((*RUN, "--duration", "1e308"), "duration 1e+308 s has more than 5e+07 control periods"),
        ((*RUN, "--duration", "1e9"), "allowed: at most 100000 s"),
        ((*RUN, "--timestep", "0"), "timestep = 0 s; allowed: more than 0"),
        ((*RUN, "--timestep", "nan"), "timestep = nan s; allowed: more than 0"),
        ((*RUN, "--timestep", "-0.001"), "timestep = -0.001 s; allowed: more than 0"),
        (("diagnose", "knee_bench", BENCH, "--effect", "foo"), "unknown effect 'foo': choose one"),
        (("replicate", "--out", "file"), "file: cannot be written: File exists"),
        (("compare", "nominal", "--jobs", "100000"), "jobs is 100000; allowed: 1 to "),
        (("compare", "nominal", "--seeds", "1000000000"), "allowed: 1 to 100000"),
        (("inspect", BENCH, "--columns", "deep.toml"), "deep.toml: not a column map in TOML"),
        (("convert", "line.parquet", "x.csv"), r"column 'a\nb' has a line break"),
        (("run", "seal_were"), "unknown scenario 'seal_were'"),
        (("run", "nominal", "--controller", "lqr"), "unknown controller 'lqr'"),
        (("run", "nominal", "--model", "arm"), "unknown model 'arm'"),
        (("run", "nominal", "--model", "arm.xml"), "'arm.xml': there is no such file"),
        (("run", "nominal", "--model", "knee_bench", "--timestep", "0.01"), "too long"),
        (("run", "nominal", "--severity", "2"), "has no severity"),
        (("replicate", "--instances", "0"), "instances is 0"),
        (("parameters", "leglab.supplly"), "did you mean 'leglab.supply'"),
        (("video", "nowhere"), "'nowhere' is not the folder of a run"),
        (("run",), "Missing argument 'scenario'"),
        (("run", "nominal", "--bogus"), "No such option: --bogus"),
        (("nonsense",), "No such command 'nonsense'"),
        (("run", "nominal", "--seed", "x"), "for '--seed': Input should be a valid integer"),
        (("convert", "a.csv"), "Missing argument 'OUT'"),
        (("convert", "no.csv", "b.mat"), "there is no such file"),
        (("inspect", "no.csv"), "no.csv: there is no such file"),
    ],
)
def test_it_is_one_line(folder, capsys, arguments, told):
    before = {path.name for path in folder.iterdir()}
    status, printed, errors = leglab(*arguments, capsys=capsys)
    assert (status, printed) == (2, "")
    assert told in errors
    assert errors.count("\n") == 1
    assert {path.name for path in folder.iterdir()} == before


def test_names_with_commas_and_quotes_survive_csv(capsys):
    assert leglab("convert", "odd.parquet", "odd.csv", capsys=capsys)[0] == 0
    assert list(data.read("odd.csv").columns) == ["a,b", 'q"x']


def test_a_comparison_too_short_for_its_figure_is_made_all_the_same(folder, capsys):
    status, _, errors = leglab(
        *("compare", "nominal", "--model", "knee_bench", "--controllers", "pd"),
        *("--duration", "0.1", "--seeds", "1", "--jobs", "1", "--out", "new"),
        capsys=capsys,
    )
    assert status == 0
    assert errors.startswith("warning: no figure of nominal: no windowed error to draw")
    assert (folder / "new" / "compare.json").exists()


@pytest.mark.parametrize(
    ("command", "told"),
    [
        (
            lambda: 1 / 0,
            "failed at 0.5 s: ZeroDivisionError: division by zero (test_bad_input.py, line ",
        ),
        (lambda: "open", "gave str at 0.5 s, allowed is an array"),
        (lambda: np.array(["open"]), "gave an array of <U4 at 0.5 s, allowed are numbers"),
    ],
)
def test_a_controller_that_breaks_loses_nothing_recorded(capsys, monkeypatch, command, told):
    old = Pd.command

    def new(self, measurement, reference):
        return command() if measurement.time >= 0.5 else old(self, measurement, reference)

    monkeypatch.setattr(Pd, "command", new)
    status, _, errors = leglab(*RUN, "--duration", "1", capsys=capsys)
    assert status == 2
    assert f"controller 'pd' {told}" in errors
    assert errors.count("\n") == 1
    assert data.read("new/recording.parquet").duration == pytest.approx(0.5, abs=0.01)
    (phase,) = json.loads(Path("new/metrics.json").read_text())["phases"]
    assert phase["end"] == pytest.approx(0.5, abs=0.01)


SLOW = """
import time
from leglab import register_controller
from leglab.controllers.pd import Pd, PdConfiguration

@register_controller("slow", summary="x", configuration=PdConfiguration)
class Slow(Pd):
    def command(self, measurement, reference):
        time.sleep(0.004)
        return super().command(measurement, reference)
"""


def test_a_controller_that_is_slower_than_its_period_is_told(folder):
    (folder / "slow.py").write_text(SLOW)
    options = ("--load", "slow.py", "--controller", "slow", "--duration", "0.2")
    done = process(*RUN, *options, stdout=subprocess.PIPE)
    assert "warning: 100% of the commands of 'slow' take longer than the control period of" in (
        done.stderr
    )
    times = json.loads((folder / "new" / "metrics.json").read_text())["command_time_s"]
    assert 0.9 * 0.004 < times["median"] <= times["worst"]


PLUG_IN = """
import sys
import numpy as np
from leglab import register_controller
from leglab.references import Samples, register_reference, rest_pose

class Base:
    def __init__(self, setup): self.n = len(setup.joints)
    def reset(self, measurement): pass
    def command(self, measurement, reference): return np.zeros(self.n)

@register_controller("begins_wrong", summary="x")
class BeginsWrong(Base):
    def __init__(self, setup): {}["gains"]

@register_controller("reports_wrong", summary="x")
class ReportsWrong(Base):
    def diagnostics(self): return {"gain": np.zeros(7)}

@register_controller("leaves", summary="x")
class Leaves(Base):
    def command(self, measurement, reference): sys.exit(3)

def moving(form):
    def build(joints, config):
        rest = rest_pose(joints)
        return lambda t: form(t[:, None] * np.ones_like(rest), rest), 1.0
    return build

def register(name, form):
    register_reference(name, summary="x")(moving(form))

register("one_row", lambda t, rest: Samples(*(np.tile(rest, (1, 1)) for _ in range(3))))
register("no_number", lambda t, rest: Samples(rest + np.where(t > 0.1, np.nan, 0), 0 * t, 0 * t))
register("wrong_speed", lambda t, rest: Samples(rest + 0.1 * np.sin(t), np.sin(t), -np.sin(t)))
register("fails", lambda t, rest: 1 / 0)
"""


MISTAKES = {
    ("--controller", "begins_wrong"): "failed: KeyError: 'gains' (plug_in.py, line 14)",
    ("--controller", "reports_wrong"): "'gain' has shape (7,), allowed is (joints,) = (1,)",
    ("--controller", "leaves"): "failed at 0 s: SystemExit: 3 (plug_in.py, line 22)",
    ("--reference", "one_row"): "position has shape (1, 1), allowed is (",
    ("--reference", "no_number"): "position of joint 'knee' is nan at 0.102 s",
    (
        "--reference",
        "wrong_speed",
    ): "velocity of joint 'knee' is not the derivative of its position",
    ("--reference", "fails"): "failed: ZeroDivisionError: division by zero (plug_in.py, line ",
}
EACH = """
import sys
from leglab.cli import main
for option, name in {names}:
    sys.argv = ["leglab", *{run}, "--load", "plug_in.py", option, name]
    try:
        main()
    except SystemExit as end:
        print(end.code, flush=True)
"""


def test_a_mistake_in_a_plug_in_is_told_with_its_place(folder):
    (folder / "plug_in.py").write_text(PLUG_IN)
    # A process of its own: what is registered stays.
    script = EACH.format(names=list(MISTAKES), run=RUN)
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["2"] * len(MISTAKES)
    lines = done.stderr.splitlines()
    assert len(lines) == len(MISTAKES)
    for line, ((option, name), told) in zip(lines, MISTAKES.items(), strict=True):
        assert f"{option.removeprefix('--')} {name!r}" in line
        assert told in line


def test_a_broken_file_does_not_end_the_index(folder, capsys):
    write_folder(folder / "good")
    for name, text in {
        "a/compare.json": json.dumps(
            {"scenarios": [], "controllers": [], "model": "", "seeds": "1e999"}
        ).replace('"1e999"', "1e999"),
        "b/compare.json": '{"scenarios": [], "controllers": [], "model": "", "seeds": Infinity}',
        "c/diagnosis.json": '{"verdict": "x", "effects": [3]}',
        "d/metrics.json": "[" * 100_000,
    }.items():
        (folder / name).parent.mkdir()
        (folder / name).write_text(text)
    (folder / "p").mkdir()
    for name in ("metrics.json", "run.json", "recording.parquet", "report.html"):
        os.mkfifo(folder / "p" / name)
    status, printed, errors = leglab("index", folder, capsys=capsys)
    assert (status, errors) == (0, "warning: 5 of 6 cannot be read\n")
    assert printed.startswith("6 listed in ")


def process(*arguments, **options) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "leglab", *arguments],
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        **options,
    )


@pytest.mark.parametrize("asked", ["", "default"])
def test_what_a_library_warns_of_is_shown_to_those_who_ask(tmp_path, asked):
    (tmp_path / "a.py").write_text("import warnings\nwarnings.warn('ill-conditioned')\n")
    env = {**os.environ, "PYTHONWARNINGS": asked}
    done = process("list", "--load", "a.py", env=env, cwd=tmp_path, stdout=subprocess.PIPE)
    assert done.returncode == 0
    assert ("ill-conditioned" in done.stderr) == bool(asked)
    assert asked or not done.stderr


def test_output_that_is_full_or_closed_or_ascii_is_no_traceback():
    with open("/dev/full", "w") as full:
        done = process("list", stdout=full)
    assert done.returncode == 2
    assert done.stderr.endswith("No space left on device\n")
    assert done.stderr.count("\n") == 1
    plain = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    done = process(*RUN, "--duration", "1", env=plain, stdout=subprocess.PIPE)
    assert (done.returncode, done.stderr) == (0, "")
    done = process("list", env={**os.environ, "MUJOCO_GL": "foo"}, stdout=subprocess.PIPE)
    assert (done.returncode, done.stderr[:40]) == (2, "error: MUJOCO_GL is 'foo'; allowed: egl,")


@pytest.mark.parametrize(
    ("kind", "limit"), [(resource.RLIMIT_NOFILE, 8), (resource.RLIMIT_AS, 200_000_000)]
)
def test_little_of_what_the_system_gives_is_no_traceback(kind, limit):
    done = process(
        *RUN,
        stdout=subprocess.DEVNULL,
        preexec_fn=lambda: resource.setrlimit(kind, (limit, limit)),
    )
    assert done.returncode not in (0, 1)
    assert "Traceback" not in done.stderr


def test_a_compressed_variable_takes_no_more_memory_than_it_may(monkeypatch):
    from scipy.io import savemat

    monkeypatch.setattr(matlab, "_ROOM", 2**29)
    savemat("big.mat", {"a": np.zeros(2**25)}, do_compression=True)
    assert Path("big.mat").stat().st_size < 2**20
    with pytest.raises(LeglabError, match=r"big\.mat: not a complete MATLAB file: .*Memory"):
        data.read("big.mat")


@pytest.mark.parametrize("period", ["1e-9", "1e-300"])
def test_a_period_of_no_step_is_refused_before_anything_is_sized_by_it(capsys, period):
    status, _, errors = leglab(*RUN, "--set", f"sensors.control_period={period}", capsys=capsys)
    assert status == 2
    assert "allowed: a multiple of the model's timestep" in errors
    assert errors.count("\n") == 1
