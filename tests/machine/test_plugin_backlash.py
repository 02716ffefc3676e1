"""Play between motor and joint, against the two masses solved by Runge and Kutta."""

import functools
import math

import mujoco
import numpy as np
import pytest

from tests.helpers.native_models import GRAVITY, INERTIA, MASS, REACH, backlash, driven, pendulum
from tests.helpers.plugin_models import Slots, compiled

JOINT = INERTIA + MASS * REACH**2  # kg m^2
MOTOR = 0.02  # the armature of the rig
DAMPING = 0.1


def torque(t):
    return 2.0 * math.sin(2 * math.pi * 0.7 * t)


def run(xml, seconds, command=torque):
    return driven(xml, seconds, command, start=0.3)[:3]


def two_masses(width, stiffness, ratio, seconds, start=0.3, motor=MOTOR):
    """Motor and arm with a unilateral damped spring on each side of the play."""
    c = 2 * ratio * math.sqrt(stiffness / (1 / motor + 1 / JOINT))
    half = width / 2

    def rate(t, y):
        q, v, theta, w = y
        gap, closing = theta - q, w - v
        force = 0.0
        if gap > half:
            force = max(0.0, stiffness * (gap - half) + c * closing)
        elif gap < -half:
            force = min(0.0, stiffness * (gap + half) + c * closing)
        pull = MASS * GRAVITY * REACH * math.sin(q)
        return [v, (force - DAMPING * v - pull) / JOINT, w, (torque(t) - force) / motor]

    # Gravity alone at first: the arm drags the motor along by its lower flank.
    y = np.array([start, 0.0, start + half, 0.0])
    h, positions = 2e-5, [start]
    for k in range(round(seconds / h)):
        k1 = np.array(rate(k * h, y))
        k2 = np.array(rate((k + 0.5) * h, y + 0.5 * h * k1))
        k3 = np.array(rate((k + 0.5) * h, y + 0.5 * h * k2))
        k4 = np.array(rate((k + 1) * h, y + h * k3))
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        positions.append(y[0])
    return lambda t: np.interp(t, h * np.arange(len(positions)), positions)


@functools.cache
def reference(stiffness):
    return two_masses(0.1, stiffness, 0.5, 2.0)


@pytest.mark.parametrize("integrator", ["implicitfast", "implicit", "Euler"])
@pytest.mark.parametrize("stiffness", [300.0, 1e4])
def test_follows_the_two_masses_and_converges_with_the_step(stiffness, integrator):
    wanted = reference(stiffness)
    element = backlash(width=0.1, stiffness=stiffness, damping_ratio=0.5)
    errors = []
    for h in (1e-3, 2.5e-4):
        t, q, _ = run(pendulum(element, timestep=h, integrator=integrator), 2.0)
        errors.append(np.sqrt(np.mean((q - wanted(t)) ** 2)))
    # MuJoCo's own first-order error of the plain pendulum is as large.
    assert errors[0] < 4e-3
    assert errors[1] == pytest.approx(errors[0] / 4, rel=0.1)


def test_play_moves_the_pendulum_visibly():
    plain = run(pendulum(), 2.0)[1]
    assert np.std(run(pendulum(backlash(width=0.1)), 2.0)[1] - plain) > 0.015


@pytest.mark.parametrize("integrator", ["implicitfast", "implicit", "Euler"])
@pytest.mark.parametrize(
    "actuator",
    [
        '<motor name="drive" joint="hinge" gear="2"/>',
        '<position name="drive" joint="hinge" kp="200" kv="5" ctrlrange="-3 3"/>',
    ],
)
def test_without_width_nothing_changes_to_the_last_bit(actuator, integrator):
    plain = run(pendulum(actuator=actuator, integrator=integrator), 1.0)
    rigid = run(pendulum(backlash(), actuator=actuator, integrator=integrator), 1.0)
    np.testing.assert_array_equal(plain, rigid)


@pytest.mark.parametrize(
    "actuator",
    [
        '<motor name="drive" joint="hinge"/>',
        '<position name="drive" joint="hinge" kp="200" kv="5" forcerange="-8 8"/>',
        '<velocity name="drive" joint="hinge" kv="5"/>',
    ],
)
def test_small_play_tends_to_none_in_proportion(actuator):
    """So the armature is taken off the joint and given back through the gear, servo included."""
    plain = run(pendulum(actuator=actuator), 1.0)[1]
    gaps = [
        np.std(
            run(pendulum(backlash(width=w, stiffness=1e9, damping_ratio=1), actuator=actuator), 1.0)
            - plain,
            axis=1,
        )[1]
        for w in (1e-3, 1e-4, 1e-5)
    ]
    floor = 1e-9  # a servo that never lets go of one flank leaves nothing but rounding
    assert gaps[0] < 1e-2
    assert gaps[1] < max(0.2 * gaps[0], floor)
    assert gaps[2] < max(0.2 * gaps[1], floor)


@pytest.mark.parametrize("stiffness", [1e2, 1e5, 1e9])
def test_stays_stable_whatever_the_stiffness(stiffness):
    """A tiny motor behind a stiff servo hammers through the play at 1 ms."""
    xml = pendulum(
        backlash(width=0.05, stiffness=stiffness),
        actuator='<position name="drive" joint="hinge" kp="500" kv="2"/>',
        joint='armature="0.0005" damping="0.1"',
    )
    _, q, v = run(xml, 3.0, command=lambda t: 0.5 * math.sin(12 * t))
    assert np.abs(q).max() < 1.0
    assert np.abs(v).max() < 30.0


def test_resting_joint_lies_on_the_loaded_flank():
    """Held against gravity by a servo the joint hangs half a play below it."""
    hold = '<position name="drive" joint="hinge" kp="2000" kv="20"/>'
    width = 0.04
    model, data = compiled(pendulum(backlash(width=width, stiffness=1e7), actuator=hold))
    data.qpos[0] = 0.8
    for _ in range(3000):
        data.ctrl[0] = 0.8
        mujoco.mj_step(model, data)
    pull = MASS * GRAVITY * REACH * math.sin(data.qpos[0])
    slots = Slots(model, data, "play")
    assert slots["transmitted"] == pytest.approx(pull, rel=1e-6)
    motor = data.qpos[0] + slots["offset"]
    assert motor == pytest.approx(0.8 - pull / 2000, abs=1e-6)
    assert motor - data.qpos[0] == pytest.approx(width / 2, abs=1e-6)


def test_motor_spins_freely_within_the_play():
    """1 N m on 0.02 kg m^2 crosses half the play while the arm hangs still."""
    model, data = compiled(pendulum(backlash(width=0.2, stiffness=1e7)))
    slots = Slots(model, data, "play")
    data.ctrl[0] = -1.0
    mujoco.mj_step(model, data)  # seats on the lower flank
    data.ctrl[0] = 1.0
    steps = 0
    while slots["offset"] < 0.1 and steps < 1000:
        mujoco.mj_step(model, data)
        steps += 1
    crossing = math.sqrt(2 * 0.2 * MOTOR / 1.0)
    assert steps * 1e-3 == pytest.approx(crossing, rel=0.05)
    assert slots["motor_velocity"] < 0.5 * crossing / MOTOR  # most of it went into the arm


def test_momentum_is_kept_in_an_impact():
    """No gravity, no damping: motor and arm share what the motor had, at any restitution."""
    xml = pendulum(
        backlash(width=0.02, stiffness=1e6, damping_ratio=0.1), joint='armature="0.02"'
    ).replace("<option ", '<option gravity="0 0 0" ')
    model, data = compiled(xml)
    slots = Slots(model, data, "play")
    data.ctrl[0] = 2.0
    for _ in range(20):
        mujoco.mj_step(model, data)
    data.ctrl[0] = 0.0
    momentum = JOINT * data.qvel[0] + MOTOR * slots["motor_velocity"]
    assert momentum == pytest.approx(2.0 * 20e-3, rel=1e-9)
    data.qvel[0] -= 3.0
    wanted = momentum - 3.0 * JOINT
    for _ in range(400):
        mujoco.mj_step(model, data)
    assert JOINT * data.qvel[0] + MOTOR * slots["motor_velocity"] == pytest.approx(wanted, rel=1e-9)
    assert slots["motor_velocity"] == pytest.approx(data.qvel[0], rel=0.2)


def test_own_motor_inertia_beyond_the_armature_comes_on_top():
    xml = pendulum(backlash(width=0.03, motor_inertia=0.05, stiffness=1e4), joint='damping="0.1"')
    wanted = two_masses(0.03, 1e4, 0.5, 1.0, motor=0.05)
    t, q, _ = run(xml, 1.0)
    assert np.sqrt(np.mean((q - wanted(t)) ** 2)) < 4e-3


def test_width_set_in_the_state_equals_one_in_the_model():
    model, data = compiled(pendulum(backlash()))
    other_model, other = compiled(pendulum(backlash(width=0.03)))
    Slots(model, data, "play")["width"] = 0.03
    for k in range(500):
        data.ctrl[0] = other.ctrl[0] = math.sin(0.01 * k)
        mujoco.mj_step(model, data)
        mujoco.mj_step(other_model, other)
    np.testing.assert_array_equal(data.qpos, other.qpos)


def test_coulomb_friction_and_stops_act_on_the_joint_alone():
    """A tiny play changes next to nothing, although MuJoCo solves for friction and stops later."""
    joint = 'armature="0.05" frictionloss="0.3" limited="true" range="-60 30"'
    plain = run(pendulum(joint=joint), 2.0)
    small = run(pendulum(backlash(width=1e-5, stiffness=1e9, damping_ratio=1), joint=joint), 2.0)
    assert plain[1].max() > 0.52  # it did reach the stop
    assert np.abs(small[1] - plain[1]).max() < 0.01


def test_gravity_compensation_by_the_actuator_stays_on_the_joint():
    """Balanced, the arm rests anywhere; a tiny play changes nothing."""
    joint = 'armature="0.05" damping="0.1" actuatorgravcomp="true"'

    def balanced(*elements):
        xml = pendulum(*elements, joint=joint)
        return xml.replace('<body name="arm">', '<body name="arm" gravcomp="0.9">')

    plain = run(balanced(), 2.0)
    small = run(balanced(backlash(width=1e-5, stiffness=1e9, damping_ratio=1)), 2.0)
    assert np.abs(small[1] - plain[1]).max() < 2e-3


def test_a_motor_without_inertia_is_refused_at_run_time():
    model, data = compiled(pendulum(backlash(width=0.01, motor_inertia=0.01), joint=""))
    Slots(model, data, "play")["motor_inertia"] = 0.0
    with pytest.raises(mujoco.FatalError, match="motor_inertia = 0"):
        mujoco.mj_step(model, data)
