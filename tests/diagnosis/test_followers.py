"""Joints that equalities determine are computed; a free base is held on request."""

import json

import mujoco
import numpy as np
import pytest

from leglab.cli.app import app
from leglab.cli.conventions import execute
from leglab.diagnosis.plant.model import Machine

DRIVE = '<actuator><position name="knee" joint="knee" kp="60" kv="3"/></actuator>'
HEAD = '<mujoco><option timestep="0.002" integrator="implicitfast"/>'
SHANK = '<inertial mass="2" pos="0 0 -0.2" diaginertia="0.02 0.02 0.002"/>'
KNEE = '<joint name="knee" axis="0 1 0" damping="0.5" frictionloss="{friction}" armature="0.05"/>'
ROD = """<body name="rod" pos="0 0 -0.1"><joint name="follower" axis="0 1 0" armature="0.002"/>
  <inertial mass="0.2" pos="0 0 -0.05" diaginertia="2e-4 2e-4 2e-5"/></body>"""
GRIPPER = f"""{HEAD}<worldbody><body>{KNEE}{SHANK}{ROD}</body></worldbody>
  <equality><joint joint1="follower" joint2="knee" polycoef="0.1 -2 0.3 0 0"
  solref="0.004 1"/></equality>
  {DRIVE}</mujoco>"""
FOUR_BAR = f"""{HEAD}<worldbody>
  <body name="crank">{KNEE}<geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.01" mass="0.5"/>
    <body name="coupler" pos="0 0 0.1"><joint name="coupler" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.01" mass="0.3"/></body></body>
  <body name="rocker" pos="0.3 0 0"><joint name="rocker" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.12" size="0.01" mass="0.5"/></body></worldbody>
  <equality><connect body1="coupler" body2="rocker" anchor="0.3 0 0" solref="0.004 1"/></equality>
  <contact><exclude body1="coupler" body2="rocker"/><exclude body1="crank" body2="coupler"/>
  </contact>{DRIVE}</mujoco>"""
FLOATING = f"""{HEAD}<worldbody><body name="base"><freejoint name="root"/>
  <inertial mass="5" pos="0 0 0" diaginertia="0.1 0.1 0.1"/><body>{KNEE}{SHANK}</body></body>
  </worldbody>{DRIVE}<keyframe><key qpos="0 0 1 1 0 0 0 0.3"/></keyframe></mujoco>"""


def motion(xml, seed=0, seconds=2.0, rate=500):
    """Positions and velocities of all joints and the command, a row a sample."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.timestep = 5e-4
    data, rows = mujoco.MjData(model), []
    phases = np.random.default_rng(seed).uniform(0, 6, 4)
    for k in range(round(seconds * rate)):
        time = k / rate
        waves = np.sin(2 * np.pi * np.array([0.3, 0.7, 1.3, 2.1]) * time + phases)
        data.ctrl[0] = 0.15 * (waves - np.sin(phases) * np.exp(-time)).sum()
        rows.append([time, data.ctrl[0], *data.qpos, *data.qvel])
        mujoco.mj_step(model, data, round(2000 / rate))
    return np.array(rows)


def logs(folder, xml):
    """Three logs of the knee alone."""
    names = []
    for seed in range(3):
        rows = motion(xml, seed, seconds=6.0)
        noise = np.random.default_rng(99 + seed).normal(0, 2e-5, len(rows))
        names.append(str(folder / f"log_{seed}.csv"))
        text = [f"{t},{u},{q}" for t, u, q in zip(*rows[:, :2].T, rows[:, 2] + noise, strict=True)]
        (folder / names[-1]).write_text("\n".join(["time,knee_command,knee_position", *text]))
    return names


@pytest.mark.parametrize(
    ("xml", "names"), [(GRIPPER, ["follower"]), (FOUR_BAR, ["coupler", "rocker"])]
)
def test_followers_are_where_the_simulation_has_them(tmp_path, xml, names):
    (tmp_path / "model.xml").write_text(xml.format(friction=0.1))
    machine = Machine(tmp_path / "model.xml").measured_by({"knee_position"})
    assert list(machine.follower_names) == names
    assert machine.columns == ("knee_position", "knee_command")
    rows = motion(xml.format(friction=0.1))
    nv = len(machine.all_joints)
    positions, velocities = rows[:, 2 : 2 + nv], rows[:, 2 + nv :]
    blank = np.where(np.arange(nv) == 0, positions, 0.0)
    found = machine.followers.positions(blank)
    # A soft constraint gives way by some thousandths under load.
    np.testing.assert_allclose(found[50:], positions[50:], atol=2e-3 * np.ptp(positions))
    moving = machine.followers.velocities(found, np.where(np.arange(nv) == 0, velocities, 0.0))
    np.testing.assert_allclose(moving[50:], velocities[50:], atol=0.02 * np.ptp(velocities))


def test_a_joint_that_nothing_determines_is_asked_for(tmp_path):
    (tmp_path / "model.xml").write_text(FOUR_BAR.format(friction=0.1))
    machine = Machine(tmp_path / "model.xml")
    assert machine.measured_by({"rocker_position"}).follower_names == ("knee", "coupler")
    assert machine.measured_by(set()) is machine
    both = machine.measured_by({"knee_position", "coupler_position"})
    assert both.follower_names == ("rocker",)


def run(*arguments):
    try:
        execute(app, [str(a) for a in arguments])
    except SystemExit as end:
        return end.code
    return 0


@pytest.mark.slow("whole diagnoses")
@pytest.mark.parametrize(
    ("xml", "options"), [(GRIPPER, []), (FOUR_BAR, []), (FLOATING, ["--fix-base"])]
)
def test_friction_is_named_by_the_driven_joint_alone(tmp_path, xml, options):
    (tmp_path / "model.xml").write_text(xml.format(friction=0.1))
    simulated = xml.replace('<freejoint name="root"/>', "").replace("0 0 1 1 0 0 0 0.3", "0.3")
    names = logs(tmp_path, simulated.format(friction=0.6))
    effects = ("payload", "coulomb_friction", "armature", "actuator_gain", "viscous_friction")
    chosen = [part for effect in effects for part in ("--effect", effect)]
    out = tmp_path / "out"
    assert run("diagnose", tmp_path / "model.xml", *names, *chosen, *options, "--out", out) == 0
    (effect,) = json.loads((out / "diagnosis.json").read_text())["effects"]
    assert effect["name"] == "coulomb_friction"
    assert effect["parameters"]["coulomb"]["value"] == pytest.approx(0.6, abs=0.1)
    improved = mujoco.MjModel.from_xml_path(str(out / "improved.xml"))
    assert improved.njnt == mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml")).njnt


def test_a_free_base_is_refused_with_the_way_out(tmp_path, capsys):
    (tmp_path / "model.xml").write_text(FLOATING.format(friction=0.1))
    (tmp_path / "a.csv").write_text("time,knee_command,knee_position\n0,0,0\n1,0,0\n2,0,0\n")
    assert (
        run("diagnose", tmp_path / "model.xml", tmp_path / "a.csv", "--out", tmp_path / "out") == 2
    )
    assert "--fix-base" in capsys.readouterr().err


ODD = """<mujoco><worldbody><body name="thigh"><joint {joint} axis="0 1 0"/>
<geom size=".05" pos="0 0 -.2" mass="1"/></body></worldbody>
<actuator>{drive}</actuator></mujoco>"""


@pytest.mark.parametrize(
    ("file", "joint", "drive", "named"),
    [
        ("m.xml", "", "", "joint 0 (without a name, of body 'thigh') is measured by no column"),
        ("m.xml", 'type="ball"', "", "joint 0 (without a name, of body 'thigh') is a ball joint"),
        ("m.xml", 'name="hip"', '<motor joint="hip"/>', "no column 'hip_command'"),
        ("m.xml", 'name="hip"', 2 * '<motor joint="hip"/>', "actuator 1 has no name, and"),
        ("m.mjb", "", "", "allowed: the .xml that it was compiled from"),
        ("m.urdf.xacro", "", "", "xacro MODEL.xacro > MODEL.urdf"),
    ],
)
def test_odd_models_are_named_with_the_way_out(tmp_path, capsys, file, joint, drive, named):
    """An actuator without a name is called after its joint."""
    (tmp_path / file).write_text(ODD.format(joint=joint, drive=drive))
    (tmp_path / "a.csv").write_text("time,hip_position\n0,0\n1,0\n2,0\n")
    assert run("diagnose", tmp_path / file, tmp_path / "a.csv", "--out", tmp_path / "out") == 2
    assert named in " ".join(capsys.readouterr().err.split())
