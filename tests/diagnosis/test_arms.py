"""Machines with more than one joint, and servos: what Lagrange's equations hid in them is named."""

import pytest

from leglab.diagnosis.improve import improved_model
from leglab.diagnosis.likelihood.twins import coupled_joints
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.verdict.verdict import diagnose
from rigs import (
    GANTRY,
    MOTOR_ARM,
    PENDULUM,
    SERVO_ARM,
    SERVO_JOINT,
    Hidden,
    record_linkage,
)
from rigs.agreement import open_loop_error
from tests.helpers.patched_models import reloaded_error
from tests.helpers.unpleasant import of_kinds

RIGS = {r.model.stem: r for r in (MOTOR_ARM, SERVO_ARM, GANTRY, SERVO_JOINT)}
KINDS = ("multisine", "fast", "slow", "stairs")

# By rig: what is hidden, and the names, elements and values that must come out.
ONE = {
    "motor_arm": [
        ({"quadratic": (0.0, 0.4)}, ("quadratic_damping", "elbow", "damping", 0.4)),
        ({"delay": (0.0, 0.006)}, ("command_delay", "elbow_drive", "delay", 0.006)),
    ],
    "servo_arm": [
        ({"viscous": (0.0, 1.0)}, ("viscous_friction", "elbow", "damping", 1.3)),
        ({"payload": (0.6, 0.35)}, ("payload", "forearm", "mass", 0.6)),
    ],
    "gantry": [({"viscous": (15.0, 0.0)}, ("viscous_friction", "trolley", "damping", 30.0))],
    "servo_joint": [({"stiffness": (3.0, 0.0)}, ("spring_stiffness", "hinge", "stiffness", 3.0))],
}
TWO = {
    "motor_arm": (
        {"viscous": (1.5, 0.0), "delay": (0.0, 0.006)},
        {("viscous_friction", "shoulder"): 2.1, ("command_delay", "elbow_drive"): 0.006},
    ),
    "servo_arm": (
        {"stiffness": (8.0, 0.0), "quadratic": (0.0, 0.4)},
        {("spring_stiffness", "shoulder"): 8.0, ("quadratic_damping", "elbow"): 0.4},
    ),
    "gantry": (
        {"gain": (0.8, 1.0), "quadratic": (0.0, 0.3)},
        {("actuator_gain", "trolley_drive"): 0.8, ("quadratic_damping", "swing"): 0.3},
    ),
    "servo_joint": (
        {"stiffness": (3.0, 0.0), "quadratic": (0.3, 0.0)},
        {("spring_stiffness", "hinge"): 3.0, ("quadratic_damping", "hinge"): 0.3},
    ),
}


def verdict(rig, hidden, seconds=4.0):
    recordings = of_kinds(rig, Hidden(**hidden), KINDS, seconds=seconds)
    return diagnose(rig.model, recordings, held_out=("multisine",))


def named(result):
    return {(e.name, e.element): e for e in result.effects}


@pytest.mark.parametrize("name", RIGS)
def test_the_independent_simulator_agrees_with_the_nominal_models(name):
    """Free of leglab altogether: the recorded commands drive the bare model along the recording."""
    rig = RIGS[name]
    quiet = record_linkage(rig, "fast", Hidden(), seed=0, seconds=1.0)
    assert open_loop_error(rig.model, quiet, rig.joints, rig.drives) < 5e-4  # of 0.5 to 1.5


@pytest.mark.slow("whole diagnoses with all effects, as of the bench in test_diagnosis.py")
@pytest.mark.parametrize("name", RIGS)
def test_a_perfect_model_lacks_nothing(name):
    result, _ = verdict(RIGS[name], {})
    assert result.verdict == "nothing_missing"
    assert result.effects == ()
    assert result.gap.before < 1.1  # the step of the replays is no misfit
    assert result.gap.after < 1.1


@pytest.mark.slow("whole diagnoses of an arm with all effects")
@pytest.mark.parametrize(
    ("name", "hidden", "expected"),
    [(name, hidden, expected) for name, cases in ONE.items() for hidden, expected in cases],
)
def test_one_fault_is_named_on_its_joint(name, hidden, expected, tmp_path):
    effect, element, parameter, value = expected
    result, found = verdict(RIGS[name], hidden)
    assert result.verdict == "named"
    assert list(named(result)) == [(effect, element)]
    assert result.effects[0].confidence > 0.8
    fitted = {p.name: p.value for p in result.effects[0].parameters}
    assert fitted[parameter] == pytest.approx(value, rel=0.01)
    assert result.gap.after < 1.1
    better = improved_model(found)
    assert reloaded_error(better.problem, better.hypothesis, better.write(tmp_path)[0]) < 0.1


@pytest.mark.slow("whole diagnoses of an arm with all effects")
@pytest.mark.parametrize("name", TWO)
def test_two_faults_on_different_joints_are_both_named(name):
    hidden, expected = TWO[name]
    result, _ = verdict(RIGS[name], hidden)
    assert result.verdict == "named"
    effects = named(result)
    assert set(effects) == set(expected)
    for key, value in expected.items():
        assert effects[key].confidence > 0.8
        assert effects[key].parameters[0].value == pytest.approx(value, rel=0.01)


@pytest.mark.soak
def test_two_faults_on_each_of_two_joints_are_all_named():
    """So many gross faults look like a rough machine, until all of them are in the model."""
    hidden = {
        "delay": (0.0032, 0.0),
        "gain": (0.7, 1.0),
        "quadratic": (0.0, 0.56),
        "armature": (0.0, 0.056),
    }
    result, _ = verdict(RIGS["motor_arm"], hidden, seconds=3.0)
    assert result.verdict == "named"
    values = {key: e.parameters[0].value for key, e in named(result).items()}
    assert values == {
        ("command_delay", "shoulder_drive"): pytest.approx(0.0032, rel=0.02),
        ("actuator_gain", "shoulder_drive"): pytest.approx(0.7, rel=0.01),
        ("quadratic_damping", "elbow"): pytest.approx(0.56, rel=0.01),
        ("armature", "elbow"): pytest.approx(0.03 + 0.056, rel=0.02),
    }
    assert min(e.confidence for e in result.effects) > 0.8
    assert result.gap.after < 1.1


def test_joints_feel_each_other_by_the_mass_matrix():
    assert coupled_joints(Machine(MOTOR_ARM.model)) == ("shoulder", "elbow")
    assert coupled_joints(Machine(GANTRY.model)) == ("trolley", "swing")
    assert coupled_joints(Machine(PENDULUM.model)) == ()


FOLDED = """
<mujoco><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/>
<geom type="sphere" size=".05" pos="1 0 0" mass="3"/>
<body name="lower" pos="1 0 0"><joint name="elbow" axis="0 1 0"/>
<geom type="sphere" size=".01" pos="-1 0 0" mass="1"/></body></body>
<body name="other" pos="0 2 0"><joint name="lonely" axis="0 1 0"/>
<geom type="sphere" size=".05" pos="1 0 0" mass="3"/></body></worldbody>
<actuator><motor name="a" joint="shoulder"/><motor name="b" joint="elbow"/>
<motor name="c" joint="lonely"/></actuator></mujoco>
"""


def test_joints_that_feel_each_other_at_some_pose_only_are_coupled(tmp_path):
    path = tmp_path / "folded.xml"
    path.write_text(FOLDED)
    assert coupled_joints(Machine(path)) == ("shoulder", "elbow")


@pytest.mark.slow("whole diagnoses of an arm with all effects")
@pytest.mark.parametrize(
    ("hidden", "truth"),
    [({"payload": (0.4, 0.35)}, "payload"), ({"gain": (0.8, 1.0)}, "actuator_gain")],
)
def test_a_payload_and_a_weak_drive_of_a_servo_joint_are_not_taken_for_each_other(hidden, truth):
    """Weight and damping of a stiff servo scale alike; inertia hardly counts at these speeds."""
    result, _ = verdict(SERVO_JOINT, hidden)
    (effect,) = result.effects
    assert truth in (effect.name, *effect.indistinguishable_from)
    assert effect.name == truth or effect.confidence <= 0.5
