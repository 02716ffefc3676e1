"""The elements beside native actuators are state and nothing but state."""

import mujoco
import numpy as np
import pytest

from tests.helpers.native_models import backlash, command_path, friction, pendulum
from tests.helpers.plugin_models import (
    Slots,
    check_copies_go_on_exactly,
    check_copy_between_stages,
    compiled,
    full_physics,
    instance,
    rolled_out,
)

ACTUATORS = [
    '<motor name="drive" joint="hinge" forcerange="-4 4"/>',
    '<position name="drive" joint="hinge" kp="60" kv="2"/>',
]


def rich(actuator=ACTUATORS[0]):
    return pendulum(
        command_path(
            gain=1.1, bias=0.05, dead_band=0.05, hysteresis=0.1, delay=0.0065, time_constant=0.004
        ),
        backlash(width=0.03),
        friction(
            joint="hinge",
            coulomb=0.1,
            static=0.2,
            sigma_0=500,
            sigma_1=2,
            viscous_difference=0.1,
            coulomb_difference=0.05,
            actuator_load_coefficient=0.05,
            bias_load_coefficient=0.05,
        ),
        instance("leglab.spring_damper", "spring", joint="hinge", k3=2.0, force_offset=0.1),
        actuator=actuator,
    )


def controls(n, phase=0.0):
    t = 1e-3 * np.arange(n)
    return (2 * np.sin(9 * t + phase) + np.sin(31 * t))[:, None]


def drive(model, data, sequence):
    for u in sequence:
        data.ctrl[:] = u
        mujoco.mj_step(model, data)


@pytest.fixture(params=ACTUATORS)
def rig(request):
    return compiled(rich(request.param))


def test_copies_and_snapshots_go_on_exactly(rig):
    model, data = rig
    drive(model, data, controls(321))
    check_copies_go_on_exactly(model, data, lambda d: drive(model, d, controls(300, 1.0)))


def test_copy_between_the_stages_of_a_step_goes_on_exactly(rig):
    model, data = rig
    drive(model, data, controls(100))
    check_copy_between_stages(model, data)


def test_forward_is_pure_from_every_stage(rig):
    """Finite differences call the stages again from the velocity or the position on."""
    model, data = rig
    drive(model, data, controls(77))
    mujoco.mj_forward(model, data)
    state, force = data.plugin_state.copy(), data.qfrc_passive.copy()
    qacc, act = data.qacc.copy(), data.actuator_force.copy()
    for stage in (mujoco.mjtStage.mjSTAGE_NONE, mujoco.mjtStage.mjSTAGE_POS):
        for _ in range(3):
            mujoco.mj_forwardSkip(model, data, stage, 0)
        np.testing.assert_array_equal(data.qacc, qacc)
    for _ in range(3):
        mujoco.mj_forwardSkip(model, data, mujoco.mjtStage.mjSTAGE_VEL, 0)
    np.testing.assert_array_equal(data.plugin_state, state)
    np.testing.assert_array_equal(data.actuator_force, act)
    np.testing.assert_allclose(data.qfrc_passive, force, rtol=1e-12)
    np.testing.assert_allclose(data.qacc, qacc, rtol=1e-12)


def test_reset_restores_the_configured_parameters(rig):
    model, data = rig
    fresh = data.plugin_state.copy()
    drive(model, data, controls(50))
    Slots(model, data, "play")["width"] = 0.1
    assert not np.array_equal(data.plugin_state, fresh)
    mujoco.mj_resetData(model, data)
    np.testing.assert_array_equal(data.plugin_state, fresh)


@pytest.mark.parametrize("threads", [1, 2])
def test_rollout_on_threads_equals_single_steps(rig, threads):
    model, data = rig
    starts, sequences, ends = [], [], []
    for i in range(6):
        mujoco.mj_resetData(model, data)
        Slots(model, data, "play")["width"] = 0.01 * i
        Slots(model, data, "path")["delay"] = 0.005 * i
        Slots(model, data, "friction")["viscous_difference"] = 0.1 * i
        starts.append(full_physics(model, data))
        sequences.append(controls(200, i))
        drive(model, data, sequences[-1])
        ends.append(full_physics(model, data))
    np.testing.assert_array_equal(rolled_out(model, starts, sequences, threads), ends)
