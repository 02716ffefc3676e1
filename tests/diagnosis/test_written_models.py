"""improved.xml loads whatever the effect, the size of the machine, and the place of its assets."""

import struct
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.verdict.output import write_model
from rigs.rough import SERVO_LINK

# Five thousand tonnes on a slide, and a pendulum of a milligram, each with drives of its size.
_SCALED = """<mujoco><option timestep="0.001"/><worldbody>
<body><joint name="ram" type="{kind}" axis="0 0 1" damping="{mass}" armature="{mass}"/>
<geom size=".1" pos=".1 0 0" mass="{mass}" contype="0" conaffinity="0"/></body>
</worldbody><actuator>
<position name="ram" joint="ram" kp="{force}" kv="{mass}" ctrllimited="true" ctrlrange="-1 1"/>
<motor name="push" joint="ram" ctrllimited="true" ctrlrange="-{force} {force}"/>
</actuator></mujoco>"""


@pytest.fixture(params=["knee_bench", "servo", "press", "mite"])
def machine(request, tmp_path):
    given = request.param
    scaled = {"press": ("slide", 5e6, 1e9), "mite": ("hinge", 1e-6, 1e-6)}
    if given == "servo":
        given = SERVO_LINK.model
    elif given in scaled:
        text = _SCALED.format(**dict(zip(("kind", "mass", "force"), scaled[given], strict=True)))
        given = tmp_path / f"{given}.xml"
        given.write_text(text)
    return Machine(given)


def problem_of(machine):
    return SimpleNamespace(machine=machine, library=Library(machine))


def written(problem, values, folder):
    folder.mkdir(exist_ok=True)
    return write_model(problem, Hypothesis(values), folder)[0]


def usual(site):
    return np.array([p.trials[0] if p.trials else p.nominal for p in site.parameters])


def test_every_effect_is_written_at_its_bounds(machine, tmp_path):
    problem = problem_of(machine)
    for key, site in problem.library.sites.items():
        lower, upper, nominal = np.array([(p.lower, p.upper, p.nominal) for p in site.parameters]).T
        # Next to what changes nothing as well: a droop of nothing is an infinite gain.
        for values in (lower, upper, nominal + 1e-9 * (upper - nominal)):
            try:
                written(problem, {key: values}, tmp_path)
            except ValueError as error:
                pytest.fail(f"{key} at {values}: {error}")


def test_a_leakage_of_1e_13_is_written(tmp_path):
    values = {("internal_leakage", "knee_valve"): np.array([3.14159265e-14])}
    path = written(problem_of(Machine("knee_bench")), values, tmp_path)
    # Six digits, rounded towards the model's 1.7e-13: no bound is passed.
    assert 'value="3.1416e-14"' in path.read_text()
    found = Machine(path).parameter("knee_valve", "internal_leakage")
    assert found == pytest.approx(3.1416e-14, rel=1e-9, abs=0.0)


def test_an_improved_model_is_improved_again_and_again(machine, tmp_path):
    for turn in range(3):
        problem = problem_of(machine)
        sites = problem.library.sites
        values = {key: usual(site) for key, site in sites.items() if site.effect.nameable}
        path = written(problem, values, tmp_path / f"again{turn}")
        mujoco.MjModel.from_xml_path(str(path))
        machine = Machine(path)


def test_assets_are_found_from_any_folder(tmp_path, monkeypatch):
    robot, assets = tmp_path / "robot", tmp_path / "assets"
    (robot / "more").mkdir(parents=True)
    assets.mkdir()
    ground = np.zeros((4, 4), np.float32)
    ground[1, 1] = 1.0
    (assets / "ground.bin").write_bytes(struct.pack("<2i", 4, 4) + ground.tobytes())
    (assets / "tetra.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    )
    (robot / "more" / "mesh.xml").write_text(
        '<mujoco><asset><mesh name="tetra" file="tetra.obj"/></asset></mujoco>'
    )
    (robot / "model.xml").write_text("""<mujoco><compiler assetdir="../assets"/>
      <asset><hfield name="ground" file="ground.bin" size="1 1 1 1"/></asset>
      <include file="more/mesh.xml"/>
      <worldbody><geom type="hfield" hfield="ground" contype="0" conaffinity="0"/>
      <body><joint name="j"/><geom type="mesh" mesh="tetra" mass="1"/></body></worldbody>
      <keyframe><key name="home" qpos="0.3" ctrl="0.2" act="0.1"/></keyframe>
      <actuator><general name="a" joint="j" dyntype="filter" dynprm="0.1"/></actuator></mujoco>""")
    monkeypatch.chdir(robot)
    values = {("command_delay", "a"): np.array([0.02])}
    path = written(problem_of(Machine("model.xml")), values, tmp_path / "elsewhere")
    monkeypatch.chdir("/")
    model = mujoco.MjModel.from_xml_path(str(path))
    assert (model.nhfield, model.nmesh, model.nplugin) == (1, 1, 1)
    key = model.key("home")
    assert (key.qpos[0], key.ctrl[0], key.act[0]) == (0.3, 0.2, 0.1)
    # The command path that is there takes the second delay as well.
    path = written(problem_of(Machine(path)), values, tmp_path / "again")
    (plugin,) = mujoco.MjSpec.from_file(str(path)).plugins
    assert float(plugin.config["delay"]) == pytest.approx(0.04)
