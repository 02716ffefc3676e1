"""Small MJCF models with leglab's plugins."""

import mujoco
import mujoco.rollout
import numpy as np

from leglab.machine import plugin
from leglab.machine.parameters import plugin_tables

plugin.load_plugin()

CYLINDER = {"bore": 0.016, "rod": 0.010, "stroke": 0.080, "mid_length": 0.040}


def config(values):
    return "".join(
        f'<config key="{key}" value="{value}"/>'
        for key, value in values.items()
        if value is not None
    )


def valve(name, joint="rod", **attributes):
    return (
        f'<plugin name="{name}" plugin="leglab.cylinder" joint="{joint}">'
        f"{config({**CYLINDER, **attributes})}</plugin>"
    )


def instance(plugin_name, name, **attributes):
    return (
        f'<plugin plugin="{plugin_name}"><instance name="{name}">'
        f"{config(attributes)}</instance></plugin>"
    )


def slides(
    actuators,
    joints=("rod",),
    *,
    mass=20.0,
    timestep=5e-4,
    extension="",
    sensor="",
    extra="",
):
    """Masses on slide joints, by default one; qpos is the piston position, 0.04 m at first."""
    bodies = "".join(
        f'<body><joint name="{joint}" type="slide" axis="1 0 0" ref="0.04"/>'
        f'<inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/></body>'
        for joint in joints
    )
    used = [name for name in plugin_tables() if f'<plugin plugin="{name}">' not in extension]
    declared = "".join(f'<plugin plugin="{name}"/>' for name in [*used, "leglab.sensor"])
    return f"""
      <mujoco>
        <option timestep="{timestep}" gravity="0 0 0" integrator="implicitfast"/>
        <extension>{declared}{extension}</extension>
        <worldbody>{bodies}</worldbody>
        <actuator>{actuators}</actuator>
        <sensor>{sensor}</sensor>
        {extra}
      </mujoco>"""


def compiled(xml):
    model = mujoco.MjModel.from_xml_string(xml)
    return model, mujoco.MjData(model)


class Slots:
    """Parameters and states of one plugin instance in an MjData, by name."""

    def __init__(self, model, data, name):
        self.start, self.table = plugin.elements(model)[name]
        self.data = data

    def address(self, name):
        return self.start + self.table.entry(name).offset

    def __getitem__(self, name):
        return self.data.plugin_state[self.address(name)]

    def __setitem__(self, name, value):
        self.data.plugin_state[self.address(name)] = value


FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


def full_physics(model, data):
    state = np.empty(mujoco.mj_stateSize(model, FULL))
    mujoco.mj_getState(model, data, state, FULL)
    return state


def check_copies_go_on_exactly(model, data, drive):
    """Asserts that a copy, and data set to a snapshot, go on as the data; `drive` moves one."""
    snapshot = full_physics(model, data)
    copy, restored = mujoco.MjData(model), mujoco.MjData(model)
    mujoco.mj_copyData(copy, model, data)
    mujoco.mj_setState(model, restored, snapshot, FULL)
    drive(data)
    end, sensors = full_physics(model, data), data.sensordata.copy()
    mujoco.mj_setState(model, data, snapshot, FULL)
    for d in (copy, restored, data):
        drive(d)
        np.testing.assert_array_equal(full_physics(model, d), end)
        np.testing.assert_array_equal(d.sensordata, sensors)


def rolled_out(model, starts, controls, threads):
    """Full-physics states at the ends of rollouts, (runs, size)."""
    data = [mujoco.MjData(model) for _ in range(threads)]
    with mujoco.rollout.Rollout(nthread=0 if threads == 1 else threads) as pool:
        states, _ = pool.rollout(model, data, np.array(starts), np.array(controls))
    return states[:, -1]


def check_copy_between_stages(model, data):
    """Asserts that a copy made after the forward stage integrates to the same state."""
    mujoco.mj_forward(model, data)
    copy = mujoco.MjData(model)
    mujoco.mj_copyData(copy, model, data)
    for d in (data, copy):
        mujoco.mj_implicit(model, d)
    np.testing.assert_array_equal(full_physics(model, data), full_physics(model, copy))
