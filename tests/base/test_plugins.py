"""Code of others: a package with entry points, and `--load`, in all that uses names.

The package is made of the how-to pages' own files, with metadata as an installer writes it.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from leglab.base import plugins
from leglab.base.errors import LeglabError
from tests.helpers.pages import ROOT, blocks

NOD = '''
"""A reference that nods."""

import numpy as np

from leglab import Configuration, register_reference
from leglab.references import Samples


class NodConfiguration(Configuration):
    """Settings of `nod`.

    Attributes:
        height: Of the nod [rad].
    """

    height: float = 0.05


@register_reference("nod", summary="a nod of every joint", configuration=NodConfiguration)
def nod(joints, config):
    rest, half = np.array([joint.rest for joint in joints]), 0.5 * config.height

    def motion(times):
        angle, ones = 2 * np.pi * np.asarray(times)[:, None], np.ones_like(rest)
        return Samples(
            rest + half * (1 - np.cos(angle)) * ones,
            half * 2 * np.pi * np.sin(angle) * ones,
            half * (2 * np.pi) ** 2 * np.cos(angle) * ones,
        )

    return motion, 1.0
'''
ENTRY_POINTS = """
[leglab.controllers]
overlap = leglab_extras.overlap

[leglab.scenarios]
load_and_leak = leglab_extras.load_and_leak:load_and_leak

[leglab.references]
nod = leglab_extras.nod

[leglab.effects]
counterbalance = leglab_extras.my_effects:Counterbalance

[leglab.models]
boom = leglab_extras:BOOM
"""
INIT = """
from pathlib import Path

BOOM = Path(__file__).with_name("boom.xml")
"""


def page_files(page):
    """Files that a how-to page has its reader save, by name."""
    found = blocks((ROOT / f"docs/guides/{page}.md").read_text())
    # Without the line that names the file.
    return {block.file: block.text.partition("\n")[2] for block in found if block.file}


def install(site, name, entry_points, files):
    """Puts a package on a path, with its metadata, as `pip install --target` does."""
    package = site / name
    package.mkdir(parents=True)
    for file, text in files.items():
        (package / file).write_text(text)
    info = site / f"{name}-1.0.dist-info"
    info.mkdir()
    title = name.replace("_", "-")
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {title}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(entry_points)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder with the package, for PYTHONPATH."""
    files = {"__init__.py": INIT, "nod.py": NOD}
    for page in ("controller", "scenario", "effect", "model"):
        files |= page_files(page)
    folder = tmp_path_factory.mktemp("site")
    install(folder, "leglab_extras", ENTRY_POINTS, files)
    return folder


def call(*arguments, path=None, cwd=None, code=None, status=0):
    """Standard output and error of a command line in a process of its own."""
    command = ["-c", code] if code else ["-m", "leglab", *map(str, arguments)]
    env = {**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "300"}
    env.pop("PYTHONPATH", None)
    if path:
        env["PYTHONPATH"] = str(path)
    done = subprocess.run(
        [sys.executable, *command], env=env, cwd=cwd, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout, done.stderr


def test_entry_points_are_listed_completed_and_described(site):
    found = json.loads(call("list", "--json", path=site)[0])
    assert "overlap" in found["controllers"]
    assert found["scenarios"]["load_and_leak"].startswith("a heavy foot")
    assert found["references"]["nod"] == "a nod of every joint"
    assert found["models"]["boom"] == "A boom of 4 kg that one cylinder lifts"
    words = call("run", "--help", path=site)[0]
    assert all(name in words for name in ("overlap", "load_and_leak", "nod", "boom"))
    assert "overlap" not in json.loads(call("list", "--json")[0])["controllers"]


COMMON = ("--duration", 1, "--overwrite", "--json")


def test_a_package_is_swept(site, tmp_path):
    sweep = tmp_path / "sweep.toml"
    sweep.write_text(
        '[settings]\nscenario = "load_and_leak"\nduration = 1.0\n'
        '[[block]]\ngrid.controller = ["pd", "overlap"]\n'
    )
    words = ("sweep", sweep, "--out", tmp_path / "sweep", "--workers", 1, "--json")
    swept = json.loads(call(*words, path=site)[0])
    assert (swept["done"], swept["failed"]) == (2, 0)


@pytest.mark.slow("processes that start processes")
def test_a_package_runs_compares_and_reports(site, tmp_path):
    run = ("run", "nominal", "--model", "boom", "--reference", "nod", "--controller", "overlap")
    out = ("--out", tmp_path / "run", "--no-figures")
    metrics = json.loads(call(*run, *COMMON, *out, path=site)[0])
    assert metrics["completed"]
    assert metrics["phases"][0]["rms_rad"].keys() == {"lift", "all"}
    compared = ("compare", "load_and_leak", "--controllers", "pd,overlap")
    out = ("--seeds", 1, "--jobs", 1, "--out", tmp_path / "compare", "--no-figures")
    found = json.loads(call(*compared, *COMMON, *out, path=site)[0])
    cells = found["results"]["load_and_leak"]
    assert [cells[name]["failures"] for name in ("pd", "overlap")] == [[], []]
    assert cells["overlap"]["after_rad"]["mean"] < cells["pd"]["after_rad"]["mean"]
    reported = ("report", "--scenario", "load_and_leak", "--controllers", "pd,overlap")
    out = ("--jobs", 1, "--no-video", "--out", tmp_path / "report")
    call(*reported, *COMMON, *out, path=site)
    page = (tmp_path / "report/report.html").read_text()
    assert "PD with the valve&#39;s overlap compensated" in page


@pytest.mark.slow("processes that start processes")
def test_a_package_takes_part_in_a_diagnosis(site, tmp_path):
    page = (ROOT / "docs/guides/effect.md").read_text()
    (tmp_path / "pendulum.xml").write_text(page_files("effect")["pendulum.xml"])
    (record,) = (b.text for b in blocks(page) if "def record" in b.text)
    save = "\nfrom leglab import write\nfor name, one in recordings.items():\n"
    call(code=f"{record}{save}    write(one, f'{{name}}.csv')", cwd=tmp_path)
    files = [f"{name}.csv" for name in ("slow", "middle", "fast")]
    effects = [word for e in ("counterbalance", "payload") for word in ("--effect", e)]
    found = json.loads(
        call("diagnose", "pendulum.xml", *files, *effects, "--json", path=site, cwd=tmp_path)[0]
    )
    assert [effect["name"] for effect in found["effects"]] == ["counterbalance"]


def test_a_package_makes_environments(site):
    pytest.importorskip("gymnasium")
    code = """
import gymnasium, leglab.environment
env = gymnasium.make("leglab/LoadAndLeak-v0", action="residual", controller="overlap",
                     duration=0.2)
_, told = env.reset(seed=1)
print(told["scenario"], env.step([0.0] * 6)[0]["controller_command"].shape)
"""
    assert call(code=code, path=site)[0].strip() == "load_and_leak (6,)"


def test_a_broken_package_breaks_nothing_else_and_is_told(site, tmp_path):
    entries = "[leglab.controllers]\nbroken = leglab_broken.one\nempty = leglab_broken.two\n"
    files = {"__init__.py": "", "one.py": "x = 1\nimport no_such_thing\n", "two.py": ""}
    install(tmp_path, "leglab_broken", entries, files)
    both = os.pathsep.join((str(site), str(tmp_path)))
    printed, errors = call("list", "--json", path=both)
    assert "overlap" in json.loads(printed)["controllers"]
    first, second = errors.strip().splitlines()
    assert first == (
        "warning: plug-in 'broken' of package 'leglab-broken' (leglab_broken.one) cannot be "
        "loaded: ModuleNotFoundError: No module named 'no_such_thing' (one.py, line 2)"
    )
    assert second.endswith("it registers nothing called 'empty' among the controllers")
    _, errors = call("run", "nominal", "--controller", "broken", path=both, status=2)
    (line,) = errors.strip().splitlines()
    assert line.startswith("error: unknown controller 'broken': choose one of")
    assert "plug-in 'broken' of package 'leglab-broken'" in line


@pytest.fixture
def overlap(tmp_path):
    """The controller of the how-to page, in a folder of its own."""
    folder = tmp_path / "mine"
    folder.mkdir()
    file = folder / "overlap.py"
    file.write_text(page_files("controller")["overlap.py"])
    return file


COMPARED = ("compare", "nominal", "--controllers", "pd,overlap", "--model", "knee_bench")
SHORT = ("--duration", 1, "--seeds", 1, "--jobs", 1, "--no-figures", "--json")
_elsewhere = pytest.mark.slow("processes that start processes")


@pytest.mark.parametrize(
    "how",
    ["file", pytest.param("module", marks=_elsewhere), pytest.param("script", marks=_elsewhere)],
)
def test_a_controller_of_ones_own_is_known_to_worker_processes(overlap, tmp_path, how):
    out = ("--out", tmp_path / "out")
    if how == "file":
        printed, _ = call(*COMPARED, *SHORT, *out, "--load", overlap, cwd=tmp_path)
    elif how == "module":
        printed, _ = call(*COMPARED, *SHORT, *out, "--load", "overlap", path=overlap.parent)
    else:
        words = [str(word) for word in (*COMPARED, *SHORT, *out)]
        done = subprocess.run(
            [sys.executable, overlap, *words], capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr
        printed = done.stdout
    cells = json.loads(printed)["results"]["nominal"]
    assert cells["overlap"]["runs"] == 1
    assert cells["overlap"]["failures"] == []
    assert 0 < cells["overlap"]["after_rad"]["mean"] < cells["pd"]["after_rad"]["mean"]


def test_a_run_is_repeated_when_the_loaded_code_has_changed(overlap, tmp_path):
    command = ("compare", "nominal", "--controllers", "overlap", "--model", "knee_bench")
    command += (*SHORT, "--out", tmp_path / "out", "--load", overlap)
    stored = tmp_path / "out/runs/nominal-overlap-knee_bench-0.json"

    def error():
        call(*command)
        return json.loads(stored.read_text())["metrics"]["phases"][0]["rms_rad"]["all"]

    first, written = error(), stored.stat().st_mtime_ns
    assert (error(), stored.stat().st_mtime_ns) == (first, written)
    overlap.write_text(overlap.read_text().replace("default=0.02", "default=0.04"))
    assert error() != first


@pytest.mark.parametrize(
    ("source", "text", "message"),
    [
        ("none.py", None, "--load none.py: there is no such file"),
        ("no_such_module", None, "--load no_such_module: there is no module of this name"),
        (
            "a.py",
            "x = 1\ny = x + z\n",
            "--load a.py: NameError: name 'z' is not defined (a.py, line 2)",
        ),
        ("b.py", "def f(:\n", "--load b.py: SyntaxError: "),
        ("c.py", "import no_such\n", "--load c.py: ModuleNotFoundError: No module named 'no_such'"),
        (
            "d.py",
            "from leglab import register_model\nregister_model('m', 'm.xml')\n",
            "--load d.py: model 'm': there is no file",
        ),
    ],
    ids=["file", "module", "name", "syntax", "import", "model"],
)
def test_what_cannot_be_loaded_is_one_line(tmp_path, source, text, message):
    if text is not None:
        (tmp_path / source).write_text(text)
    _, errors = call("list", "--load", source, cwd=tmp_path, status=2)
    (line,) = errors.strip().splitlines()
    assert line.startswith(f"error: {message}")


def test_files_of_one_name_do_not_take_each_others_place(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        text = f"import json\nprint_folder = {folder!r}\nassert json.dumps\n"
        (tmp_path / folder / "json.py").write_text(text)  # named like a module that is there
        plugins.load(str(tmp_path / folder / "json.py"))
    loaded = [m.print_folder for n, m in sys.modules.items() if n.startswith("leglab_loaded_")]
    assert sorted(loaded) == ["one", "two"]
    assert json.loads("1") == 1
    with pytest.raises(LeglabError, match="there is no such file"):
        plugins.load(str(Path("nowhere.py")))


def test_processes_pass_over_what_only_happened_to_register_something(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(plugins, "_sources", {})
    luggage = {"path": [str(tmp_path)], "packages": [], "sources": {"no_such_module": False}}
    plugins.carry(luggage)
    assert str(tmp_path) in sys.path
    with pytest.raises(LeglabError, match="there is no module of this name"):
        plugins.carry({**luggage, "sources": {"no_such_module": True}})
