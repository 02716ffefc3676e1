"""improved.xml differs from the user's file only where a parameter is named or has moved."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from leglab import Recording, data

PLAIN = """<mujoco model="arm">
  <!-- hangs down at 0 -->
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass="0" contype="0" conaffinity="0"/>
      <inertial pos="0 0 -.3"  mass='1' diaginertia=".01 .01 .01"/> <!-- weighed -->
      <joint name="hinge" axis="0 1 0"
             armature=".02" damping=".08"/>
    </body>
  </worldbody>
  <actuator> <motor name="drive" joint="hinge"/> </actuator>
</mujoco>
"""
# The joint is in a file that another one includes, and its damping in a class of defaults.
MAIN = """<mujoco>
  <!-- the whole -->
  <include file="parts/defaults.xml"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody> <include file="parts/arm.xml"/> </worldbody>
  <actuator> <motor name="drive" joint="hinge"/> </actuator>
</mujoco>
"""
DEFAULTS = """<mujocoinclude>
  <default> <default class="oiled"> <joint damping="0.08" armature="0.02"/> </default> </default>
</mujocoinclude>
"""
ARM = """<mujocoinclude>
  <body name="arm" childclass="oiled">
    <inertial pos="0 0 -.3" mass="1" diaginertia=".01 .01 .01"/>
    <include file="parts/joint.xml"/>
  </body>
</mujocoinclude>
"""
JOINT = '<mujocoinclude>\n    <joint name="hinge" axis="0 1 0"/> <!-- oiled -->\n</mujocoinclude>\n'
EFFECTS = ("coulomb_friction", "viscous_friction", "armature")


def recorded(kind: int, coulomb: float, damping: float) -> Recording:
    """An arm under PD control: Moreau's steps of 0.1 ms with dry friction, encoder to 20 urad."""
    rng, h = np.random.default_rng(kind), 1e-4
    inertia, gravity = 0.02 + 0.01 + 0.09, 9.81 * 0.3
    tones = [((0.31, 0.5), (1.9, 0.2)), ((1.1, 0.5), (2.3, 0.2)), ((0.25, 1.0),)][kind]
    q = v = 0.0
    positions, commands = [], []
    for t in 1e-3 * np.arange(4000):
        goal = sum(a * np.sin(2.0 * np.pi * f * t) for f, a in tones)
        command = 40.0 * (goal - q) - 4.0 * v
        positions.append(q)
        commands.append(command)
        for _ in range(10):
            v += h * (command - damping * v - gravity * np.sin(q)) / inertia
            v -= min(max(v, -h * coulomb / inertia), h * coulomb / inertia)
            q += h * v
    shown = np.array(positions) + rng.normal(0.0, 2e-5, 4000)
    columns = {"hinge_position": shown, "drive_command": np.array(commands)}
    return Recording(time=1e-3 * np.arange(4000), columns=columns)


def diagnosed(model: Path, folder: Path, *, coulomb: float = 0.0, damping: float = 0.08):
    """Folder of results, and diagnosis.json."""
    words = ["diagnose", str(model), "--out", str(folder / "out")]
    for kind in range(3):
        path = folder / f"log{kind}.parquet"
        data.write(recorded(kind, coulomb, damping), path)
        words.append(str(path))
    for effect in EFFECTS:
        words += ["--effect", effect]
    subprocess.run([sys.executable, "-m", "leglab", *words], check=True, capture_output=True)
    return folder / "out", json.loads((folder / "out" / "diagnosis.json").read_text())


def loaded_without_leglab(path: Path) -> list[float]:
    """Friction, damping and armature of the first joint, by MuJoCo alone, from elsewhere."""
    fields = ("dof_frictionloss", "dof_damping", "dof_armature")
    told = "import mujoco, sys; m = mujoco.MjModel.from_xml_path(sys.argv[1]); print(" + (
        ", ".join(f"m.{field}[0]" for field in fields) + ")"
    )
    call = [sys.executable, "-c", told, str(path.resolve())]
    done = subprocess.run(call, check=True, capture_output=True, text=True, cwd="/")
    return [float(word) for word in done.stdout.split()]


def test_of_a_friction_one_line_differs(tmp_path):
    model = tmp_path / "arm.xml"
    model.write_text(PLAIN)
    out, told = diagnosed(model, tmp_path, coulomb=0.5)
    assert [effect["name"] for effect in told["effects"]] == ["coulomb_friction"]
    # Tuning alone has no friction, and gains little.
    assert told["gap"]["recalibrated"] > 0.8 * told["gap"]["before"] > 10.0 * told["gap"]["after"]
    text = (out / "improved.xml").read_text()
    before, after = PLAIN.splitlines(), text.splitlines()
    differ = [(old, new) for old, new in zip(before, after, strict=True) if old != new]
    ((old, new),) = differ
    assert new.startswith(old.removesuffix("/>"))
    friction, *others = loaded_without_leglab(out / "improved.xml")
    assert friction == pytest.approx(0.5, rel=0.01)
    assert others == [0.08, 0.02]
    assert told["changed"][2:] == ["@@ -9 +9 @@", f"-{old}", f"+{new}"]
    assert "frictionloss=" in (out / "diagnosis.html").read_text()
    assert told["moved"] == []


@pytest.mark.slow("a second whole diagnosis by the command")
def test_includes_and_classes_stay_and_the_element_has_the_change(tmp_path):
    parts = tmp_path / "robot" / "parts"
    parts.mkdir(parents=True)
    model = parts.parent / "main.xml"
    model.write_text(MAIN)
    for name, text in (("defaults", DEFAULTS), ("arm", ARM), ("joint", JOINT)):
        (parts / f"{name}.xml").write_text(text)
    out, told = diagnosed(model, tmp_path, coulomb=0.5)
    removed, added = told["changed"][3:]
    assert removed.split() == ["-", *JOINT.splitlines()[1].split()]
    assert "frictionloss=" in added
    text = (out / "improved.xml").read_text()
    assert f'<include file="{parts.resolve()}/defaults.xml"/>' in text
    assert "<!-- the whole -->" in text
    assert 'class="oiled"> <joint damping' not in text
    friction, *others = loaded_without_leglab(out / "improved.xml")
    assert friction == pytest.approx(0.5, rel=0.01)
    assert others == [0.08, 0.02]


def test_what_moved_within_its_tolerance_is_told(tmp_path):
    model = tmp_path / "arm.xml"
    model.write_text(PLAIN)
    out, told = diagnosed(model, tmp_path, damping=0.088)
    assert told["verdict"] == "nothing_missing"
    (moved,) = told["moved"]
    assert (moved["effect"], moved["element"]) == ("viscous_friction", "hinge")
    assert (moved["parameter"], moved["from"]) == ("damping", 0.08)
    assert moved["to"] == pytest.approx(0.088, rel=0.02)
    assert moved["share"] == pytest.approx(1.0, abs=0.2)
    assert loaded_without_leglab(out / "improved.xml")[1] == pytest.approx(moved["to"], rel=1e-4)
    assert "Parameters that moved within their tolerance" in (out / "diagnosis.html").read_text()
