"""The compiled hydraulics core against the NumPy oracle and closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from leglab.base.errors import LeglabError
from leglab.machine.cylinder import CONTINUOUS_STATES, Cylinder
from leglab.machine.parameters import plugin_tables
from tests.reference import hydraulics_oracle as oracle

SIZE = {"bore": 0.016, "rod": 0.010, "stroke": 0.080}


def values(cylinder):
    table = plugin_tables()["leglab.cylinder"].parameters
    return {name: cylinder.vector[row.offset] for name, row in table.items()}


def random_case(rng):
    def span(low, high):
        return rng.uniform(low, high)

    parameters = {
        "bore": span(0.012, 0.03),
        "rod": span(0.004, 0.011),
        "stroke": span(0.05, 0.2),
        "dead_volume_a": span(1e-6, 5e-6),
        "dead_volume_b": span(1e-6, 5e-6),
        "internal_leakage": 10 ** span(-14, -11),
        "external_leakage_a": 10 ** span(-15, -12),
        "external_leakage_b": 10 ** span(-15, -12),
        "seal_clearance": span(0.5, 4),
        "oil_temperature": span(-20, 90),
        "viscous": span(100, 2000),
        "coulomb": span(1, 200),
        "static": span(200, 400),
        "stribeck_velocity": span(0.005, 0.1),
        "stribeck_exponent": rng.choice([2.0, span(0.5, 4)]),
        "viscous_difference": rng.choice([0.0, span(-200, 200)]),
        "coulomb_difference": rng.choice([0.0, span(-300, 300)]),
        "pressure_coefficient": span(0, 1e-5),
        "rated_flow": 10 ** span(-5, -3),
        "flow_asymmetry": span(-0.5, 0.5),
        "bandwidth_hz": span(20, 400),
        "damping_ratio": span(0.3, 2),
        "lap": span(-0.05, 0.05),
        "lap_difference_tank": rng.choice([0.0, span(-0.02, 0.02)]),
        "lap_difference_chambers": rng.choice([0.0, span(-0.02, 0.02)]),
        "edge_rounding": span(0, 0.05),
        "edge_exponent": rng.choice([2.0, span(1.05, 8)]),
        "null_bias": span(-0.1, 0.1),
        "laminar_transition_pressure": 10 ** span(4, 6),
        "supply_pressure": span(5e6, 25e6),
        "tank_pressure": span(0, 1e6),
        "bulk_modulus": span(0.7e9, 2e9),
        "entrained_air": rng.choice([0.0, span(0, 0.05)]),
        "polytropic_index": span(1, 1.6),
        "sigma_0": rng.choice([0.0, 10 ** span(4, 7)]),
    }
    x = span(-0.002, parameters["stroke"] + 0.002)
    state = [
        x,
        rng.normal() * 10 ** span(-5, 0.5),
        span(-1.2, 1.2),
        rng.normal() * 500,
        span(-1.3e5, 25e6),
        span(-1.3e5, 25e6),
        rng.normal() * 1e-4,
    ]
    inputs = {
        "command": span(-1.5, 1.5),
        "mass": 10 ** span(-1, 2),
        "load": rng.normal() * 1000,
        "blocked": bool(rng.integers(4) == 0),
    }
    return parameters, np.array(state + [0.0] * 6), inputs


@pytest.mark.parametrize("seed", range(200))
def test_derivative_equals_the_oracle(seed):
    parameters, state, inputs = random_case(np.random.default_rng(seed))
    cylinder = Cylinder(parameters)
    got = cylinder.derivative(state, **inputs)
    wanted, size = oracle.derivative(
        values(cylinder), state, supply_pressure=cylinder.supply_pressure, **inputs
    )
    # Each term carries a few roundings; the exponentials of D341 magnify theirs some ten times.
    np.testing.assert_array_less(np.abs(got - wanted), 1e-12 * size + 1e-300)


@pytest.mark.parametrize(("nu_40", "nu_100"), [(32e-6, 5.4e-6), (46e-6, 6.8e-6), (68e-6, 8.7e-6)])
def test_viscosity_follows_d341_and_meets_its_two_points(nu_40, nu_100):
    native = Cylinder({**SIZE, "viscosity_40": nu_40, "viscosity_100": nu_100}).native
    assert native.kinematic_viscosity(40.0) == pytest.approx(nu_40, rel=1e-12)
    assert native.kinematic_viscosity(100.0) == pytest.approx(nu_100, rel=1e-12)
    for celsius in np.linspace(-30, 120, 31):
        wanted = oracle.kinematic_viscosity(celsius, nu_40, nu_100)
        assert native.kinematic_viscosity(celsius) == pytest.approx(wanted, rel=1e-12)


def test_leakage_grows_with_the_cube_of_the_clearance_and_with_thin_oil():
    base = Cylinder({**SIZE}).native.condition()
    worn = Cylinder({**SIZE, "seal_clearance": 2.0}).native.condition()
    assert worn[0] == pytest.approx(8 * base[0], rel=1e-14)
    assert worn[3] == base[3]
    cold = Cylinder({**SIZE, "oil_temperature": 0.0})
    leak, _, _, viscous = cold.native.condition()
    ratio = oracle.leakages(values(cold))[0] / 1.7e-13
    assert leak / base[0] == pytest.approx(ratio, rel=1e-12)
    assert viscous / base[3] == pytest.approx(1 / ratio, rel=1e-12)


@given(
    air=st.sampled_from([0.0, 1e-4, 0.005, 0.03, 0.2]),
    index=st.floats(1.0, 1.6),
    modulus=st.floats(5e8, 3e9),
    gauge=st.floats(-0.9 * oracle.ATMOSPHERE, 6e7),
    guess=st.floats(-0.9 * oracle.ATMOSPHERE, 6e7),
)
@settings(max_examples=400, deadline=None)
def test_pressure_inverts_the_relative_volume(air, index, modulus, gauge, guess):
    native = Cylinder(
        {**SIZE, "entrained_air": air, "polytropic_index": index, "bulk_modulus": modulus}
    ).native
    w = native.relative_volume(gauge)
    assert w == pytest.approx(oracle.relative_volume(gauge, air, index, modulus), rel=1e-14)
    beta = oracle.bulk_modulus(gauge, air, index, modulus)
    assert native.bulk_modulus(gauge) == pytest.approx(beta, rel=1e-12)
    # A rounding of w by 1e-16 is one of 1e-16 beta in the pressure.
    assert native.pressure_at(w, guess) == pytest.approx(gauge, abs=5e-15 * beta + 1e-8)


def test_pressure_never_falls_below_the_vapour_floor():
    native = Cylinder(SIZE).native
    assert native.pressure_at(50.0, 0.0) == pytest.approx(oracle.FLOOR - oracle.ATMOSPHERE)


def test_bristle_before_sliding_follows_its_closed_form():
    """With v > 0 slow, z' = v (1 - sigma_0 z / F_s): z = F_s/sigma_0 (1 - exp(-sigma_0 x/F_s))."""
    cylinder = Cylinder({**SIZE, "sigma_0": 2e6, "coulomb": 100.0, "static": 150.0})
    v, duration = 1e-6, 60.0
    solution = solve_ivp(
        lambda _, y: cylinder.derivative(
            cylinder.initial_state(velocity=v, bristle=y[0]), command=0.0
        )[6:7],
        (0, duration),
        [0.0],
        rtol=1e-11,
        atol=1e-18,
    )
    level = 100.0 + 50.0 * math.exp(-((v / 0.014) ** 2))
    wanted = level / 2e6 * (1 - math.exp(-2e6 * v * duration / level))
    assert solution.y[0, -1] == pytest.approx(wanted, rel=1e-8)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rod": 0.016}, ["rod", "0.016", "less than bore"]),
        ({"viscous_difference": -1500.0}, ["viscous_difference", "-1500", "2 viscous = 1400"]),
        ({"static": 50.0}, ["static", "50", "at least coulomb"]),
        ({"viscosity_100": 1e-4}, ["viscosity_100", "0.0001", "less than viscosity_40"]),
        ({"substeps": 2.5}, ["substeps", "2.5", "whole number"]),
        ({"dead_volume_a": 0.0}, ["dead_volume_a", "= 0", "(0, 0.01] m^3"]),
        ({"supply_pressure": -1e5}, ["supply_pressure", "-100000", "[0, 1e+08] Pa"]),
        ({"internal_leakage": math.nan}, ["internal_leakage", "nan", "[0, 1e-09]"]),
        ({"boore": 0.016}, ["boore", "did you mean 'bore'"]),
    ],
)
def test_bad_parameters_name_what_is_allowed(change, words):
    with pytest.raises(LeglabError) as caught:
        Cylinder({**SIZE, **change})
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words), message


def test_state_names_match_the_derivative():
    assert len(CONTINUOUS_STATES) == 13
    with pytest.raises(ValueError, match="13"):
        Cylinder(SIZE).derivative(np.zeros(5), command=0.0)
