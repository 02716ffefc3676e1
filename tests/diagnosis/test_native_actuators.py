"""Diagnosis of machines whose MuJoCo actuators have states, limits, or values by the compiler."""

import json

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from leglab.base.errors import ModelError
from leglab.base.recording import Recording
from leglab.base.scale import rms
from leglab.cli.app import app
from leglab.diagnosis.effects.base import all_effects
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.plant.activation import activations
from leglab.diagnosis.plant.model import Change, Machine
from leglab.diagnosis.replay.starts import measure
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up

NOISE = 2e-5  # rad


def servo(**attributes):
    """MJCF of a position servo with attributes of a general actuator."""
    more = " ".join(f'{name}="{value}"' for name, value in attributes.items())
    terms = 'gainprm="60" biastype="affine" biasprm="0 -60 -3"'
    return f'<general name="knee" joint="knee" {terms} {more}/>'


# Actuators with a state, and the size of their commands.
STATEFUL = {
    "filter": (servo(dyntype="filter", dynprm=0.03), 0.5),
    "exact": (servo(dyntype="filterexact", dynprm=0.01), 0.5),
    "limited": (servo(dyntype="filterexact", dynprm=0.01, actrange="-0.3 0.3"), 0.5),
    "integrator": ('<intvelocity name="knee" joint="knee" kp="60" kv="3" actrange="-2 2"/>', 1.0),
    "muscle": ('<muscle name="knee" joint="knee" force="15" lengthrange="-2 2"/>', 0.5),
}


def model_of(actuator, *, mass=2.0, armature=0.05, timestep=0.002):
    """MJCF of a hinge with a weight."""
    return f"""<mujoco model="leg"><compiler angle="radian"/>
<option timestep="{timestep}" integrator="implicitfast"/>
<worldbody><body name="shank"><joint name="knee" axis="0 1 0" damping="0.5" frictionloss="0.1"
armature="{armature}" stiffness="8"/>
<inertial mass="{mass}" pos="0 0 -0.2" diaginertia="0.02 0.02 0.002"/></body></worldbody>
<actuator>{actuator}</actuator></mujoco>"""


def simulated(xml, seed, size, *, seconds=4.0):
    """Time, command, position and activation, by plain MuJoCo in steps of 0.5 ms, at 500 Hz."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.timestep = 5e-4
    data, time = mujoco.MjData(model), np.arange(round(500 * seconds)) / 500.0
    phases = np.random.default_rng(seed).uniform(0, 6, 4)
    waves = [
        np.sin(2 * np.pi * f * time + p) for f, p in zip((0.3, 0.5, 1, 1.7), phases, strict=True)
    ]
    command = size * (np.sum(waves, axis=0) - np.sum(np.sin(phases)) * np.exp(-time))
    position, activation = np.empty(time.size), np.zeros(time.size)
    for k in range(time.size):
        position[k] = data.qpos[0]
        activation[k] = data.act[0] if model.na else 0.0
        data.ctrl[0] = command[k]
        mujoco.mj_step(model, data, 4)
    position += np.random.default_rng(99 + seed).normal(0.0, NOISE, time.size)
    return time, command, position, activation


def logs_of(folder, xml, size, **settings):
    """Files of three recordings."""
    files = []
    for seed in range(3):
        time, command, position, _ = simulated(xml, seed, size, **settings)
        files.append(str(folder / f"log_{seed}.csv"))
        head = "time,knee_command,knee_position"
        rows = np.stack([time, command, position], axis=1)
        np.savetxt(files[-1], rows, delimiter=",", header=head, comments="", fmt="%.9g")
    return files


def diagnosed(folder, files, *effects):
    """What `leglab diagnose model.xml` says, from diagnosis.json."""
    tried = [word for effect in effects for word in ("--effect", effect)]
    out = str(folder / "out")
    run = CliRunner().invoke(
        app, ["diagnose", str(folder / "model.xml"), *files, *tried, "--out", out]
    )
    assert run.exit_code == 0, run.output
    return json.loads((folder / "out/diagnosis.json").read_text())


@pytest.mark.parametrize("kind", STATEFUL)
def test_a_model_replays_its_own_actuators_with_a_state(kind, tmp_path):
    actuator, size = STATEFUL[kind]
    path = tmp_path / "model.xml"
    path.write_text(model_of(actuator, timestep=5e-4))
    time, command, position, activation = simulated(path.read_text(), 0, size)
    columns = {"knee_command": command, "knee_position": position}
    logs = {name: Recording(time=time, columns=columns) for name in ("log", "again")}
    problem = set_up(path, logs, ("again",), DiagnosisSettings(threads=1, effects=("payload",)))
    change = problem.library.change(Hypothesis(), problem.machine)
    measured, _ = measure(problem.replay.cuts[0], problem.channels, change)
    np.testing.assert_allclose(measured.activation["knee"], activation, atol=0.01)
    # The same servo without a state: 1.2 mrad, for replays take steps of 1 ms.
    assert rms(problem.replay.error(change).values) < 1e-3


@pytest.mark.parametrize("early", [0, 1])
def test_a_slow_filter_begins_settled_and_follows_the_simulation(early):
    """From the first sample on; with `actearly` the state of one step before gives the force."""
    lag = servo(dyntype="filter", dynprm=0.5, actearly=bool(early)).replace("True", "true")
    model = mujoco.MjModel.from_xml_string(model_of(lag.replace("False", "false")))
    data, command = mujoco.MjData(model), 0.4 + 0.3 * np.sin(0.05 * np.arange(100))
    data.act[0], states = command[0], []
    for sent in np.repeat(command, 4):
        states.append(float(data.act[0]))
        data.ctrl[0] = sent
        mujoco.mj_step(model, data)
    expected = np.array(states)[np.maximum(4 * np.arange(100) - early, 0)]
    found = activations(model, command[:, None], 4, model.opt.timestep)
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-12)


@pytest.mark.slow("a whole diagnosis of what a replay shows in half a second")
def test_a_payload_behind_a_filter_is_named(tmp_path):
    actuator, size = STATEFUL["exact"]
    (tmp_path / "model.xml").write_text(model_of(actuator))
    files = logs_of(tmp_path, model_of(actuator, mass=2.6), size)
    found = diagnosed(tmp_path, files, "payload")
    assert [effect["name"] for effect in found["effects"]] == ["payload"]


@pytest.mark.parametrize(
    ("head", "joint"),
    [("", ""), ('<compiler settotalmass="3"/>', ""), ("", ' springdamper="0.2 1"')],
)
def test_what_the_compiler_works_out_from_inertia_stays_as_it_was(head, joint, tmp_path):
    xml = model_of('<position name="knee" joint="knee" kp="60" dampratio="0.7"/>')
    xml = xml.replace("<worldbody>", f"{head}<worldbody>").replace(' axis="', f'{joint} axis="')
    (tmp_path / "model.xml").write_text(xml)
    machine = Machine(tmp_path / "model.xml")
    given = mujoco.MjModel.from_xml_string(xml)
    heavier = Change(machine)
    load = {"mass": 1.0, "distance": 0.2}
    next(e for e in all_effects() if e.name == "payload").apply(heavier, "shank", load)
    for model in (machine.base.model, heavier.variant.model):
        np.testing.assert_array_equal(model.actuator_biasprm, given.actuator_biasprm)
        np.testing.assert_allclose(model.body_mass[1], given.body_mass[1], rtol=1e-12)
        np.testing.assert_array_equal(model.jnt_stiffness, given.jnt_stiffness)
        np.testing.assert_array_equal(model.dof_damping, given.dof_damping)
    assert heavier.variant.model.body_mass.sum() == pytest.approx(given.body_mass.sum() + 1.0)


@pytest.mark.slow("a whole diagnosis of what compiled models show at once")
def test_a_damping_ratio_does_not_follow_the_inertia(tmp_path):
    servo = '<position name="knee" joint="knee" kp="60" {}/>'
    (tmp_path / "model.xml").write_text(model_of(servo.format('dampratio="0.7"')))
    compiled = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    kv = -compiled.actuator_biasprm[0, 2]
    files = logs_of(tmp_path, model_of(servo.format(f'kv="{kv:.9g}"'), armature=0.2), 0.5)
    found = diagnosed(tmp_path, files, "armature")
    assert [effect["name"] for effect in found["effects"]] == ["armature"]
    improved = mujoco.MjModel.from_xml_path(str(tmp_path / "out/improved.xml"))
    assert improved.dof_armature[0] == pytest.approx(0.2, rel=0.03)
    assert improved.actuator_biasprm[0, 2] == pytest.approx(-kv, rel=1e-5)


@pytest.mark.parametrize(
    ("actuator", "why"),
    [
        ('<pid name="drive" joint="knee" kp="60"/>', "takes 2 controls (pos, vel); allowed: one"),
        (
            '<dcmotor name="drive" joint="knee" motorconst="0.05" resistance="1" input="none"/>',
            "takes 0 controls; allowed: one, or its damping and friction at the joint",
        ),
        (
            '<dcmotor name="drive" joint="knee" motorconst="0.05" resistance="1" inductance="1"/>',
            "has a state that does not follow from its commands alone",
        ),
    ],
)
def test_an_actuator_that_cannot_be_replayed_is_named(actuator, why, tmp_path):
    (tmp_path / "model.xml").write_text(model_of(actuator))
    with pytest.raises(ModelError, match="drive") as error:
        Machine(tmp_path / "model.xml")
    assert why in str(error.value)


def test_a_model_that_its_time_step_makes_unstable_is_refused(tmp_path):
    path = tmp_path / "model.xml"
    # A damper of 300 N m s/rad, explicit, on 0.15 kg m^2: factors of -3 a step of 2 ms.
    stiff = '<position name="knee" joint="knee" kp="60" kv="300"/>'
    time, command, position, _ = simulated(model_of(servo()), 0, 0.5)
    path.write_text(model_of(stiff).replace("implicitfast", "Euler"))
    columns = {"knee_command": command, "knee_position": position}
    logs = {name: Recording(time=time, columns=columns) for name in ("log", "again")}
    with pytest.raises(ModelError, match="joint 'knee', driven by 'knee', blows up .* 0.002 s"):
        set_up(path, logs, ("again",), DiagnosisSettings(threads=1, effects=("payload",)))


def test_a_pendulum_without_an_actuator_swings_down(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(model_of("").replace('stiffness="8"', 'ref="1"'))
    model = mujoco.MjModel.from_xml_path(str(path))
    data, positions = mujoco.MjData(model), []
    while data.time < 3.0:
        positions.append(float(data.qpos[0]))
        mujoco.mj_step(model, data)
    time = 0.002 * np.arange(len(positions))
    noise = np.random.default_rng(0).normal(0.0, NOISE, time.size)
    log = Recording(time=time, columns={"knee_position": np.array(positions) + noise})
    settings = DiagnosisSettings(threads=1, effects=("payload",))
    problem = set_up(path, {"log": log, "again": log}, ("again",), settings)
    change = problem.library.change(Hypothesis(), problem.machine)
    assert rms(problem.replay.error(change, forces=True).values) < 1e-3
