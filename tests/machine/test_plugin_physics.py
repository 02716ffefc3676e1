"""The plugins in MuJoCo against closed forms and native elements."""

import math

import mujoco
import numpy as np
import pytest

from leglab.machine.cylinder import Cylinder
from tests.helpers.plugin_models import CYLINDER, Slots, compiled, instance, slides, valve


def run(model, data, seconds, command):
    for i in range(round(seconds / model.opt.timestep)):
        data.ctrl[:] = command(i * model.opt.timestep) if callable(command) else command
        mujoco.mj_step(model, data)


@pytest.mark.parametrize("timestep", [2.5e-4, 5e-4, 8e-4])
def test_plugin_and_core_take_the_same_steps(timestep):
    model, data = compiled(slides(valve("v"), timestep=timestep))
    commands = 0.2 * np.sin(30 * timestep * np.arange(400))
    states = []
    for u in commands:
        data.ctrl[0] = u
        mujoco.mj_step(model, data)
        slots = Slots(model, data, "v")
        states.append([data.qpos[0], data.qvel[0], slots["pressure_a"], slots["pressure_b"]])
    core = Cylinder({k: v for k, v in CYLINDER.items() if k != "mid_length"}).simulate(
        commands, timestep, mass=20.0, position=0.04, pressure_a=6e6, pressure_b=9.846e6
    )
    np.testing.assert_allclose(states, core[:, :4], rtol=1e-6, atol=1e-8)


def test_hysteresis_is_the_full_width_of_a_play():
    model, data = compiled(slides(valve("v", hysteresis=0.1)))
    slots = Slots(model, data, "v")
    for command, spool in ((0.5, 0.45), (0.45, 0.45), (0.2, 0.25), (0.28, 0.25), (-0.3, -0.25)):
        run(model, data, 0.05, command)
        assert slots["spool_position"] == pytest.approx(spool, abs=1e-6)


@pytest.mark.parametrize("air", [0.0, 0.005])
def test_closed_valve_keeps_the_amounts_of_oil_to_the_last_bit(air):
    closed = {"lap": 0, "edge_rounding": 0, "internal_leakage": 0, "entrained_air": air}
    model, data = compiled(slides(valve("v", **closed), timestep=1e-3))
    data.qvel[0] = 0.3
    slots = Slots(model, data, "v")
    mujoco.mj_step(model, data)
    amounts = slots["amount_a"], slots["amount_b"]
    run(model, data, 5.0, 0.0)
    assert (slots["amount_a"], slots["amount_b"]) == amounts
    assert slots["sliding_distance"] > 1e-3


def test_cavitated_chamber_finds_its_oil_again():
    """Pulled until it boils and let go, the piston returns with the amounts it had."""
    closed = {"lap": 0, "edge_rounding": 0, "internal_leakage": 0, "viscous": 3000}
    model, data = compiled(slides(valve("v", **closed)))
    slots = Slots(model, data, "v")
    run(model, data, 0.5, 0.0)
    amounts, position = (slots["amount_a"], slots["amount_b"]), data.qpos[0]
    data.qfrc_applied[0] = 6000.0
    run(model, data, 0.5, 0.0)
    assert slots["pressure_a"] < -0.8e5  # nothing but expanded air
    data.qfrc_applied[0] = 0.0
    run(model, data, 2.0, 0.0)
    assert (slots["amount_a"], slots["amount_b"]) == amounts
    assert data.qpos[0] == pytest.approx(position, abs=2e-4)


def test_shared_supply_droops_and_recovers():
    """0.04 l at 100 bar gas: the second cylinder feels what the first one draws."""
    unit = instance("leglab.supply", "unit", accumulator_volume=4e-5, pump_flow=5e-5)
    both = valve("one", "rod", supply="unit") + valve("two", "lower", supply="unit")
    model, data = compiled(slides(both, ("rod", "lower"), extension=unit))
    supply, second = Slots(model, data, "unit"), Slots(model, data, "two")
    drawn = [0.0]
    for _ in range(100):
        data.ctrl[:] = 1.0, 0.0
        mujoco.mj_step(model, data)
        flow = sum(Slots(model, data, name)["supply_flow"] for name in ("one", "two"))
        drawn.append(drawn[-1] + flow * model.opt.timestep)
    assert supply["pressure"] < 15.5e6
    assert second["supply_flow"] > 0
    # The unit sees what was drawn over the step before.
    assert supply["delivered"] == pytest.approx(drawn[-2], rel=1e-12)
    run(model, data, 2.0, [0.0, 0.0])
    assert 15.5e6 < supply["pressure"] <= 16e6


def test_supply_pressure_set_at_run_time_stalls_at_its_force():
    model, data = compiled(
        slides(valve("v", supply="unit"), mass=1e12, extension=instance("leglab.supply", "unit"))
    )
    for pressure in (16e6, 8e6):
        Slots(model, data, "unit")["supply_pressure"] = pressure
        run(model, data, 0.5, 0.5)
        assert Slots(model, data, "v")["pressure_a"] == pytest.approx(pressure, rel=5e-3)


@pytest.mark.parametrize("mass", [4.0, 20.0])
def test_cold_oil_keeps_a_light_mass_stable_at_the_right_speed(mass):
    """At 0 degC b grows thirteen times, h b/m = 2.3 for 4 kg: explicit friction would explode."""
    attributes = dict.fromkeys(("oil_temperature", "sigma_0", "sigma_1", "coulomb", "static"), 0)
    attributes |= {"stroke": 0.4, "mid_length": 0.04}
    xml = slides(valve("v", **attributes), mass=mass, timestep=1e-3)
    model, data = compiled(xml)
    assert 1e-3 * 9035 / mass > (2 if mass == 4 else 0.4)
    run(model, data, 0.35, 0.3)
    speeds = []
    for _ in range(50):
        mujoco.mj_step(model, data)
        speeds.append(data.qvel[0])
    cylinder = Cylinder({k: v for k, v in {**CYLINDER, **attributes}.items() if k != "mid_length"})
    steady = cylinder.steady_state(float(np.mean(speeds)), 0.0)
    assert steady.spool == pytest.approx(0.3, rel=2e-3)
    assert np.ptp(speeds) < 2e-3 * np.mean(speeds)


def test_wear_and_temperature_evolve_with_work():
    wearing = {"seal_wear_rate": 0.01, "thermal_capacity": 500.0, "heat_transfer": 2.0}
    model, data = compiled(slides(valve("v", **wearing)))
    slots = Slots(model, data, "v")
    path, last = 0.0, data.qpos[0]
    for i in range(4000):
        data.ctrl[0] = 0.2 * math.sin(20 * i * 5e-4)
        mujoco.mj_step(model, data)
        path += abs(data.qpos[0] - last)
        last = data.qpos[0]
    assert slots["sliding_distance"] == pytest.approx(path, rel=1e-12)
    assert slots["seal_clearance"] == pytest.approx(1 + 0.01 * path, rel=1e-12)
    losses = sum(slots[f"energy_{name}"] for name in ("valve", "leakage", "friction"))
    rise = slots["oil_temperature"] - 40.0
    cooling = 2.0 * 20.0 * 2.0  # h A (T - T_amb) over 2 s, about
    assert rise == pytest.approx((losses - cooling) / 500.0, abs=0.05 * losses / 500.0)


def spring_force(data):
    return data.qfrc_passive[0]


def spring_rig(**attributes):
    extension = instance("leglab.spring_damper", "spring", joint="rod", **attributes)
    return compiled(slides("", extension=extension))


@pytest.mark.parametrize(("q", "v"), [(0.3, 0.0), (-0.7, 2.0), (1.4, -1.0), (0.0, 0.5)])
def test_spring_damper_follows_equation_23(q, v):
    k1, k2, d1, d2, rest = 25.0, 60.0, 0.6, 0.2, 0.1
    model, data = spring_rig(k1=k1, k2=k2, d1=d1, quadratic_damping=d2, rest_position=rest)
    data.qpos[0], data.qvel[0] = q, v
    mujoco.mj_forward(model, data)
    y = q - rest
    wanted = -(k1 * y + k2 * y**3 * math.sin(y) ** 2) - d1 * v - d2 * abs(v) * v
    assert spring_force(data) == pytest.approx(wanted, rel=1e-12)


def test_linear_spring_equals_the_native_one():
    model, data = spring_rig(k1=500.0, d1=3.0, rest_position=0.04)
    native = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="5e-4" gravity="0 0 0" integrator="Euler">
        <flag eulerdamp="disable"/></option><worldbody><body>
        <joint type="slide" axis="1 0 0" stiffness="500" damping="3" ref="0.04"
        springref="0.04"/>
        <inertial pos="0 0 0" mass="20" diaginertia="1 1 1"/></body></worldbody></mujoco>"""
    )
    other = mujoco.MjData(native)
    data.qvel[0] = other.qvel[0] = 0.3
    for _ in range(500):
        mujoco.mj_step(model, data)
        mujoco.mj_step(native, other)
    assert data.qpos[0] == pytest.approx(other.qpos[0], abs=1e-12)


def test_ripple_repeats_with_the_position():
    second = {"ripple_sine_2": 0.7, "ripple_cosine_2": -0.4}
    model, data = spring_rig(ripple_sine=3.0, ripple_cosine=-1.5, ripple_period=0.25, **second)
    for q in (-0.3, 0.0, 0.07, 0.32):
        data.qpos[0] = q
        mujoco.mj_forward(model, data)
        angle = 2 * math.pi * q / 0.25
        wanted = 3.0 * math.sin(angle) - 1.5 * math.cos(angle)
        wanted += 0.7 * math.sin(2 * angle) - 0.4 * math.cos(2 * angle)
        assert spring_force(data) == pytest.approx(wanted, rel=1e-9, abs=1e-12)


def test_stops_push_only_beyond_their_range():
    model, data = spring_rig(stop_lower=0.0, stop_upper=1.0, stop_stiffness=2000.0)
    for q, wanted in ((0.5, 0.0), (-0.01, 20.0), (1.02, -40.0)):
        data.qpos[0] = q
        mujoco.mj_forward(model, data)
        assert spring_force(data) == pytest.approx(wanted, rel=1e-9)


FRICTION = {"coulomb": 8.0, "static": 12.0, "stribeck_velocity": 0.05, "viscous": 3.0}


def friction_at(v, seconds=0.4, start=0.0, **attributes):
    """Friction at an imposed speed: a huge mass keeps it."""
    values = {**FRICTION, "sigma_0": 1e5, "sigma_1": 100.0, **attributes}
    extension = instance("leglab.joint_friction", "f", joint="rod", **values)
    model, data = compiled(slides("", extension=extension, mass=1e12))
    data.time, data.qvel[0] = start, v
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    return -data.qfrc_passive[0], Slots(model, data, "f")


def stribeck_level(v):
    return 8.0 + 4.0 * math.exp(-((v / 0.05) ** 2))


@pytest.mark.parametrize("v", [0.01, 0.05, 0.4, -0.05])
def test_joint_friction_follows_the_stribeck_curve(v):
    force, _ = friction_at(v)
    assert force == pytest.approx(math.copysign(stribeck_level(v), v) + 3.0 * v, rel=1e-6)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 3.0])
def test_joint_friction_falls_by_its_stribeck_exponent(exponent):
    force, _ = friction_at(0.03, stribeck_exponent=exponent)
    level = 8.0 + 4.0 * math.exp(-(0.6**exponent))
    assert force == pytest.approx(level + 3.0 * 0.03, rel=1e-6)


@pytest.mark.parametrize("v", [0.1, -0.1])
def test_joint_friction_depends_on_direction(v):
    force, _ = friction_at(v, direction_asymmetry=0.25)
    side = 1 + math.copysign(0.25, v)
    wanted = side * (math.copysign(stribeck_level(v), v) + 3.0 * v)
    assert force == pytest.approx(wanted, rel=1e-6)


def test_joint_friction_wears_and_drifts():
    force, slots = friction_at(0.1, wear_rate=2.0)
    assert slots["wear"] == pytest.approx(1 + 2.0 * 0.1 * 0.4, rel=1e-9)
    assert force == pytest.approx(slots["wear"] * (stribeck_level(0.1) + 0.3), rel=2e-3)
    force, _ = friction_at(0.1, drift_amplitude=0.5, drift_period=4.0, start=0.6)
    assert force == pytest.approx(1.5 * (stribeck_level(0.1) + 0.3), rel=1e-3)


@pytest.mark.parametrize(
    "attributes",
    [{"wear": 0.0}, {"direction_asymmetry": -1.0}, {"coulomb": 0.0, "static": 0.0, "viscous": 0.0}],
)
def test_vanishing_joint_friction_is_zero_not_nan(attributes):
    force, _ = friction_at(0.1, **attributes)
    assert abs(force) < 1e-6


def test_joint_friction_holds_what_is_below_breakaway():
    extension = instance(
        "leglab.joint_friction", "f", joint="rod", sigma_0=1e5, sigma_1=500.0, **FRICTION
    )
    model, data = compiled(slides("", extension=extension, mass=1.0))
    moves = []
    for force in (7.2, 13.0):
        mujoco.mj_resetData(model, data)
        for i in range(4000):
            data.qfrc_applied[0] = force * min(i / 2000, 1.0)
            mujoco.mj_step(model, data)
        moves.append(data.qpos[0] - 0.04)
    wanted = -12.0 / 1e5 * math.log(1 - 7.2 / 12.0)
    assert moves[0] == pytest.approx(wanted, rel=0.01)
    assert moves[1] > 100 * wanted
