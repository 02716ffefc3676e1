"""Small MJCF models without hydraulics: native actuators, and leglab's plugins beside them."""

import mujoco
import numpy as np

from leglab.machine import plugin
from leglab.machine.parameters import plugin_tables
from tests.helpers.plugin_models import compiled, instance

plugin.load_plugin()

MASS, REACH, INERTIA, GRAVITY = 1.0, 0.3, 0.01, 9.81


def extension(*instances):
    used = "".join(instances)
    names = [name for name in plugin_tables() if f'<plugin plugin="{name}">' not in used]
    return "".join(f'<plugin plugin="{name}"/>' for name in names) + used


def machine(
    body,
    actuator,
    instances,
    timestep=1e-3,
    integrator="implicitfast",
):
    return f"""
      <mujoco>
        <option timestep="{timestep}" integrator="{integrator}"/>
        <extension>{extension(*instances)}</extension>
        <worldbody>{body}</worldbody>
        <actuator>{actuator}</actuator>
      </mujoco>"""


def pendulum(
    *instances,
    actuator='<motor name="drive" joint="hinge"/>',
    joint='armature="0.02" damping="0.1"',
    **options,
):
    """A pendulum that hangs at 0: 0.10 kg m^2 about the hinge without its armature."""
    body = f"""<body name="arm">
          <joint name="hinge" type="hinge" axis="0 1 0" {joint}/>
          <inertial pos="0 0 {-REACH}" mass="{MASS}"
           diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>
        </body>"""
    return machine(body, actuator, instances, **options)


def every_plugin():
    """A pendulum with every plugin that goes with a native actuator."""
    knots = "-1 0 1"
    return pendulum(
        instance("leglab.spring_damper", "hinge_spring", joint="hinge", k1=28, k3=3),
        instance("leglab.command_path", "drive_path", actuator="drive", delay=0.01, bias=0.1),
        instance("leglab.backlash", "hinge_play", joint="hinge", width=0.02, motor_inertia=0.01),
        instance(
            "leglab.residual",
            "hinge_rest",
            joint="hinge",
            position_knots=knots,
            position_coefficients="1 -1 2 -2 1",
        ),
        actuator='<motor name="drive" joint="hinge" gear="3"/>',
    )


def slide(*instances, actuator='<motor name="drive" joint="axis"/>', mass=2.0, joint="", **options):
    """A carriage on a horizontal slide."""
    body = f"""<body name="carriage">
          <joint name="axis" type="slide" axis="1 0 0" {joint}/>
          <inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/>
        </body>"""
    return machine(body, actuator, instances, **options)


def driven(xml, seconds, command, start=0.0, speed=0.0):
    """Time, position, velocity and passive resistance after each step, (4, steps)."""
    model, data = compiled(xml)
    data.qpos[0], data.qvel[0] = start, speed
    h = model.opt.timestep
    rows = []
    for k in range(round(seconds / h)):
        data.ctrl[0] = command(k * h)
        mujoco.mj_step(model, data)
        rows.append([data.time, data.qpos[0], data.qvel[0], -data.qfrc_passive[0]])
    return np.array(rows).T


def friction(joint="axis", **attributes):
    return instance("leglab.joint_friction", "friction", joint=joint, **attributes)


def backlash(joint="hinge", **attributes):
    return instance("leglab.backlash", "play", joint=joint, **attributes)


def command_path(**attributes):
    return instance("leglab.command_path", "path", actuator="drive", **attributes)
