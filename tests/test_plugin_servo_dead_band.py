"""The dead band of a position servo's error, against the same force in NumPy."""

import mujoco
import numpy as np
import pytest

from tests.native_models import command_path, slide
from tests.plugin_models import compiled

BAND = 0.15
SERVOS = (
    '<position name="drive" joint="axis" kp="50" kv="3"/>',
    '<position name="drive" joint="axis" kp="50" kv="3" gear="2"/>',
    '<position name="drive" joint="axis" kp="50" kv="3" timeconst="0.02"/>',
)


def commands(n=1200):
    t = 1e-3 * np.arange(n)
    return 0.8 * np.sin(2 * np.pi * 1.3 * t) + 0.3 * np.sin(2 * np.pi * 7.1 * t + 1)


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
