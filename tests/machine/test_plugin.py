"""The plugins are state and nothing but state: copies, snapshots, threads, run-time parameters."""

import mujoco
import mujoco.batch
import numpy as np
import pytest

from leglab.base.errors import LeglabError
from leglab.machine import plugin
from tests.helpers.native_models import every_plugin
from tests.helpers.plugin_models import (
    FULL,
    Slots,
    check_copies_go_on_exactly,
    check_copy_between_stages,
    compiled,
    full_physics,
    instance,
    rolled_out,
    slides,
    valve,
)

QUANTITIES = (
    "pressure_a pressure_b flow_a flow_b supply_flow spool_position oil_temperature piston_position"
)


def rich_xml(timestep=5e-4):
    """Two cylinders on one supply, wearing and warming, springs, friction, sensors, a keyframe."""
    extension = (
        instance("leglab.supply", "unit", accumulator_volume=4e-5)
        + instance("leglab.spring_damper", "spring", joint="rod", k1=500, k2=100, d1=20)
        + instance(
            "leglab.joint_friction",
            "bearing",
            joint="lower",
            coulomb=5,
            static=8,
            sigma_0=1e5,
            sigma_1=50,
            wear_rate=0.1,
            drift_amplitude=0.2,
            drift_period=1,
        )
    )
    slow = {"thermal_capacity": 100, "seal_wear_rate": 0.1, "hysteresis": 0.02, "supply": "unit"}
    sensor = "".join(
        f'<plugin name="{name}_sensor" plugin="leglab.sensor">'
        f'<config key="actuator" value="{name}"/>'
        f'<config key="quantity" value="{QUANTITIES}"/></plugin>'
        for name in ("first", "second")
    )
    return slides(
        valve("first", **slow) + valve("second", "lower", **slow),
        ("rod", "lower"),
        extension=extension,
        sensor=sensor,
        timestep=timestep,
        extra='<keyframe><key name="home" qpos="0.03 0.05" ctrl="0.1 0"/></keyframe>',
    )


def drive(model, data, steps, phase=0.0):
    for i in range(steps):
        t = i * model.opt.timestep
        data.ctrl[:] = 0.3 * np.sin(20 * t + phase), 0.2 * np.cos(15 * t)
        mujoco.mj_step(model, data)


@pytest.fixture
def rig():
    return compiled(rich_xml())


def test_parameters_are_state_and_act_at_once(rig):
    model, data = rig
    first = Slots(model, data, "first")
    assert first["bore"] == 0.016
    assert first["internal_leakage"] == 1.7e-13
    drive(model, data, 50)
    other = mujoco.MjData(model)
    mujoco.mj_copyData(other, model, data)
    first["viscous"] = 5000.0
    for d in (data, other):
        d.qvel[0] = 0.1
        mujoco.mj_forward(model, d)
    weaker = other.actuator_force[0] - data.actuator_force[0]
    # The end of the step is anticipated: between all and half of b v.
    assert 0.5 * 4300 * 0.1 < weaker < 4300 * 0.1


def test_a_parameter_set_in_the_state_equals_one_in_the_model():
    model, data = compiled(slides(valve("v")))
    worn_model, worn = compiled(slides(valve("v", seal_clearance=3.0, viscous=900.0)))
    slots = Slots(model, data, "v")
    slots["seal_clearance"], slots["viscous"] = 3.0, 900.0
    for i in range(300):
        data.ctrl[0] = worn.ctrl[0] = 0.2 * np.sin(0.02 * i)
        mujoco.mj_step(model, data)
        mujoco.mj_step(worn_model, worn)
    np.testing.assert_array_equal(full_physics(model, data), full_physics(worn_model, worn))


def test_copies_and_snapshots_go_on_exactly(rig):
    model, data = rig
    drive(model, data, 123)
    check_copies_go_on_exactly(model, data, lambda d: drive(model, d, 200, phase=1.0))


def test_copy_between_the_stages_of_a_step_goes_on_exactly(rig):
    model, data = rig
    drive(model, data, 50)
    check_copy_between_stages(model, data)


def test_reset_and_keyframe_restore_the_configured_parameters(rig):
    model, data = rig
    fresh = data.plugin_state.copy()
    drive(model, data, 100)
    assert Slots(model, data, "first")["seal_clearance"] > 1
    mujoco.mj_resetData(model, data)
    np.testing.assert_array_equal(data.plugin_state, fresh)
    drive(model, data, 100)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    np.testing.assert_array_equal(data.plugin_state, fresh)
    np.testing.assert_array_equal(data.qpos, [0.03, 0.05])
    again = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, again, 0)
    for d in (data, again):
        drive(model, d, 100)
    np.testing.assert_array_equal(full_physics(model, data), full_physics(model, again))


def test_forward_is_pure(rig):
    model, data = rig
    drive(model, data, 77)
    mujoco.mj_forward(model, data)
    state, force = data.plugin_state.copy(), data.actuator_force.copy()
    qacc, sensors = data.qacc.copy(), data.sensordata.copy()
    for _ in range(5):
        mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(data.plugin_state, state)
    np.testing.assert_array_equal(data.actuator_force, force)
    np.testing.assert_array_equal(data.sensordata, sensors)
    np.testing.assert_allclose(data.qacc, qacc, rtol=1e-12)


def starts(model, count):
    """Initial full-physics states that differ in leakage, pressure and position."""
    states = []
    for i in range(count):
        data = mujoco.MjData(model)
        Slots(model, data, "first")["seal_clearance"] = 1 + 0.2 * i
        Slots(model, data, "second")["oil_temperature"] = 10.0 * i
        data.qpos[0] += 1e-3 * i
        states.append(full_physics(model, data))
    return np.array(states)


def stepped(model, initial, controls):
    ends = []
    for state, run in zip(initial, controls, strict=True):
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, state, FULL)
        for control in run:
            data.ctrl[:] = control
            mujoco.mj_step(model, data)
        ends.append(full_physics(model, data))
    return np.array(ends)


RUNS, STEPS = 8, 200


def controls():
    t = np.arange(STEPS) * 5e-4
    rows = [[0.3 * np.sin(20 * t + i), 0.2 * np.cos(15 * t)] for i in range(RUNS)]
    return np.array(rows).transpose(0, 2, 1)


@pytest.mark.parametrize("threads", [1, 2])
def test_rollout_on_threads_equals_single_steps(rig, threads):
    model, _ = rig
    initial = starts(model, RUNS)
    found = rolled_out(model, initial, controls(), threads)
    np.testing.assert_array_equal(found, stepped(model, initial, controls()))


@pytest.mark.parametrize("threads", [1, 2])
def test_batch_on_threads_equals_single_steps(rig, threads):
    model, _ = rig
    initial = starts(model, RUNS)
    batch = mujoco.batch.Batch(model, nsim=RUNS, nthread=threads)
    parameters, qpos = batch.bind("plugin_state"), batch.bind("qpos")
    ctrl = batch.bind("ctrl")
    data = mujoco.MjData(model)
    for i in range(RUNS):
        mujoco.mj_setState(model, data, initial[i], FULL)
        parameters[i], qpos[i] = data.plugin_state, data.qpos
    for step in controls().transpose(1, 0, 2):
        ctrl[:] = step
        batch.step()
    wanted = stepped(model, initial, controls())
    for i in range(RUNS):
        mujoco.mj_setState(model, data, wanted[i], FULL)
        np.testing.assert_array_equal(parameters[i], data.plugin_state)
        np.testing.assert_array_equal(qpos[i], data.qpos)


def test_sensors_show_the_states(rig):
    model, data = rig
    drive(model, data, 100)
    mujoco.mj_forward(model, data)
    for name, joint in (("first", 0), ("second", 1)):
        slots = Slots(model, data, name)
        shown = dict(zip(QUANTITIES.split(), data.sensor(f"{name}_sensor").data, strict=True))
        for quantity in QUANTITIES.split()[2:-1]:
            assert shown[quantity] == slots[quantity]
        assert shown["piston_position"] == pytest.approx(data.qpos[joint], abs=1e-15)
        # The state holds the pressures at the end of the step, to the accuracy within a step.
        for quantity in ("pressure_a", "pressure_b"):
            assert shown[quantity] == pytest.approx(slots[quantity], rel=1e-5)


def test_many_instances_are_independent():
    joints = [f"rod{i}" for i in range(12)]
    model, data = compiled(
        slides("".join(valve(f"v{i}", joint) for i, joint in enumerate(joints)), joints)
    )
    one_model, one = compiled(slides(valve("v")))
    for _ in range(200):
        data.ctrl[:] = 0.0
        data.ctrl[7] = one.ctrl[0] = 0.3
        mujoco.mj_step(model, data)
        mujoco.mj_step(one_model, one)
    assert data.qpos[7] == one.qpos[0]
    others = np.delete(data.qpos, 7)
    np.testing.assert_array_equal(others, others[0])
    assert data.qpos[7] > others[0] + 0.01


def test_a_library_that_does_not_load_is_one_line(monkeypatch, tmp_path):
    """As with a MuJoCo that it was not built against."""
    monkeypatch.setattr(plugin, "library_path", lambda: tmp_path / "gone.so")
    with pytest.raises(LeglabError, match=r"do not load with mujoco .*gone\.so") as caught:
        plugin.load_plugin.__wrapped__()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("xml", [rich_xml(), every_plugin()], ids=["cylinders", "native"])
def test_a_saved_model_attached_twice_moves_as_it_did(xml):
    """Names in settings of plugins mean the elements of their own copy, with any prefix."""
    spec = mujoco.MjSpec.from_string(xml)
    spec.compile()
    saved = plugin.to_xml(spec)
    parent = mujoco.MjSpec()
    for option in ("timestep", "integrator", "gravity"):
        setattr(parent.option, option, getattr(spec.option, option))
    for prefix in ("left_", "robot/"):
        child = mujoco.MjSpec.from_string(saved)
        parent.attach(child, prefix=prefix, frame=parent.worldbody.add_frame())
    alone, two = mujoco.MjModel.from_xml_string(xml), parent.compile()
    assert two.nplugin == 2 * alone.nplugin
    found = []
    for model in (alone, two):
        data = mujoco.MjData(model)
        for k in range(300):
            wave = np.sin(0.02 * k + np.arange(alone.nu))
            data.ctrl[:] = np.tile(0.3 * wave, model.nu // alone.nu)
            mujoco.mj_step(model, data)
        found.append(data.qpos.reshape(-1, alone.nq))
    assert np.abs(found[0] - alone.qpos0).max() > 1e-3
    np.testing.assert_allclose(found[1], np.tile(found[0], (2, 1)), atol=1e-12)
    names = plugin.full_names(two)
    assert names
    assert not plugin.full_names(alone)
    assert all(name.startswith(owner[:5]) for (owner, _), name in names.items())
