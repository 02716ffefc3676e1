"""Results follow the user's own model: what is kept counts only with it, and a run's folder has it.

Through the command line: edit, run, compare, report, film, move the folder, edit again, delete.
"""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from leglab.base.errors import LeglabError
from leglab.diagnosis.plant.model import Machine
from leglab.machine.files import model_digest, model_files
from leglab.machine.plugin import without_warnings
from leglab.machine.simulation import load_model
from leglab.runs.preparation import RunSettings, prepared
from tests.cli.test_cli import leglab

ARM = """
<mujoco model="arm">
  <compiler meshdir="meshes" texturedir="textures"/>
  <asset>
    <mesh name="tip" file="tip.obj"/>
    <hfield name="floor" file="floor.png" size="2 2 .1 .1"/>
    <texture name="sky" type="cube" fileright="r.png" fileleft="r.png" fileup="r.png"
      filedown="r.png" filefront="r.png" fileback="r.png"/>
    <model name="hook" file="hook.xml"/>
  </asset>
  <worldbody>
    <geom type="hfield" hfield="floor" pos="0 0 -3"/>
    <body name="link">
      <joint name="elbow" axis="0 1 0" range="-90 90" damping="2"/>
      <include file="parts/load.xml"/>
      <geom type="mesh" mesh="tip" pos="0 0 -.3" density="500"/>
    </body>
    <attach model="hook" body="hook" prefix="its_"/>
  </worldbody>
  <actuator><motor name="drive" joint="elbow" gear="60" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
HOOK = """
<mujoco model="hook">
  <asset><mesh name="hook" file="meshes/hook.obj"/></asset>
  <worldbody><body name="hook" pos="0 1 0"><geom type="mesh" mesh="hook"/></body></worldbody>
</mujoco>
"""
LOAD = '<mujoco><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.3" mass="{}"/></mujoco>'
SOLID = "v 0 0 0\nv {0} 0 0\nv 0 {0} 0\nv 0 0 {0}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
SHORT = ("--duration", "1")


def write_arm(folder: Path) -> Path:
    for name in ("meshes", "textures", "parts"):
        (folder / name).mkdir(parents=True)
    (folder / "arm.xml").write_text(ARM)
    (folder / "hook.xml").write_text(HOOK)
    (folder / "parts" / "load.xml").write_text(LOAD.format(6))
    (folder / "meshes" / "tip.obj").write_text(SOLID.format(0.2))
    (folder / "meshes" / "hook.obj").write_text(SOLID.format(0.2))
    Image.new("L", (8, 8), 128).save(folder / "meshes" / "floor.png")
    Image.new("RGB", (8, 8)).save(folder / "textures" / "r.png")
    return folder / "arm.xml"


@pytest.fixture
def arm(tmp_path, monkeypatch):
    """The model's file; its folder is where commands work."""
    monkeypatch.chdir(tmp_path)
    return write_arm(tmp_path / "robot")


def lift(arm: Path, mass: int) -> None:
    (arm.parent / "parts" / "load.xml").write_text(LOAD.format(mass))


def error_of(folder: Path) -> float:
    return json.loads((folder / "metrics.json").read_text())["phases"][0]["rms_rad"]["all"]


def differ(one: float, other: float) -> bool:
    return abs(one - other) > 0.05 * other


def compiled(file: Path) -> dict[str, np.ndarray]:
    model = mujoco.MjSpec.from_file(str(file)).compile()
    arrays = {
        name: getattr(model, name)
        for name in dir(model)
        if not name.endswith("adr") and name != "_sizes"
    }
    return {name: x for name, x in arrays.items() if isinstance(x, np.ndarray)}


def test_compare_and_report_make_runs_of_an_edited_model_anew(arm, capsys):
    def compared(out):
        words = ("compare", "nominal", "--controllers", "pd", "--seeds", "1", *SHORT)
        command = (*words, "--no-figures", "--model", "robot/arm.xml", "--out", out)
        status, told, _ = leglab(*command, "--jobs", "1", capsys=capsys)
        assert status == 0
        cell = json.loads(Path(out, "compare.json").read_text())["results"]["nominal"]["pd"]
        return cell["after_rad"]["mean"], "1 of 1 runs were there" in told, command

    def reported():
        words = ("report", "--scenario", "nominal", "--controllers", "pd", "--no-video", *SHORT)
        assert leglab(*words, "--model", arm, "--jobs", "1", capsys=capsys)[0] == 0
        return error_of(Path("out/report/runs/pd"))

    light, there, command = compared("kept")
    assert not there
    assert reported() == light
    # In processes that have loaded no plug-ins of other tests it is one model as well.
    words = [sys.executable, "-m", "leglab", *command[:-1], "apart"]
    told = [subprocess.run(words, capture_output=True).stdout for _ in range(2)]
    assert [b"1 of 1 runs were there" in one for one in told] == [False, True]
    lift(arm, 9)
    heavy, there, _ = compared("kept")
    assert not there
    assert differ(heavy, light)
    assert compared("fresh")[:2] == (heavy, False)
    assert compared("kept")[:2] == (heavy, True)
    assert reported() == heavy


def test_a_run_is_played_where_it_is_moved_on_the_model_that_ran(
    arm, tmp_path, capsys, monkeypatch
):
    words = ("run", "nominal", *SHORT, "--no-figures", "--model")
    assert leglab(*words, "robot/arm.xml", "--out", "light", capsys=capsys)[0] == 0
    light = error_of(Path("light"))
    lift(arm, 9)
    assert leglab(*words, "robot/arm.xml", "--out", "heavy", capsys=capsys)[0] == 0
    assert differ(error_of(Path("heavy")), light)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    shutil.move("light", elsewhere / "moved")
    monkeypatch.chdir(elsewhere)

    def again(*more):
        run = ("run", "moved/run.json", "--no-figures", "--overwrite", "--out", "again")
        status, _, warned = leglab(*run, *more, capsys=capsys)
        assert status == 0
        return error_of(Path("again")), warned

    said = "since this run; the run's own model is used"
    found, warned = again()
    assert found == light
    assert warned == f"warning: arm.xml has changed {said}\n"
    lift(arm, 6)
    assert again() == (light, "")
    lift(arm, 9)
    assert differ(again("--model", arm)[0], light)
    shutil.rmtree(arm.parent)
    found, warned = again()
    assert (found, warned) == (light, f"warning: arm.xml was removed {said}\n")
    # That run has its own copy of the copy.
    assert leglab("convert", "again", "again.mcap", capsys=capsys)[0] == 0
    status, _, warned = leglab("report", "moved", "--duration", "0.1", capsys=capsys)
    assert status == 0
    assert "arm.xml was removed" in warned
    assert Path("moved/report.mp4").stat().st_size or "no film" in warned


EDITS = {
    "include": ("parts/load.xml", lambda text: text.replace(b'"6"', b'"9"')),
    "mesh": ("meshes/tip.obj", lambda text: text.replace(b"0.2", b"0.3")),
    "attached": ("meshes/hook.obj", lambda text: text.replace(b"0.2", b"0.3")),
    "height field": ("meshes/floor.png", None),
    "side of a cube": ("textures/r.png", None),
}


@pytest.mark.parametrize("edit", EDITS)
def test_every_file_of_a_model_counts_within_one_process_too(arm, edit):
    settings = RunSettings(scenario="nominal", model="robot/arm.xml")
    before, digest, machine = prepared(settings), model_digest(arm), Machine(arm)
    assert model_digest(arm) == digest == before.files.digest
    name, change = EDITS[edit]
    file = arm.parent / name
    if change:
        file.write_bytes(change(file.read_bytes()))
    else:
        image = Image.open(file)
        Image.new(image.mode, image.size, 200 if image.mode == "L" else (9, 9, 9)).save(file)
    assert model_digest(arm) != digest
    assert prepared(settings) is not before
    with pytest.raises(LeglabError, match=r"arm.xml: the model's files were changed meanwhile"):
        prepared(settings, digest)
    for again in (machine.spec, lambda: machine.at_timestep(5e-4)):
        with pytest.raises(LeglabError, match=r"arm.xml: the model's files were changed meanwhile"):
            again()


@pytest.mark.parametrize("named", ["as written", "folder from the root", "file from the root"])
def test_a_copy_loads_from_anywhere_and_is_the_same_to_the_bit(arm, tmp_path, named):
    text = arm.read_text()
    if named == "folder from the root":
        text = text.replace('"meshes"', f'"{arm.parent}/meshes"')
    if named == "file from the root":
        (tmp_path / "far").mkdir()
        shutil.move(arm.parent / "meshes" / "tip.obj", tmp_path / "far" / "tip.obj")
        text = text.replace('"tip.obj"', f'"{tmp_path}/far/tip.obj"')
        text = text.replace('"parts/', f'"{arm.parent}/parts/')
    arm.write_text(text)
    wanted = compiled(arm)
    place = model_files(arm).write(tmp_path / "kept")
    shutil.rmtree(arm.parent)
    shutil.rmtree(tmp_path / "far", ignore_errors=True)
    shutil.move(tmp_path / "kept", tmp_path / "moved")
    found = compiled(tmp_path / "moved" / place)
    assert wanted.keys() == found.keys()
    for name, values in wanted.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)


def test_a_sweep_does_not_mix_models(arm, capsys):
    plan = '[settings]\nscenario = "nominal"\nmodel = "robot/arm.xml"\nduration = 1.0\n'
    Path("sweep.toml").write_text(plan + "[[block]]\ngrid.seed = [0, 1]\n")
    command = ("sweep", "sweep.toml", "--out", "swept", "--workers", "1")
    status, _, warned = leglab(*command, capsys=capsys)
    assert status == 0, warned
    lift(arm, 9)
    status, _, warned = leglab(*command, capsys=capsys)
    assert status == 2
    assert "was begun with other files of its models" in warned
    status, _, warned = leglab("report", "swept", "--films", "1", capsys=capsys)
    assert re.search(r"no films: arm.xml has changed since this sweep", warned)


def test_the_digest_of_code_has_what_a_loaded_file_imports(tmp_path):
    (tmp_path / "mine.py").write_text("import helper\n")
    (tmp_path / "helper.py").write_text("gain = 1\n")
    code = "import sys\nfrom leglab.base import plugins\nplugins.load(sys.argv[1])\n"
    code += "print(plugins.code_digest())"

    def digest():
        words = [sys.executable, "-c", code, str(tmp_path / "mine.py")]
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout

    before = digest()
    assert digest() == before
    (tmp_path / "helper.py").write_text("gain = 2\n")
    assert digest() != before


def test_mujoco_leaves_no_log_where_the_user_works(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    model = load_model("knee_bench")
    with without_warnings():
        pass
    for _ in range(2):
        data = mujoco.MjData(model)
        data.qpos[:] = np.nan
        mujoco.mj_step(model, data)
    assert not list(tmp_path.iterdir())
    texts = [record.getMessage() for record in caplog.records if "QPOS" in record.getMessage()]
    assert texts == ["Nan, Inf or huge value in QPOS at DOF 0. The simulation is unstable."]
