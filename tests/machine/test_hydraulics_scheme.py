"""The fixed-step scheme of the core: convergence, conservation, cavitation, extreme inputs."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from leglab.machine.cylinder import Cylinder
from tests.reference import hydraulics_oracle as oracle

SIZE = {"bore": 0.016, "rod": 0.010, "stroke": 0.080}
# No oil compressed by air, no leak, no friction, edges of an ideal valve.
_NONE = ("lap", "edge_rounding", "entrained_air", "internal_leakage")
_NONE += ("sigma_0", "sigma_1", "viscous", "coulomb", "static")
IDEAL = {**SIZE, **dict.fromkeys(_NONE, 0.0)}


@pytest.mark.parametrize("zeta", [0.2, 0.7, 1.0, 1.8])
@pytest.mark.parametrize("step", [0.25e-3, 1e-3, 20e-3])
def test_spool_moves_by_its_exact_transition(zeta, step):
    bandwidth, command = 250.0, 0.5
    cylinder = Cylinder(
        {**IDEAL, "bandwidth_hz": bandwidth, "damping_ratio": zeta, "substeps": 1.0}
    )
    out = cylinder.simulate(
        np.full(8, command), step, mass=1e9, position=0.04, pressure_a=6e6, pressure_b=9e6
    )
    w = 2 * math.pi * bandwidth
    transition = expm(np.array([[0, 1], [-w * w, -2 * zeta * w]]) * step)
    state, wanted = np.array([-command, 0.0]), []
    for _ in range(8):
        state = transition @ state
        wanted.append(command + state[0])
    np.testing.assert_allclose(out[:, 4], wanted, atol=1e-12)


def test_spool_stays_within_its_stops():
    cylinder = Cylinder({**IDEAL, "damping_ratio": 0.1})
    commands = np.repeat([1.0, -1.0, 1.0], 100)
    out = cylinder.simulate(commands, 1e-4, mass=1e9, position=0.04, pressure_a=6e6, pressure_b=9e6)
    assert np.abs(out[:, 4]).max() == 1.0


EFFECTS = {
    "bare": {},
    "air": {"entrained_air": 0.005},
    "leak": {"internal_leakage": 1.7e-12, "external_leakage_a": 1e-12},
    "viscous": {"viscous": 700.0},
    "bristles": {
        "sigma_0": 2e6,
        "sigma_1": 2e3,
        "coulomb": 100.0,
        "static": 150.0,
        "viscous": 700.0,
    },
    "all": {
        "entrained_air": 0.005,
        "internal_leakage": 1.7e-12,
        "viscous": 700.0,
        "lap": 0.02,
        "edge_rounding": 0.0216,
    },
}


def convergence_errors(parameters, steps):
    """Error of position [m] and pressures [Pa] at the end against Radau, per step size."""
    cylinder = Cylinder(parameters)
    duration, mass = 0.02, 20.0
    start = {"position": 0.03, "pressure_a": 6e6, "pressure_b": 9.8e6}
    size = 1e-11 * np.array([1e-3, 1e-2, 1e-3, 1e-1, 1e4, 1e4, 1e-6] + [1e-3] * 6)
    exact = solve_ivp(
        lambda _, y: cylinder.derivative(y, command=0.3, mass=mass),
        (0.0, duration),
        cylinder.initial_state(**start),
        method="Radau",
        rtol=1e-11,
        atol=size,
    ).y[:, -1]
    errors = []
    for h in steps:
        n = round(duration / h)
        # The scheme's velocity lags half a step: start it where the exact one is at -h/2.
        first = cylinder.derivative(cylinder.initial_state(**start), command=0.3, mass=mass)[1]
        out = cylinder.simulate(
            np.full(n, 0.3), duration / n, mass=mass, velocity=-first * h / 2, **start
        )[-1]
        errors.append(np.abs([out[0] - exact[0], out[2] - exact[4], out[3] - exact[5]]))
    return np.array(errors)


@pytest.mark.parametrize("name", EFFECTS)
def test_scheme_converges_with_order_two(name):
    steps = np.array([1e-4, 5e-5, 2.5e-5])
    errors = convergence_errors({**IDEAL, **EFFECTS[name]}, steps)
    orders = np.log2(errors[:-1] / errors[1:])
    assert np.all(orders[-1] > (1.7 if "sigma_0" in EFFECTS[name] else 1.9)), (orders, errors)


@pytest.mark.parametrize("air", [0.0, 0.005])
def test_closed_valve_conserves_the_oil(air):
    """Both ports blocked, no leak: V_A and V_B hold the same amounts for ever."""
    cylinder = Cylinder({**IDEAL, "entrained_air": air})
    start = {"position": 0.04, "pressure_a": 6e6, "pressure_b": 9.8e6}
    out = cylinder.simulate(np.zeros(20000), 5e-4, mass=20.0, velocity=0.05, **start)
    native = cylinder.native

    def amounts(x, pa, pb):
        volume = native.volumes(x)
        return volume[0] / native.relative_volume(pa), volume[1] / native.relative_volume(pb)

    first = amounts(0.04, 6e6, 9.8e6)
    later = np.array([amounts(*row[[0, 2, 3]]) for row in out[::100]])
    np.testing.assert_allclose(later / first, 1.0, atol=2e-9)


def test_pulled_piston_cavitates_and_refills():
    """A pulled, closed cylinder falls to vapour pressure and finds its oil again."""
    cylinder = Cylinder({**IDEAL, "entrained_air": 0.005, "viscous": 700.0})
    start = {"position": 0.04, "pressure_a": 1e6, "pressure_b": 1.64e6}
    vapour = oracle.FLOOR - oracle.ATMOSPHERE
    pulled = cylinder.simulate(np.zeros(4000), 5e-4, mass=20.0, load=-4000.0, **start)
    assert pulled[:, 2].min() == pytest.approx(vapour, abs=3e4)
    assert pulled[:, 2].min() >= vapour - 1e-6
    assert pulled[-1, 0] > 0.0405
    # Pushed back with balanced forces the same oil gives the same pressures at the same place.
    free = cylinder.simulate(np.zeros(4000), 5e-4, mass=20.0, load=0.0, **start)
    assert free[-1, 2] == pytest.approx(1e6, rel=1e-3)


extreme = st.floats(-1.0, 1.0)


@given(
    commands=st.lists(st.sampled_from([-1.0, -0.3, 0.0, 0.02, 1.0]), min_size=1, max_size=20),
    mass=st.floats(6.0, 1e4),
    load=st.floats(-1e5, 1e5),
    position=st.floats(-0.01, 0.09),
    velocity=st.floats(-20.0, 20.0),
    pressure_a=st.floats(-1e6, 1e8),
    pressure_b=st.floats(-1e6, 1e8),
    temperature=st.floats(-40.0, 150.0),
    leak=st.sampled_from([0.0, 1.7e-13, 1e-11, 1e-9]),
    air=st.sampled_from([0.0, 0.005, 0.5]),
)
@settings(max_examples=300, deadline=None)
def test_extreme_inputs_stay_finite(
    commands, mass, load, position, velocity, pressure_a, pressure_b, temperature, leak, air
):
    cylinder = Cylinder(
        {**SIZE, "oil_temperature": temperature, "internal_leakage": leak, "entrained_air": air}
    )
    start = {"position": position, "velocity": velocity}
    start |= {"pressure_a": pressure_a, "pressure_b": pressure_b}
    out = cylinder.simulate(np.repeat(commands, 25), 2.5e-4, mass=mass, load=load, **start)
    assert np.all(np.isfinite(out))
    assert np.all(out[:, 2:4] >= oracle.FLOOR - oracle.ATMOSPHERE - 1e-6)
    assert np.all(np.abs(out[:, 4]) <= 1.0)


def test_same_inputs_give_the_same_bits():
    commands = np.sin(np.arange(5000) * 0.01)
    start = {"mass": 20.0, "position": 0.04, "pressure_a": 6e6, "pressure_b": 9e6}
    runs = [Cylinder(SIZE).simulate(commands, 5e-4, **start) for _ in range(2)]
    assert runs[0].tobytes() == runs[1].tobytes()
