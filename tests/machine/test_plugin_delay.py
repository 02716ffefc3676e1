"""MuJoCo's own actuator delay in front of a servovalve."""

import mujoco
import numpy as np
import pytest

from tests.helpers.plugin_models import check_copies_go_on_exactly, compiled, slides, valve


@pytest.mark.parametrize("interp", ["zoh", "linear"])
def test_a_delayed_valve_gets_the_command_of_before(interp):
    commands = 0.3 * np.sin(0.02 * np.arange(300))
    late = np.concatenate([np.zeros(7), commands[:-7]])
    delayed = valve("v").replace(
        'name="v"', f'name="v" delay="0.007" nsample="8" interp="{interp}"'
    )
    ends = []
    for xml, sequence in ((valve("v"), late), (delayed, commands)):
        model, data = compiled(slides(xml, timestep=1e-3))
        for u in sequence:
            data.ctrl[0] = u
            mujoco.mj_step(model, data)
        ends.append([data.qpos[0], data.qvel[0], *data.plugin_state])
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-12)


def test_a_delayed_valve_goes_on_exactly_from_a_snapshot():
    delayed = valve("v").replace('name="v"', 'name="v" delay="0.0065" nsample="9" interp="linear"')
    model, data = compiled(slides(delayed, timestep=1e-3))

    def drive(moved, wave):
        for k in range(150):
            moved.ctrl[0] = 0.3 * wave(0.05 * k)
            mujoco.mj_step(model, moved)

    drive(data, np.sin)
    check_copies_go_on_exactly(model, data, lambda d: drive(d, np.cos))
