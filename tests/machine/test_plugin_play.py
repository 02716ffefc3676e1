"""Play between rod end and pin against two bodies with a stiff flank, at a fine step."""

import mujoco
import numpy as np
import pytest

from leglab.machine.parameters import plugin_tables
from tests.helpers.plugin_models import Slots, compiled, slides, valve

PLAY, PISTON, MASS = 4e-4, 0.5, 20.0
STIFFNESS = 5e7  # of the flank, N/m
AREA_A, AREA_B = np.pi / 4 * 0.016**2, np.pi / 4 * (0.016**2 - 0.010**2)


def command(t):
    return 0.3 * np.sin(2 * np.pi * 3 * t)


def load(v, t):
    """Of the mechanism: damping, and a force that presses the pin to one side and the other."""
    return -400.0 * v + 300.0 * np.sin(9.0 * t)


def element(timestep, play, seconds=0.4, **attributes):
    """Positions of mass and piston and pressure A every millisecond, by the plugin's play."""
    model, data = compiled(slides(valve("a", play=play, **attributes), timestep=timestep))
    slots, rows, every = Slots(model, data, "a"), [], round(1e-3 / timestep)
    for k in range(round(seconds / timestep)):
        data.ctrl[0] = command(k * timestep)
        data.qfrc_applied[0] = load(data.qvel[0], k * timestep)
        mujoco.mj_step(model, data)
        if k % every == every - 1:
            rows.append([data.qpos[0], slots["play_offset"], slots["pressure_a"]])
    return np.array(rows)


@pytest.fixture(scope="module")
def reference():
    """The same by two bodies, whose flank is an explicit spring and damper, at 20 us."""
    h = 2e-5
    bodies = "".join(
        f'<body><joint name="{name}" type="slide" axis="1 0 0" ref="{at}"/>'
        f'<inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/></body>'
        for name, at, mass in (("rod", 0.04, PISTON), ("load", 0.0, MASS))
    )
    declared = "".join(f'<plugin plugin="{name}"/>' for name in plugin_tables())
    xml = (
        f'<mujoco><option timestep="{h}" gravity="0 0 0" integrator="implicitfast"/>'
        f"<extension>{declared}</extension><worldbody>{bodies}</worldbody>"
        f"<actuator>{valve('a')}</actuator></mujoco>"
    )
    model, data = compiled(xml)
    slots, rows, half = Slots(model, data, "a"), [], 0.5 * PLAY
    damping = 2 * 0.5 * np.sqrt(STIFFNESS / (1 / PISTON + 1 / MASS))
    pressing = slots["pressure_a"] * AREA_A - slots["pressure_b"] * AREA_B
    data.qpos[0] = 0.04 + np.copysign(half, pressing)
    for k in range(round(0.4 / h)):
        gap = data.qpos[0] - 0.04 - data.qpos[1]
        flank = 0.0
        if abs(gap) > half:
            side = np.sign(gap)
            flank = STIFFNESS * (gap - side * half) + damping * (data.qvel[0] - data.qvel[1])
            flank = side * max(side * flank, 0.0)
        data.ctrl[0] = command(k * h)
        data.qfrc_applied[:] = -flank, flank + load(data.qvel[1], k * h)
        mujoco.mj_step(model, data)
        if k % 50 == 49:
            gap = data.qpos[0] - 0.04 - data.qpos[1]
            rows.append([data.qpos[1] + 0.04, gap, slots["pressure_a"]])
    return np.array(rows)


def rms(errors):
    return np.sqrt(np.mean(errors**2, axis=0))


def test_play_moves_as_two_bodies_do(reference):
    assert np.ptp(np.sign(reference[:, 1])) == 2  # the piston presses either side
    x, offset, pressure = rms(element(5e-5, PLAY) - reference)
    assert x < 1e-5
    assert offset < 5e-6
    assert pressure < 0.3e5
    rigid = rms(element(5e-5, 0.0) - reference)
    assert rigid[0] > 1e-4
    assert rigid[1] > 1e-4


def test_play_is_stable_and_right_at_the_step_of_a_model(reference):
    x, offset, pressure = rms(element(5e-4, PLAY) - reference)
    assert x < 1e-4
    assert offset < 3e-5
    assert pressure < 3e5


def test_without_play_nothing_changes():
    np.testing.assert_array_equal(
        element(5e-4, 0.0, piston_mass=3.0, play_stiffness=1e6), element(5e-4, None)
    )


def test_the_pin_carries_what_the_piston_does_not_hold(reference):
    """In the play nothing is transmitted."""
    model, data = compiled(slides(valve("a", play=PLAY), timestep=1e-4))
    slots = Slots(model, data, "a")
    free = pressed = 0
    for k in range(4000):
        data.ctrl[0] = command(k * 1e-4)
        data.qfrc_applied[0] = load(data.qvel[0], k * 1e-4)
        mujoco.mj_step1(model, data)
        before = slots["play_offset"]
        mujoco.mj_step2(model, data)
        if k and max(abs(before), abs(slots["play_offset"])) < 0.45 * PLAY:
            assert data.actuator_force[0] == 0.0
            free += 1
        pressed += abs(data.actuator_force[0]) > 10.0
    assert free > 20
    assert pressed > 1000
