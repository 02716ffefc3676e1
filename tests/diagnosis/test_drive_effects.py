"""Limits and gains of drives that are hidden in a simulated machine are named, with their size."""

import importlib.util
import json
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from leglab.cli.app import app
from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.likelihood.twins import own_forces, scale_twins
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.plant.model import Machine

# In the folder of the checkout, or in that of its worktrees.
INPUTS = [folder / "shared" / "inputs" / "make.py" for folder in Path(__file__).parents[3:]]
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


def logged(folder, seeds, xml, size, reaches):
    """Logs of a machine by seed, as CSV."""
    files = [folder / f"log_{seed}.csv" for seed in seeds]
    for seed, file in zip(seeds, files, strict=True):
        rows = np.stack(simulated(xml, seed, size, reaches), axis=1)
        head = "time,knee_command,knee_position"
        np.savetxt(file, rows, delimiter=",", header=head, comments="", fmt="%.9g")
    return files


def diagnosed(folder, files, *effects, healthy=()):
    """What `leglab diagnose model.xml` says, from diagnosis.json."""
    tried = [word for effect in effects for word in ("--effect", effect)]
    tried += [word for file in healthy for word in ("--healthy", str(file))]
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


ATTRIBUTES = {
    "command_saturation": lambda actuator: actuator.ctrlrange[1],
    "force_saturation": lambda actuator: actuator.forcerange[1],
    "servo_stiffness": lambda actuator: actuator.gainprm[0] / 60.0,
}


@pytest.mark.slow("a whole diagnosis of each effect")
@pytest.mark.parametrize("name", HIDDEN)
def test_what_is_hidden_in_a_drive_is_named_first(name, tmp_path):
    actuator, size, other, reaches, sizes = HIDDEN[name]
    (tmp_path / "model.xml").write_text(model_of(actuator))
    files = logged(tmp_path, range(3), model_of(other), size, reaches)
    found = diagnosed(tmp_path, files, name, *FEW)
    first = found["effects"][0]
    assert (found["verdict"], first["name"]) == ("named", name), found["effects"]
    for parameter, value in sizes.items():
        assert first["parameters"][parameter]["value"] == pytest.approx(value, rel=0.1)
    # What plain MuJoCo has an attribute for is written so.
    if name in ATTRIBUTES:
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "out/improved.xml"))
        written = ATTRIBUTES[name](model.actuator("knee"))
        assert written == pytest.approx(next(iter(sizes.values())), rel=0.1)
        assert model.nplugin == 0


@pytest.mark.slow("whole diagnoses with healthy recordings")
@pytest.mark.parametrize(("before", "names"), [(0.4, []), (2.0, ["command_saturation"])])
def test_a_limit_that_healthy_recordings_show_is_no_change(before, names, tmp_path):
    (tmp_path / "model.xml").write_text(model_of(SERVO))

    def logs(small, large, limit):
        """One log with commands that hardly reach the limit, and others beyond it."""
        reaches = partial(np.clip, a_min=-limit, a_max=limit)
        sizes = ((small, 0.2), (large, 0.35))
        return [f for i, s in sizes for f in logged(tmp_path, i, model_of(SERVO), s, reaches)]

    new, healthy = logs([0], [1, 2], 0.4), logs([10], [11], before)
    found = diagnosed(tmp_path, new, "command_saturation", *FEW, healthy=healthy)
    assert [effect["name"] for effect in found["effects"]] == names
    assert found["verdict"] == ("named" if names else "nothing_missing")


def test_a_limit_changes_nothing_where_nothing_comes_near_it(tmp_path):
    (tmp_path / "model.xml").write_text(model_of(SERVO))
    machine = Machine(tmp_path / "model.xml")
    library = Library(machine)
    for effect, element in (("command_saturation", "knee"), ("force_saturation", "knee")):
        site = library.sites[effect, element]
        change = library.change(Hypothesis({(effect, element): site.model}), machine, written=True)
        assert not change.edits
        assert not change.commands


def test_sides_of_a_command_path_act_alike_in_replays_and_in_the_plugin(tmp_path):
    (tmp_path / "model.xml").write_text(model_of(MOTOR))
    machine = Machine(tmp_path / "model.xml")
    library, command = Library(machine), np.linspace(-15.0, 15.0, 31)
    hypothesis = Hypothesis(
        {
            ("command_saturation", "knee"): np.array([12.0]),
            ("command_deadband_asymmetry", "knee"): np.array([2.0, 5.0]),
            ("command_gain_asymmetry", "knee"): np.array([0.7, 1.2]),
        }
    )
    reached = command
    for path in library.change(hypothesis, machine).commands["knee"]:
        reached = path(reached, 0.01)
    spec = machine.spec()
    for _, edit in library.change(hypothesis, machine, written=True).edits:
        edit(spec)
    model = spec.compile()
    data, forces = mujoco.MjData(model), []
    for sent in command:
        data.ctrl[0] = sent
        mujoco.mj_forward(model, data)
        forces.append(data.actuator_force[0])
    np.testing.assert_allclose(forces, reached, atol=1e-12)
    clipped = sides(np.clip(command, -12.0, 12.0))
    np.testing.assert_allclose(reached, np.where(clipped > 0.0, 0.7, 1.2) * clipped, atol=1e-12)


@pytest.fixture(scope="module")
def brought(tmp_path_factory):
    """Folders of ../shared/inputs by kind."""
    file = next((path for path in INPUTS if path.is_file()), None)
    if file is None:
        pytest.skip("no shared/inputs beside the checkout")
    spec = importlib.util.spec_from_file_location("inputs", file)
    inputs = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(inputs)
    folder = tmp_path_factory.mktemp("inputs")
    inputs.main(folder, "15", "20")
    return {15: folder / "15_force_limit", 20: folder / "20_falls"}


@pytest.mark.slow("whole diagnoses of what users bring")
@pytest.mark.parametrize(
    ("model", "logs", "name", "limit"),
    [
        ("model.xml", "clipped", "command_saturation", 0.5),
        ("two.xml", "joint", "force_saturation", 4.0),
    ],
)
def test_a_drive_that_clips_is_named_with_its_limit(brought, model, logs, name, limit, tmp_path):
    files = sorted(brought[15].glob(f"{logs}_*.csv"))
    (tmp_path / "model.xml").write_text((brought[15] / model).read_text())
    both = ("command_saturation", "force_saturation")
    (first, *_) = diagnosed(tmp_path, files, *both, *FEW, "servo_stiffness")["effects"]
    assert first["name"] == name
    assert first["parameters"]["limit"]["value"] == pytest.approx(limit, rel=0.05)


@pytest.mark.slow("a whole diagnosis of what users bring")
def test_a_heavier_weight_is_not_less_of_all_else(brought, tmp_path):
    (tmp_path / "model.xml").write_text((brought[20] / "model.xml").read_text())
    few = ("payload", "armature", "viscous_friction", "coulomb_friction")
    found = diagnosed(tmp_path, sorted(brought[20].glob("loaded_*.csv")), *few)
    (first, *_) = found["effects"]
    assert first["name"] == "payload"
    low, high = first["parameters"]["mass"]["interval"]
    assert low < 0.434 < high


def test_all_forces_times_a_factor_are_a_twin(tmp_path):
    (tmp_path / "model.xml").write_text(model_of(MOTOR))
    machine, still = Machine(tmp_path / "model.xml"), np.zeros(9)
    few = ("payload", "armature", "viscous_friction", "coulomb_friction")
    library = Library(machine, names=few)
    problem = SimpleNamespace(
        machine=machine, library=library, series=[SimpleNamespace(columns={"knee_command": still})]
    )
    u, share = Unknowns.of(library), 0.6
    less = {
        (name, "knee"): share * library.sites[name, "knee"].model
        for name in ("armature", "viscous_friction", "coulomb_friction")
    }
    x = u.departures(Hypothesis(less))
    members = tuple(np.flatnonzero(x).tolist())
    twins = list(scale_twins(problem, u, own_forces(problem, u), members, x))
    assert {u.names(names) for names, _ in twins} == {frozenset({("payload", "shank")})}
    for _, moves in twins:
        found = u.moved(Hypothesis(less), moves)
        mass, distance = found["payload", "shank"]
        # Six tenths of all else are a weight of ten sixths.
        assert (mass, distance) == pytest.approx((2.0 / share - 2.0, 0.2))
        for key in less:
            np.testing.assert_allclose(found[key], library.sites[key].model)
    # A known force tells the factor.
    problem.series[0].columns["knee_command"] = still + 1.0
    assert not own_forces(problem, u).any()
