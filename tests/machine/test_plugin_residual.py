"""Learned residuals against SciPy's B-splines."""

import mujoco
import numpy as np
import pytest
from scipy.interpolate import BSpline

from leglab.base.errors import LeglabError
from leglab.machine import plugin
from leglab.machine.cylinder import Cylinder
from tests.helpers.plugin_models import (
    CYLINDER,
    compiled,
    full_physics,
    instance,
    rolled_out,
    slides,
    valve,
)

H = 5e-4
KNOTS = {
    "position": [-0.1, -0.02, 0.0, 0.05, 0.11],
    "velocity": [-0.5, -0.1, 0.0, 0.1, 0.6],
    "load": [-30.0, 0.0, 40.0],
    "command": [-1.0, 1.0],
}
RNG = np.random.default_rng(3)
WEIGHTS = {name: RNG.normal(0.0, 5.0, len(knots) + 2) for name, knots in KNOTS.items()}


def text(values):
    return " ".join(repr(float(v)) for v in values)


def splines(*names):
    found = {f"{name}_knots": text(KNOTS[name]) for name in names}
    return found | {f"{name}_coefficients": text(WEIGHTS[name]) for name in names}


def oracle(name, x):
    knots = np.array(KNOTS[name])
    clamped = np.concatenate([[knots[0]] * 3, knots, [knots[-1]] * 3])
    return BSpline(clamped, WEIGHTS[name], 3)(np.clip(x, knots[0], knots[-1]))


def mass(*names, actuator=None, **attributes):
    """A mass on a motor with a residual of some variables."""
    if "command" in names:
        actuator = "drive"
    own = instance(
        "leglab.residual", "rest", joint="rod", actuator=actuator, **splines(*names), **attributes
    )
    return slides('<motor name="drive" joint="rod" ctrlrange="-2 2"/>', mass=1.0, extension=own)


def force(model, data, q=0.0, v=0.0, u=0.0):
    data.qpos[0], data.qvel[0], data.ctrl[0] = q, v, u
    mujoco.mj_forward(model, data)
    return data.qfrc_passive[0]


@pytest.mark.parametrize(
    ("name", "argument"), [("position", "q"), ("velocity", "v"), ("command", "u")]
)
def test_a_spline_is_scipys_within_its_knots_and_constant_beyond(name, argument):
    model, data = compiled(mass(name))
    knots = KNOTS[name]
    inputs = np.linspace(2.0 * knots[0], 2.0 * knots[-1], 201)
    inputs = np.concatenate([inputs, knots])
    got = [force(model, data, **{argument: x}) for x in inputs]
    np.testing.assert_allclose(got, oracle(name, inputs), rtol=1e-12, atol=1e-12)
    assert force(model, data, **{argument: 100.0 * knots[-1]}) == pytest.approx(
        WEIGHTS[name][-1], rel=1e-12
    )


def test_the_load_is_the_actuator_force_of_the_step_before():
    model, data = compiled(mass("load"))
    forces = 25.0 * np.sin(np.arange(50)) + 10.0
    model.actuator_ctrlrange[:] = [-100.0, 100.0]
    before = 0.0
    for u in forces:
        data.ctrl[0] = u
        mujoco.mj_step(model, data)
        assert data.qfrc_passive[0] == pytest.approx(float(oracle("load", before)), rel=1e-12)
        before = u


def test_parts_add_up_and_scale_and_bound_act_on_the_sum():
    model, data = compiled(mass("position", "velocity", "command"))
    parts = oracle("position", 0.03), oracle("velocity", 0.2), oracle("command", 0.4)
    total = float(sum(parts))
    assert force(model, data, 0.03, 0.2, 0.4) == pytest.approx(total, rel=1e-12)
    model, data = compiled(mass("position", "velocity", "command", scale=-0.5))
    assert force(model, data, 0.03, 0.2, 0.4) == pytest.approx(-0.5 * total, rel=1e-12)
    model, data = compiled(mass("position", "velocity", "command", bound=0.25))
    assert force(model, data, 0.03, 0.2, 0.4) == pytest.approx(np.sign(total) * 0.25, rel=1e-12)


def test_coefficients_are_state_and_have_names():
    model, data = compiled(mass("position", "velocity"))
    start, table = plugin.elements(model)["rest"]
    place = start + table.entry("velocity_2").offset
    assert data.plugin_state[place] == WEIGHTS["velocity"][2]
    before = force(model, data, 0.03, 0.02)
    data.plugin_state[place] += 1.0
    knots = np.array(KNOTS["velocity"])
    unit = BSpline(np.concatenate([[knots[0]] * 3, knots, [knots[-1]] * 3]), np.eye(7)[2], 3)
    assert force(model, data, 0.03, 0.02) - before == pytest.approx(float(unit(0.02)), rel=1e-9)
    with pytest.raises(LeglabError, match="velocity_7"):
        table.entry("velocity_7")


def test_a_rollout_gives_the_bits_of_single_steps():
    model, data = compiled(mass("position", "velocity", "load", "command"))
    controls = np.sin(np.arange(200.0))[:, None]
    ends = rolled_out(model, [full_physics(model, data)] * 4, [controls] * 4, 2)
    for u in controls:
        data.ctrl[:] = u
        mujoco.mj_step(model, data)
    np.testing.assert_array_equal(ends, [full_physics(model, data)] * 4)


def test_a_cylinder_sees_its_command_with_the_offset():
    """The same spool and pressures as a cylinder whose command carries the offset."""
    weights = text([0.0, 0.1, -0.05, 0.2])
    own = instance(
        "leglab.residual",
        "knee_rest",
        cylinder="knee",
        command_knots="-1 1",
        command_coefficients=weights,
    )
    learned, one = compiled(slides(valve("knee"), extension=own))
    plain, other = compiled(slides(valve("knee")))
    spline = BSpline([-1.0] * 4 + [1.0] * 4, [float(w) for w in weights.split()], 3)
    at, table = plugin.elements(learned)["knee"]
    at_plain, _ = plugin.elements(plain)["knee"]
    names = ("pressure_a", "pressure_b", "spool_position")
    for k in range(400):
        u = 0.6 * np.sin(0.02 * k)
        one.ctrl[0], other.ctrl[0] = u, u + float(spline(u))
        mujoco.mj_step(learned, one)
        mujoco.mj_step(plain, other)
        for name in names:
            offset = table.entry(name).offset
            assert one.plugin_state[at + offset] == pytest.approx(
                other.plugin_state[at_plain + offset], rel=1e-9, abs=1e-9
            )
    assert abs(one.qpos[0] - 0.04) > 1e-3


def test_a_cylinders_load_is_its_force():
    own = instance(
        "leglab.residual",
        "knee_rest",
        cylinder="knee",
        load_knots="-5000 5000",
        load_coefficients="0.5 0.5 0.5 0.5",
    )
    model, data = compiled(slides(valve("knee"), extension=own))
    for _ in range(100):
        mujoco.mj_step(model, data)
    start, table = plugin.elements(model)["knee"]
    # 0.5 of full travel, whatever the load; the spool has long arrived.
    assert data.plugin_state[start + table.entry("spool_position").offset] == pytest.approx(
        0.5, abs=1e-3
    )
    assert Cylinder(CYLINDER).area_a > 0


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"position_knots": "0 1"}, "position_coefficients"),
        ({"position_knots": "0", "position_coefficients": "1 2"}, "fewer than 2"),
        ({"position_knots": "0 0 1", "position_coefficients": "1 2 3 4 5"}, "must increase"),
        ({"position_knots": "0 1", "position_coefficients": "1 2 3"}, "allowed: 4"),
        ({"position_knots": "0 1", "position_coefficients": "1 2 x 4"}, "finite numbers"),
        ({"position_knots": "0 1", "position_coefficients": "1 2 nan 4"}, "finite numbers"),
        ({"command_knots": "0 1", "command_coefficients": "1 2 3 4"}, "actuator"),
        ({"joint": "elbow"}, "elbow"),
        ({"joint": None, "cylinder": "drive"}, "leglab.cylinder"),
        ({"bound": "-1"}, "bound"),
    ],
)
def test_wrong_attributes_are_refused_by_name(attributes, message):
    own = instance("leglab.residual", "rest", **{"joint": "rod", **attributes})
    xml = slides('<motor name="drive" joint="rod"/>', mass=1.0, extension=own)
    with pytest.raises((ValueError, mujoco.FatalError), match=message):
        mujoco.MjData(mujoco.MjModel.from_xml_string(xml))


def test_two_residuals_of_one_cylinder_are_refused():
    own = instance("leglab.residual", "one", cylinder="knee")
    own += instance("leglab.residual", "two", cylinder="knee")
    with pytest.raises((ValueError, mujoco.FatalError), match="has another already"):
        compiled(slides(valve("knee"), extension=own))
