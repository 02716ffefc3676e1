"""Limits and gains of drives that are hidden in a simulated machine are named, with their size."""

import importlib.util
import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from leglab.cli.app import app
from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.plant.model import Machine

SERVO = '<position name="knee" joint="knee" kp="60" kv="3"/>'
MOTOR = '<motor name="knee" joint="knee" ctrlrange="-20 20"/>'
FEW = ("actuator_gain", "coulomb_friction")


def model_of(actuator, joint=""):
    """MJCF of a hinge with a weight."""
    return f"""<mujoco model="leg"><option timestep="0.001" integrator="implicitfast"/>
<worldbody><body name="shank">
<joint name="knee" axis="0 1 0" damping="0.5" frictionloss="0.1" armature="0.05" {joint}/>
<inertial mass="2" pos="0 0 -0.2" diaginertia="0.02 0.02 0.002"/></body></worldbody>
<actuator>{actuator}</actuator></mujoco>"""


def simulated(xml, seed, size, reaches):
    """Time, command as sent and position, by plain MuJoCo in steps of 0.5 ms, at 200 Hz."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.timestep = 5e-4
    data, time = mujoco.MjData(model), np.arange(800) / 200.0
    phases = np.random.default_rng(seed).uniform(0, 6, 3)
    waves = [np.sin(2 * np.pi * f * time + p) for f, p in zip((0.4, 0.9, 1.7), phases, strict=True)]
    command = size * (np.sum(waves, axis=0) - np.sum(np.sin(phases)) * np.exp(-time))
    position = np.empty(time.size)
    for k, sent in enumerate(reaches(command)):
        position[k] = data.qpos[0]
        data.ctrl[0] = sent
        mujoco.mj_step(model, data, 10)
    return time, command, position + np.random.default_rng(99 + seed).normal(0.0, 1e-4, time.size)


def diagnosed(folder, files, *effects):
    """What `leglab diagnose model.xml` says, from diagnosis.json."""
    tried = [word for effect in effects for word in ("--effect", effect)]
    words = ["diagnose", str(folder / "model.xml"), *map(str, files), *tried]
    run = CliRunner().invoke(app, [*words, "--out", str(folder / "out")])
    assert run.exit_code == 0, run.output
    return json.loads((folder / "out/diagnosis.json").read_text())


def sides(command):
    """What a valve with dead bands of 2 and 5 passes."""
    return np.maximum(command - 2.0, 0.0) - np.maximum(-command - 5.0, 0.0)


HIDDEN = {
    "command_saturation": (SERVO, 0.5, SERVO, lambda u: np.clip(u, -0.4, 0.4), {"limit": 0.4}),
    "force_saturation": (
        SERVO,
        0.5,
        SERVO.replace("/>", ' forcerange="-3.5 3.5"/>'),
        lambda u: u,
        {"limit": 3.5},
    ),
    "servo_stiffness": (SERVO, 0.4, SERVO.replace("60", "40"), lambda u: u, {"stiffness": 2 / 3}),
    "command_deadband_asymmetry": (
        MOTOR,
        5.0,
        MOTOR,
        sides,
        {"dead_band_positive": 2.0, "dead_band_negative": 5.0},
    ),
    "command_gain_asymmetry": (
        MOTOR,
        5.0,
        MOTOR,
        lambda u: np.where(u > 0.0, 0.7, 1.0) * u,
        {"gain_positive": 0.7, "gain_negative": 1.0},
    ),
}


@pytest.mark.slow("a whole diagnosis of each effect")
@pytest.mark.parametrize("name", HIDDEN)
def test_what_is_hidden_in_a_drive_is_named_first(name, tmp_path):
    actuator, size, other, reaches, sizes = HIDDEN[name]
    (tmp_path / "model.xml").write_text(model_of(actuator))
    files = [tmp_path / f"log_{seed}.csv" for seed in range(3)]
    for seed, file in enumerate(files):
        rows = np.stack(simulated(model_of(other), seed, size, reaches), axis=1)
        head = "time,knee_command,knee_position"
        np.savetxt(file, rows, delimiter=",", header=head, comments="", fmt="%.9g")
    found = diagnosed(tmp_path, files, name, *FEW)
    first = found["effects"][0]
    assert (found["verdict"], first["name"]) == ("named", name), found["effects"]
    values = {p["name"]: p["value"] for p in first["parameters"]}
    for parameter, value in sizes.items():
        assert values[parameter] == pytest.approx(value, rel=0.1), values
