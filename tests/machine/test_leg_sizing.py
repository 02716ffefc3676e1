"""Cylinder sizes of the leg: resonance against the step, force and speed against the tasks."""

import mujoco
import numpy as np
import pytest
from leg_design import (
    JOINTS,
    USUAL,
    CylinderSize,
    cylinders,
    inverse_mass,
    lever_rows,
    load_with_motors,
    place,
    resonance,
    squat,
    stride,
    walk,
)


@pytest.fixture(scope="module")
def leg() -> mujoco.MjModel:
    return load_with_motors("leg")


def test_formulas_agree_with_the_conformance_cylinder():
    """Cases a, b and c of docs/concepts/physics.md: 16/10 x 80 mm, 7.5 l/min, x = 40 mm."""
    cylinder = CylinderSize(
        bore=0.016,
        rod=0.010,
        stroke=0.080,
        mid_length=0.3,
        dead_volume_a=2.903e-6,
        dead_volume_b=1.676e-6,
        rated_flow=1.25e-4,
        viscous=0.0,
        coulomb=0.0,
        sigma_0=0.0,
    )
    assert cylinder.areas == pytest.approx((2.0106e-4, 1.2252e-4), rel=1e-4)
    assert cylinder.stiffness(0.3) == pytest.approx(8.37e6, rel=1e-3)
    assert np.sqrt(cylinder.stiffness(0.3) / 20) == pytest.approx(646.77, rel=1e-4)
    assert cylinder.speed(0.0, 1) == pytest.approx(1.2004, rel=1e-3)
    assert cylinder.speed(0.0, -1) == pytest.approx(0.9370, rel=1e-3)
    assert 0.5 * cylinder.speed(2000.0, 1) == pytest.approx(0.3691, rel=5e-3)
    assert cylinder.speed(3217.5, 1) == 0.0


@pytest.mark.parametrize("name", ["leg", "leg_rail"])
@pytest.mark.parametrize("span", ["usual", "joint range"])
def test_hydraulic_resonance_fits_the_step(name, span):
    """w_h h of each cylinder alone, and of all six locked together."""
    model = load_with_motors(name)
    everywhere = np.array([model.joint(j).range for j in JOINTS])
    alone, stuck, coupled = resonance(model, USUAL if span == "usual" else everywhere, 600)
    bound = 0.7 if span == "usual" else 1.0
    assert max(alone.max(), coupled) <= bound
    assert stuck.max() <= 1.0


def test_effective_mass(leg):
    """Inertia about the knee by the parallel axis theorem; J M^-1 J^T by a dense inverse."""
    data = mujoco.MjData(leg)
    place(leg, data, np.zeros(6))
    knee = leg.joint("knee").dofadr[0]
    mass = np.zeros((leg.nv, leg.nv))
    mujoco.mj_fullM(leg, data, mass)
    lever = lever_rows(leg, data)[JOINTS.index("knee"), knee]
    bodies = ((3.2, 0.1934, 0.0375), (0.25, 0.436, 0.00022), (1.0, 0.480, 0.0044))
    inertia = sum(m * d**2 + i for m, d, i in bodies) + 1.0 * 0.046**2 + 0.25 * 0.006**2
    assert mass[knee, knee] == pytest.approx(inertia + 0.004, rel=1e-3)
    full = inverse_mass(leg, data)
    levers = lever_rows(leg, data)
    np.testing.assert_allclose(full, levers @ np.linalg.inv(mass) @ levers.T, rtol=1e-8)
    # The free neighbours make the knee lighter than the locked leg would.
    assert full[JOINTS.index("knee"), JOINTS.index("knee")] > lever**2 / mass[knee, knee]


def test_single_leg_squat_is_within_160_bar(leg):
    """Static hold at 1.4 rad knee flexion, weight under the hip or anywhere from heel to ball."""
    assert leg.key("squat").qpos[JOINTS.index("knee")] == 1.4
    assert 9.81 * leg.body_mass.sum() > 9.81 * (30 + 14.8)
    for ahead in np.linspace(-0.045, 0.12, 12):
        tau, margin = squat(leg, ahead)
        assert margin.min() >= 1.3, (ahead, tau)
        assert tau[JOINTS.index("knee")] < -40.0  # the knee does carry the weight


def test_walking_stride_is_within_force_and_speed(leg):
    """One stride a second with the knee up to 1.05 rad, friction included, margin 1.3."""
    angle, speed, _ = stride(np.linspace(0.0, 1.0, 500))
    assert 1.0 <= angle[:, JOINTS.index("knee")].max() <= 1.1
    assert 5.0 <= abs(speed[:, JOINTS.index("knee")]).max() <= 6.5
    _, margin, flow = walk(leg, 500)
    assert margin.min() >= 1.3
    assert flow.max() < 1.5e-4  # the pump alone, parts/cylinders.xml


def test_motor_gear_is_the_push_at_160_bar():
    model = load_with_motors("leg_motor")
    for joint, size in cylinders().items():
        push = 16e6 * size.areas[0]
        assert model.actuator(f"{joint}_valve").gear[0] == pytest.approx(push, rel=1e-3)
