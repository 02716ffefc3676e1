"""Direction- and load-dependent friction, stiction, and the spring's extras, against scipy."""

import math

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.helpers.native_models import (
    GRAVITY,
    INERTIA,
    MASS,
    REACH,
    driven,
    friction,
    pendulum,
    slide,
)
from tests.helpers.plugin_models import Slots, compiled, instance

BRISTLE = {"sigma_0": 2e4, "sigma_1": 200.0}


def spring(joint="axis", **attributes):
    return instance("leglab.spring_damper", "spring", joint=joint, **attributes)


def carriage(force, seconds, resistance, *, start=(0.0, 0.0), mass=2.0):
    """Position and velocity of a mass by scipy; `resistance(q, v)` is smooth but for v = 0."""

    def rate(t, y):
        return [y[1], (force(t) - resistance(*y)) / mass]

    return solve_ivp(
        rate, (0, seconds), start, rtol=1e-9, atol=1e-11, max_step=1e-3, dense_output=True
    ).sol


def push(t):
    return 20.0 * math.sin(2 * math.pi * t) + 6.0 * math.sin(2 * math.pi * 3.1 * t)


def test_viscous_friction_of_two_directions():
    b_up, b_down = 14.0, 6.0
    element = friction(viscous=10.0, viscous_difference=b_up - b_down)
    wanted = carriage(push, 2.0, lambda q, v: (b_up if v > 0 else b_down) * v)
    errors = []
    for h in (1e-3, 2.5e-4):
        t, q, *_ = driven(slide(element, timestep=h), 2.0, push)
        errors.append(np.abs(q - wanted(t)[0]).max())
    assert errors[0] < 5e-3
    assert errors[1] < 0.3 * errors[0]
    # The mean of both would end up elsewhere altogether.
    assert abs(driven(slide(friction(viscous=10.0)), 2.0, push)[1][-1] - wanted(2.0)[0]) > 0.1


def test_one_sided_viscous_friction_beside_native_damping():
    """The plugin's part may be negative in one direction where the joint damps by itself."""
    element = friction(viscous_difference=4.0)
    wanted = carriage(push, 2.0, lambda q, v: (7.0 if v > 0 else 3.0) * v)
    t, q, *_ = driven(slide(element, joint='damping="5"', timestep=2.5e-4), 2.0, push)
    assert np.abs(q - wanted(t)[0]).max() < 2e-3


@pytest.mark.parametrize(("v", "level"), [(0.5, 4.0), (-0.5, -2.0)])
def test_coulomb_friction_of_two_directions(v, level):
    element = friction(coulomb=3.0, static=3.0, coulomb_difference=2.0, **BRISTLE)
    force = driven(slide(element, mass=1e9), 0.5, lambda t: 0.0, speed=v)[3]
    assert force[-1] == pytest.approx(level, rel=1e-6)


def test_coulomb_difference_beyond_the_level_leaves_one_direction_free():
    element = friction(coulomb=1.0, static=1.0, coulomb_difference=3.0, **BRISTLE)
    assert driven(slide(element, mass=1e9), 0.5, lambda t: 0.0, speed=-0.5)[3][-1] == 0.0
    force = driven(slide(element, mass=1e9), 0.5, lambda t: 0.0, speed=0.5)[3]
    assert force[-1] == pytest.approx(2.5, rel=1e-6)


def test_load_coefficients_see_motor_and_gravity():
    """A heavy pendulum keeps its speed; friction is |k_a tau + k_b m g l sin q| after a step."""
    element = friction(
        joint="hinge", actuator_load_coefficient=0.1, bias_load_coefficient=0.3, **BRISTLE
    )
    model, data = compiled(pendulum(element, joint='armature="1e9"'))
    data.qvel[0] = 1.0
    for k in range(1500):
        before = data.qpos[0]
        data.ctrl[0] = 5.0 * math.sin(4e-3 * k)
        mujoco.mj_step(model, data)
        wanted = 0.1 * data.ctrl[0] + 0.3 * MASS * GRAVITY * REACH * math.sin(before)
        assert Slots(model, data, "friction")["load"] == pytest.approx(abs(wanted), abs=1e-9)
    mujoco.mj_forward(model, data)
    assert -data.qfrc_passive[0] == pytest.approx(abs(wanted), rel=0.02)


def test_load_dependent_friction_damps_a_pendulum_as_scipy_says():
    """Swinging under its own weight: friction 0.2 m g l |sin q| against the motion."""
    mu, pull = 0.2, MASS * GRAVITY * REACH
    inertia = INERTIA + MASS * REACH**2

    def rate(t, y):
        friction_now = mu * pull * abs(math.sin(y[0])) * math.tanh(y[1] / 1e-4)
        return [y[1], (-pull * math.sin(y[0]) - friction_now) / inertia]

    wanted = solve_ivp(
        rate, (0, 1.5), [1.2, 0.0], rtol=1e-8, atol=1e-10, max_step=1e-3, dense_output=True
    ).sol
    element = friction(joint="hinge", bias_load_coefficient=mu, sigma_0=2e4, sigma_1=50.0)
    xml = pendulum(element, joint="", timestep=1e-4)
    t, q, *_ = driven(xml, 1.5, lambda t: 0.0, start=1.2)
    assert np.abs(q - wanted(t)[0]).max() < 0.01
    free = driven(pendulum(joint="", timestep=1e-4), 1.5, lambda t: 0.0, start=1.2)[1]
    assert np.abs(free - wanted(t)[0]).max() > 0.3


def test_stick_slip_frequency_of_a_drawn_mass():
    """A spring drawn at constant speed: the mass sticks until the spring pulls F_s."""
    stiffness, speed, coulomb, static = 400.0, 0.01, 2.0, 6.0
    element = friction(coulomb=coulomb, static=static, stribeck_velocity=0.01, **BRISTLE)
    servo = f'<position name="drive" joint="axis" kp="{stiffness}"/>'
    xml = slide(element, actuator=servo, timestep=5e-4)
    t, _, v, _ = driven(xml, 12.0, lambda t: speed * t)
    # A slip moves by 2 (F_s - F_c)/k and lasts half a period of k and m; sticking takes the rest.
    cycle = 2 * (static - coulomb) / stiffness / speed
    starts = t[1:][(v[1:] > 0.05) & (v[:-1] <= 0.05)]
    assert len(starts) >= 4
    assert np.mean(np.diff(starts)) == pytest.approx(cycle, rel=0.1)


@pytest.mark.parametrize("h", [1e-3, 2.5e-4])
def test_hardening_spring_and_offset(h):
    k1, k3, offset = 30.0, 2000.0, 1.5
    element = spring(k1=k1, k3=k3, force_offset=offset)
    wanted = carriage(push, 2.0, lambda q, v: k1 * q + k3 * q**3 - offset)
    t, q, *_ = driven(slide(element, timestep=h), 2.0, push)
    assert np.abs(q - wanted(t)[0]).max() < 6.0 * h


def test_quadratic_damping_stops_as_the_closed_form():
    """M v' = -d |v| v gives v = v0 / (1 + d v0 t / m)."""
    t, _, v, _ = driven(
        slide(spring(quadratic_damping=3.0), timestep=2.5e-4), 2.0, lambda t: 0.0, speed=-2.0
    )
    np.testing.assert_allclose(v, -2.0 / (1 + 3.0 * 2.0 * t / 2.0), rtol=2e-3)


def test_negative_coefficients_weaken_native_ones():
    plain = driven(slide(joint='stiffness="40" damping="3"'), 1.0, push)
    weakened = driven(
        slide(spring(k1=-10.0, d1=-1.0), joint='stiffness="50" damping="4"', timestep=1e-4),
        1.0,
        push,
    )
    assert np.abs(plain[1] - np.interp(plain[0], weakened[0], weakened[1])).max() < 2e-3


@pytest.mark.parametrize("integrator", ["implicitfast", "Euler"])
def test_neutral_elements_change_nothing_to_the_last_bit(integrator):
    plain = driven(slide(integrator=integrator), 1.0, push)
    neutral = driven(slide(friction(**BRISTLE), spring(), integrator=integrator), 1.0, push)
    np.testing.assert_array_equal(plain, neutral)
