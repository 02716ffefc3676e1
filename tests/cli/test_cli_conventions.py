"""What all commands have in common: help, completion, JSON, exit status, start-up."""

import json
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from leglab import data
from leglab.cli import options
from leglab.cli.app import app, main
from leglab.cli.conventions import EXAMPLES, explain, spread
from tests.cli.test_cli import leglab as call
from tests.data.test_interop import example

COMMANDS = typer.main.get_command(app).commands
HEAVY = ("mujoco", "scipy", "matplotlib", "numpy", "pyarrow", "control")
# Commands that open a window: there is nothing to print.
INTERACTIVE = ("view",)
# Arguments with which a command is cheap; the others print their JSON at the end of long work.
CHEAP = {
    "list": (),
    "parameters": ("leglab.cylinder",),
    "inspect": ("run.csv",),
    "convert": ("run.csv", "run.mat"),
    "run": ("nominal", "--model", "knee_bench", "--duration", "1.5", "--no-figures"),
}


def parse(stdout):
    """Returns what JSON alone says; a progress bar or a message beside it is an error."""
    return json.loads(stdout, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name, capsys):
    command = COMMANDS[name]
    purpose = command.help.split("\n\n")[0]
    assert purpose.endswith(".")
    assert purpose[0].isupper()
    examples = (command.epilog or "").count(f"leglab {name}")
    assert examples >= 2, f"give leglab {name} two examples in leglab/cli/conventions.py"
    options = [p for p in command.params if p.param_type_name == "option" and p.name != "help"]
    for option in options:
        assert option.help, f"{name} {option.name}"
    status, shown, _ = call(name, "--help", capsys=capsys)
    assert status == 0
    # Rich takes [s] for markup unless it is escaped.
    units = [u for p in command.params for u in re.findall(r"\[[^]]+\]", p.help or "")]
    assert [unit for unit in units if unit.replace("\\", "") not in shown] == []


@pytest.mark.parametrize("name", [name for name in EXAMPLES if name in COMMANDS])
def test_examples_parse(name):
    for line in EXAMPLES[name]:
        words = shlex.split(line.partition(" | ")[0].partition(" > ")[0])
        assert words[:2] == ["leglab", name]
        COMMANDS[name].make_context(name, words[2:])


@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in INTERACTIVE])
def test_every_command_has_json(name):
    assert any("--json" in p.opts for p in COMMANDS[name].params), f"leglab {name} lacks --json"


@pytest.mark.parametrize("name", CHEAP)
def test_json_stands_alone_on_standard_output(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    data.write(example().with_columns({"x": example().time * float("nan")}), "run.csv")
    status, printed, _ = call(name, *CHEAP[name], "--json", capsys=capsys)
    assert status == 0
    assert parse(printed)


def test_json_of_tune(capsys):
    status, printed, _ = call("tune", "--model", "knee_bench", "--json", capsys=capsys)
    assert status == 0
    assert parse(printed)


@pytest.mark.parametrize("place", [0, 1, 3])
@pytest.mark.parametrize("flag", ["-v", "--verbose"])
def test_verbose_anywhere(place, flag, capsys):
    arguments = ["run", "nope", "--seed=1"]
    arguments.insert(place, flag)
    status, _, errors = call(*arguments, capsys=capsys)
    assert status == 2
    assert "Traceback" in errors
    assert errors.splitlines()[-1].startswith("error: unknown scenario 'nope'")


def test_status_1_where_a_check_fails(monkeypatch, capsys):
    found = {"passed": False, "checks": [], "replays": [], "left_out": None}
    monkeypatch.setattr("benchmarks.verification.checks_as_json", lambda: found)
    status, printed, _ = call("verify", "--json", capsys=capsys)
    assert status == 1
    assert parse(printed) == found


def test_status_2_where_the_source_tree_is_missing(monkeypatch, capsys):
    for words, module in (
        ("verify", "benchmarks.verification"),
        ("benchmark adaptation", "benchmarks.adaptation_faults"),
        ("replicate", "replication"),
    ):
        monkeypatch.setitem(sys.modules, module, None)
        status, _, errors = call(*words.split(), capsys=capsys)
        assert (status, errors.count("\n")) == (2, 1)
        assert f"the package {module.partition('.')[0]} is missing: it comes with" in errors


def test_status_130_when_interrupted(monkeypatch, capsys):
    def interrupt(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("leglab.machine.parameters.plugin_tables", interrupt)
    status, _, errors = call("parameters", capsys=capsys)
    assert status == 130
    assert errors == "interrupted\n"


def test_status_is_in_the_help(capsys):
    status, printed, _ = call("--help", capsys=capsys)
    assert status == 0
    text = " ".join(printed.split())
    assert "Exit status: 0 done, 1 a check or every run failed, 2 bad input" in text
    assert "130 interrupted" in text


def test_names_are_those_of_the_registries():
    import leglab.controllers
    import leglab.scenarios  # noqa: F401
    from leglab.base.scenario import scenario_names
    from leglab.control import controller_names
    from leglab.diagnosis.effects import all_effects
    from leglab.machine.library import model_names
    from leglab.references import reference_names

    assert options.names_of("scenarios") == scenario_names()
    assert options.names_of("controllers") == controller_names()
    assert options.names_of("references") == reference_names()
    assert options.names_of("models") == model_names()
    assert options.names_of("effects") == tuple(
        sorted({effect.name for effect in all_effects() if effect.nameable})
    )
    assert options.names_of("formats") == data.FORMATS
    for suffix in options.RECORDINGS:
        assert data.format_of(f"x{suffix}") in data.FORMATS


def process(*arguments, env=None, code=None, cwd=None):
    command = ["-c", code] if code else ["-m", "leglab", *arguments]
    found = subprocess.run(
        [sys.executable, *command],
        capture_output=True,
        text=True,
        env={**os.environ, **(env or {})},
        cwd=cwd,
        timeout=120,
    )
    assert found.returncode == 0, found.stderr
    return found.stdout


def complete(line, cwd=None):
    """What bash would offer after `line`."""
    words = line.split(" ")
    env = {
        "_LEGLAB_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
    }
    return process(env=env, cwd=cwd).split()


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("leglab conv", ["convert"]),
        ("leglab run hot", ["hot_oil"]),
        ("leglab run nominal --controller bsnn_arx_p", ["bsnn_arx_paper", "bsnn_arx_pressure"]),
        ("leglab run nominal --reference s", ["sine_sweep", "squat", "step"]),
        ("leglab diagnose knee", ["knee_bench"]),
        ("leglab diagnose knee_bench --effect valve_g", ["valve_gain", "valve_gain_asymmetry"]),
        ("leglab compare nominal --controllers pd,p", ["pd,pid"]),
        ("leglab convert a b --to m", ["mcap", "matlab"]),
    ],
)
def test_completion_of_names(line, offered):
    assert complete(line) == offered


def test_completion_of_files(tmp_path):
    for name in ("a.csv", "a.txt", "axis.xml", ".hidden.csv"):
        (tmp_path / name).touch()
    (tmp_path / "afar").mkdir()
    (tmp_path / "afar" / "b.mcap").touch()
    recordings = options.path_completion(".csv", ".mcap")
    here = str(tmp_path)
    assert recordings(f"{here}/a") == [f"{here}/a.csv", f"{here}/afar/"]
    assert recordings(f"{here}/") == [f"{here}/a.csv", f"{here}/afar/"]
    assert recordings(f"{here}/afar/") == [f"{here}/afar/b.mcap"]
    assert recordings(f"{here}/none/") == []
    assert complete("leglab diagnose ax", cwd=tmp_path) == ["axis.xml"]


@pytest.mark.parametrize(
    "code",
    [
        "main(['--help'])",
        "import os; os.environ |= {'_LEGLAB_COMPLETE': 'complete_bash', 'COMP_CWORD': '5',"
        " 'COMP_WORDS': 'leglab diagnose knee_bench x --effect v'}; main([])",
    ],
    ids=["help", "completion"],
)
def test_start_up_imports_nothing_heavy(code):
    text = (
        "import sys\nfrom leglab.cli import main\n"
        f"try:\n    {code}\nexcept SystemExit:\n    pass\n"
        f"print('LOADED', [m for m in {HEAVY} if m in sys.modules])"
    )
    assert process(code=text).splitlines()[-1] == "LOADED []"


def test_explaining_twice_changes_nothing():
    before = [c.help for c in app.registered_commands]
    explain(app)
    assert [c.help for c in app.registered_commands] == before


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_the_completion_script_is_shell(tmp_path):
    env = {"_LEGLAB_COMPLETE": "source_bash"}
    script = tmp_path / "leglab.sh"
    script.write_text(process(env=env))
    subprocess.run(["bash", "-n", str(script)], check=True)
    assert "_LEGLAB_COMPLETE=complete_bash" in script.read_text()


def test_the_page_of_the_command_line_is_up_to_date():
    script = Path(__file__).parents[2] / "docs" / "_tools" / "make_command_line.py"
    made = runpy.run_path(str(script))["page"]()
    page = script.parents[1] / "reference" / "command_line.md"
    assert page.read_text(encoding="utf-8") == made, "run python docs/_tools/make_command_line.py"


def test_main_without_arguments_shows_help(capsys):
    with pytest.raises(SystemExit) as exit_:
        main([])
    assert exit_.value.code == 2
    assert "Usage: leglab" in capsys.readouterr().out


def test_healthy_takes_all_files_of_a_pattern():
    """Click gives an option one word; the rest would pass for recordings of the fault."""
    files = ["c.csv", "d.csv", "e.csv"]
    before, after = ["diagnose", "bench", "a.csv", "b.csv"], ["--out", "here", "--seed", "3"]
    repeated = [word for file in files for word in ("--healthy", file)]
    assert spread([*before, "--healthy", *files, *after]) == [*before, *repeated, *after]
    assert spread([*before, *repeated]) == [*before, *repeated]
    assert spread(["run", "nominal", "--out", "x"]) == ["run", "nominal", "--out", "x"]
