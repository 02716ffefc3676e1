"""Commands on their way to native actuators, against the same elements in NumPy."""

import math

import mujoco
import numpy as np
import pytest
from scipy.signal import lsim

from tests.helpers.native_models import backlash, command_path, pendulum, slide
from tests.helpers.plugin_models import Slots, compiled

H = 1e-3


def commands(n=1200):
    t = H * np.arange(n)
    return 0.8 * np.sin(2 * np.pi * 1.3 * t) + 0.3 * np.sin(2 * np.pi * 7.1 * t + 1)


def forces(model, data, sequence):
    out = []
    for u in sequence:
        data.ctrl[0] = u
        mujoco.mj_step(model, data)
        out.append(data.actuator_force[0])
    return np.array(out)


MOTOR = '<motor name="drive" joint="axis"/>'


def through(sequence, actuator=MOTOR, integrator="Euler", **attributes):
    """What a motor of unit gain makes of the commands: the path's output."""
    xml = slide(command_path(**attributes), actuator=actuator, integrator=integrator)
    return forces(*compiled(xml), sequence)


@pytest.mark.parametrize("delay", [0.004, 0.0123, 0.05])
def test_delay_is_the_mean_of_the_held_command_that_arrives(delay):
    u = commands()
    fine = 100
    held = np.repeat(u, fine)
    shift = round(delay / H * fine)
    late = np.concatenate([np.full(shift, u[0]), held])[: held.size]
    wanted = late.reshape(-1, fine).mean(axis=1)
    np.testing.assert_allclose(through(u, delay=delay), wanted, atol=1e-9)


@pytest.mark.parametrize("time_constant", [2e-4, 0.005, 0.1])
def test_lag_is_the_mean_of_the_exact_response(time_constant):
    u = commands(400)
    fine = 200
    t = H / fine * np.arange(u.size * fine + 1)
    held = np.append(np.repeat(u, fine), u[-1])
    _, y, _ = lsim(([1.0], [time_constant, 1.0]), held, t, X0=[u[0] * time_constant], interp=False)
    wanted = (0.5 * (y[1:] + y[:-1])).reshape(-1, fine).mean(axis=1)
    np.testing.assert_allclose(through(u, time_constant=time_constant), wanted, atol=2e-4)


def test_order_is_delay_gain_bias_hysteresis_dead_band():
    u = commands()
    x = 1.5 * np.concatenate([np.full(3, u[0]), u[:-3]]) + 0.2
    y, wanted = x[0], []
    for value in x:
        y = min(max(y, value - 0.05), value + 0.05)
        wanted.append(math.copysign(max(abs(y) - 0.1, 0.0), y))
    got = through(u, delay=0.003, gain=1.5, bias=0.2, hysteresis=0.1, dead_band=0.1)
    np.testing.assert_allclose(got, wanted, atol=1e-12)


def test_actuator_gain_scales_the_force_of_a_servo():
    servo = '<position name="drive" joint="axis" kp="50" kv="3"/>'
    strong = '<position name="drive" joint="axis" kp="60" kv="3.6"/>'
    got = through(commands(), servo, actuator_gain=1.2)
    wanted = forces(*compiled(slide(actuator=strong, integrator="Euler")), commands())
    np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-9)


def test_commands_are_limited_before_and_forces_behind_the_path():
    motor = '<motor name="drive" joint="axis" gear="1" ctrlrange="-0.5 0.5" forcerange="-0.6 0.6"/>'
    u = commands()
    wanted = np.clip(1.5 * np.clip(u, -0.5, 0.5), -0.6, 0.6)
    np.testing.assert_allclose(through(u, motor, gain=1.5), wanted, atol=1e-12)


STATEFUL = [
    '<general name="drive" joint="axis" dyntype="integrator" gainprm="5"/>',
    '<general name="drive" joint="axis" dyntype="filter" dynprm="0.02" gainprm="5"/>',
    '<general name="drive" joint="axis" dyntype="filterexact" dynprm="0.02" gainprm="5"/>',
    '<intvelocity name="drive" joint="axis" kp="40" actrange="-1 1"/>',
]


@pytest.mark.parametrize("actuator", STATEFUL)
def test_actuators_with_activation_get_the_command_too(actuator):
    u = commands()
    got = through(u, actuator, gain=0.5, dead_band=0.1, delay=0.002)
    late = 0.5 * np.concatenate([np.full(2, u[0]), u[:-2]])
    reached = np.sign(late) * np.maximum(np.abs(late) - 0.1, 0)
    wanted = forces(*compiled(slide(actuator=actuator, integrator="Euler")), reached)
    np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-9)


AFFINE = '<general name="drive" joint="axis" gaintype="affine" gainprm="2 0.5 -0.2"/>'


@pytest.mark.parametrize(
    "actuator",
    [
        '<motor name="drive" joint="axis" gear="3"/>',
        '<position name="drive" joint="axis" kp="80" kv="4"/>',
        AFFINE,
        *STATEFUL,
    ],
)
@pytest.mark.parametrize("integrator", ["implicitfast", "Euler"])
def test_neutral_path_changes_nothing_to_the_last_bit(actuator, integrator):
    plain = forces(*compiled(slide(actuator=actuator, integrator=integrator)), commands())
    xml = slide(command_path(), actuator=actuator, integrator=integrator)
    np.testing.assert_array_equal(plain, forces(*compiled(xml), commands()))


def test_affine_gain_takes_the_command_at_its_length():
    got = through(commands(), AFFINE, gain=0.7)
    wanted = forces(*compiled(slide(actuator=AFFINE, integrator="Euler")), 0.7 * commands())
    np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-12)


def test_disabled_actuator_stays_without_force():
    motor = '<motor name="drive" joint="axis" group="2"/>'
    xml = slide(command_path(bias=1.0, actuator_gain=2.0), actuator=motor)
    model, data = compiled(xml.replace("<option ", '<option actuatorgroupdisable="2" '))
    assert not forces(model, data, commands(50)).any()


def test_longest_delay_is_refused_beyond_at_run_time():
    model, data = compiled(slide(command_path(max_delay=0.01)))
    Slots(model, data, "path")["delay"] = 0.010
    mujoco.mj_step(model, data)
    Slots(model, data, "path")["delay"] = 0.012
    with pytest.raises(mujoco.FatalError, match=r"'delay' = 0.012 s; allowed: \[0, 0.01\] s"):
        mujoco.mj_step(model, data)


@pytest.mark.parametrize("path_first", [True, False])
def test_a_play_drives_its_motor_with_what_the_path_lets_through(path_first):
    ends = []
    for path, factor in ((command_path(gain=0.5), 1.0), (command_path(), 0.5)):
        elements = [path, backlash(width=0.03)]
        model, data = compiled(pendulum(*(elements if path_first else elements[::-1])))
        forces(model, data, factor * commands(500))
        ends.append([data.qpos[0], data.actuator_force[0]])
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-12)


BAND = 0.15
SERVOS = (
    '<position name="drive" joint="axis" kp="50" kv="3"/>',
    '<position name="drive" joint="axis" kp="50" kv="3" gear="2"/>',
    '<position name="drive" joint="axis" kp="50" kv="3" timeconst="0.02"/>',
)


@pytest.mark.parametrize("servo", SERVOS)
def test_only_what_passes_the_band_of_the_error_gives_force(servo):
    model, data = compiled(slide(command_path(servo_dead_band=BAND), actuator=servo))
    inside = 0
    for u in commands():
        data.ctrl[0] = u
        mujoco.mj_forward(model, data)
        goal = data.act[0] if model.na else u
        error = goal - data.actuator_length[0]
        beyond = np.sign(error) * max(abs(error) - BAND, 0.0)
        wanted = 50.0 * beyond - 3.0 * data.actuator_velocity[0]
        assert data.actuator_force[0] == pytest.approx(wanted, rel=1e-9, abs=1e-12)
        inside += abs(error) < BAND
        mujoco.mj_step(model, data)
    assert 50 < inside < 1150


def test_the_band_takes_what_comes_out_of_the_path():
    model, data = compiled(
        slide(command_path(servo_dead_band=BAND, bias=0.4, gain=0.5), actuator=SERVOS[0])
    )
    data.ctrl[0] = 1.0
    mujoco.mj_forward(model, data)
    assert data.actuator_force[0] == pytest.approx(50.0 * (0.9 - BAND))


@pytest.mark.parametrize(
    "actuator",
    [
        '<motor name="drive" joint="axis"/>',
        '<velocity name="drive" joint="axis" kv="3"/>',
        '<general name="drive" joint="axis" biastype="affine" gainprm="5" biasprm="0 -4 0"/>',
    ],
)
def test_what_is_no_position_servo_has_none(actuator):
    with pytest.raises(ValueError, match="'servo_dead_band' = 0.15; allowed: 0"):
        compiled(slide(command_path(servo_dead_band=BAND), actuator=actuator))
