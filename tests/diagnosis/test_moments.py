"""Forces at moments of a motion are those that MuJoCo gives, moment by moment, in Python."""

import mujoco
import numpy as np
import pytest

from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.plant.moments import STATE, forces_at


def random_states(model, rng, count):
    """States about those that a reset gives, (count, nstate), and commands."""
    data = mujoco.MjData(model)
    mujoco.mj_resetData(model, data)
    states = np.empty((count, mujoco.mj_stateSize(model, STATE)))
    for row in states:
        data.qpos[:] = model.qpos0 + 0.3 * rng.standard_normal(model.nq)
        data.qvel[:] = rng.standard_normal(model.nv)
        mujoco.mj_getState(model, data, row, STATE)
    return states, 0.3 * rng.standard_normal((count, model.nu))


@pytest.mark.parametrize("name", ["knee_bench", "leg", "leg_motor"])
def test_forces_are_those_of_mujoco_moment_by_moment(name):
    model, rng = Machine(name).base.model, np.random.default_rng(3)
    states, commands = random_states(model, rng, 12)
    accelerations = 5.0 * rng.standard_normal((12, model.nv))
    found = forces_at(model, states, commands, accelerations)
    for i, state in enumerate(states):
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, state, STATE)
        data.ctrl[:] = commands[i]
        mujoco.mj_forward(model, data)
        np.testing.assert_array_equal(found.load[i], data.qfrc_actuator)
        np.testing.assert_array_equal(found.bias[i], data.qfrc_bias)
        np.testing.assert_array_equal(found.length[i], data.actuator_length)
        np.testing.assert_array_equal(found.speed[i], data.actuator_velocity)
        np.testing.assert_array_equal(found.pull[i], data.actuator_force)
        data.qacc[:] = accelerations[i]
        mujoco.mj_inverse(model, data)
        np.testing.assert_array_equal(found.lacking[i], data.qfrc_inverse - data.qfrc_actuator)


def test_a_joint_without_an_acceleration_moves_as_the_model_has_it():
    model, rng = Machine("leg_motor").base.model, np.random.default_rng(4)
    states, commands = random_states(model, rng, 4)
    data, accelerations = mujoco.MjData(model), np.empty((4, model.nv))
    for i, state in enumerate(states):
        mujoco.mj_setState(model, data, state, STATE)
        data.ctrl[:] = commands[i]
        mujoco.mj_forward(model, data)
        accelerations[i] = data.qacc
    whole = forces_at(model, states, commands, accelerations)
    np.testing.assert_allclose(whole.lacking, 0.0, atol=1e-9)
    # With all joints free nothing is lacking; one that is held to another acceleration needs force.
    free = np.full_like(accelerations, np.nan)
    np.testing.assert_allclose(
        forces_at(model, states, commands, free).lacking, whole.lacking, atol=1e-9
    )
    free[:, 0] = accelerations[:, 0] + 1.0
    held = forces_at(model, states, commands, free).lacking
    moved = accelerations + np.eye(model.nv)[0]
    np.testing.assert_allclose(held, forces_at(model, states, commands, moved).lacking, atol=1e-9)
    assert (np.abs(held[:, 0]) > 1e-3).all()


def test_every_moment_stands_for_itself():
    model, rng = Machine("knee_bench").base.model, np.random.default_rng(5)
    states, commands = random_states(model, rng, 6)
    accelerations = rng.standard_normal((6, model.nv))
    whole = forces_at(model, states, commands, accelerations).lacking
    again = forces_at(model, states[::-1], commands[::-1], accelerations[::-1]).lacking
    np.testing.assert_array_equal(whole, again[::-1])


def test_arrays_of_another_size_are_refused():
    model, rng = Machine("knee_bench").base.model, np.random.default_rng(6)
    states, commands = random_states(model, rng, 2)
    with pytest.raises(ValueError, match="different shapes"):
        forces_at(model, states[:, :-1], commands)
    with pytest.raises(ValueError, match="different shapes"):
        forces_at(model, states, commands[:1])
