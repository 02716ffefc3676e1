"""Hidden states of play and friction, from the motion, against those of a simulation."""

import mujoco
import numpy as np
import pytest

from leglab.diagnosis.effects.backlash import motor_states
from leglab.diagnosis.effects.friction import carried_load
from leglab.diagnosis.plant.model import Change, Machine, Measured
from tests.native_models import backlash, friction, pendulum
from tests.plugin_models import Slots, compiled

H = 1e-3


def swing(xml, element, names, n=3000):
    """Motion at sample times and plugin states along a swing; velocities as MuJoCo has them."""
    model, data = compiled(xml)
    slots = Slots(model, data, element)
    rows = []
    for k in range(n):
        data.ctrl[0] = 2.0 * np.sin(7e-3 * k) + np.sin(23e-3 * k)
        before = data.qpos[0], data.qvel[0], data.ctrl[0], *(slots[name] for name in names)
        mujoco.mj_step(model, data)
        rows.append([*before, data.qvel[0]])
    table = np.array(rows).T
    # On a sample the velocity is the mean of those half a step before and after.
    velocity = 0.5 * (table[1] + table[-1])
    measured = Measured(
        period=H,
        position={"hinge": table[0]},
        velocity={"hinge": velocity},
        piston_velocity={},
        lever={},
        command={"drive": table[2]},
        pressure={},
        samples=np.arange(500, n - 10, 37),
    )
    return measured, table[3:-1], model


SERVO = '<position name="drive" joint="hinge" kp="30" kv="1" forcerange="-6 6"/>'


@pytest.mark.parametrize("actuator", ['<motor name="drive" joint="hinge" gear="1.5"/>', SERVO])
def test_the_motor_is_found_in_the_play(actuator):
    width = 0.06
    xml = pendulum(backlash(width=width, stiffness=2e5), actuator=actuator)
    measured, (offset, speed), model = swing(xml, "play", ("offset", "motor_velocity"))
    found, velocity = motor_states(measured, model, "hinge", width, 0.02)
    at = measured.samples
    assert np.abs(offset[at]).min() < 0.4 * width  # some samples lie within the play
    # Impacts fall between samples, so a few are off; the flank itself gives way a little.
    good = np.abs(found - offset[at]) < 0.05 * width
    assert good.mean() > 0.9
    assert np.median(np.abs(velocity - speed[at])[good]) < 0.02
    # Seating by the load alone would put them all on a flank.
    assert np.mean(np.abs(np.abs(found) - width / 2) < 1e-9) < 0.98


def test_the_carried_load_follows_motor_and_gravity(tmp_path):
    element = friction(
        joint="hinge",
        sigma_0=1e4,
        sigma_1=50,
        actuator_load_coefficient=0.1,
        bias_load_coefficient=0.05,
    )
    measured, (load,), _ = swing(pendulum(element), "friction", ("load",))
    (tmp_path / "plain.xml").write_text(pendulum(element))
    machine = Machine(tmp_path / "plain.xml")
    change = Change(machine)
    change.set_parameter("friction", "actuator_load_coefficient", 0.1)
    change.set_parameter("friction", "bias_load_coefficient", 0.05)
    found = carried_load(change, measured, machine.base, "friction", "hinge")
    # The plugin's load is that of the step before.
    assert np.abs(found[21:] - load[21:]).max() < 0.05 * load.max()
    assert np.median(np.abs(found[21:] - load[21:])) < 0.01 * load.max()
