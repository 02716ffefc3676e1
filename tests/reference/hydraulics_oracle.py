"""One valve-controlled cylinder in plain NumPy, written from docs/concepts/physics.md.

Every rate is kept as the list of its terms, so that a comparison can be relative to the size of
the terms and not to what their cancellation happens to leave. SI units, pressures gauge.
"""

import math

import numpy as np

ATMOSPHERE = 101325.0  # Pa
FLOOR = 0.02 * ATMOSPHERE  # Pa absolute


def walther(nu_40, nu_100):
    """A and B of ASTM D341, log10 log10(nu + 0.7) = A - B log10 T, nu in cSt, T in K."""
    w = [math.log10(math.log10(nu * 1e6 + 0.7)) for nu in (nu_40, nu_100)]
    t = [math.log10(273.15 + celsius) for celsius in (40.0, 100.0)]
    b = (w[0] - w[1]) / (t[1] - t[0])
    return w[0] + b * t[0], b


def kinematic_viscosity(celsius, nu_40=46e-6, nu_100=6.8e-6):
    """Kinematic viscosity [m^2/s]."""
    a, b = walther(nu_40, nu_100)
    return (10**10 ** (a - b * math.log10(273.15 + celsius)) - 0.7) * 1e-6


def density(celsius, density_15=875.0):
    """Density [kg/m^3], thermal expansion 7e-4 1/K about 15 degC."""
    return density_15 * (1.0 - 7e-4 * (celsius - 15.0))


def relative_volume(gauge, air, index, liquid_modulus):
    """Volume of one atmospheric cubic metre of oil with air under a gauge pressure."""
    p = gauge + ATMOSPHERE
    return air * (ATMOSPHERE / p) ** (1 / index) + (1 - air) * math.exp(
        -(p - ATMOSPHERE) / liquid_modulus
    )


def bulk_modulus(gauge, air, index, liquid_modulus):
    """Beta(p) of oil with entrained air [Pa], pressure floored at 0.02 atmospheres."""
    p = max(gauge + ATMOSPHERE, FLOOR)
    g = air * (ATMOSPHERE / p) ** (1 / index)
    liquid = (1 - air) * math.exp(-(p - ATMOSPHERE) / liquid_modulus)
    return (g + liquid) / (g / (index * p) + liquid / liquid_modulus)


def opening(s, lap, eps, exponent):
    """Relative opening of a metering edge."""
    d = s - lap
    return (d + (abs(d) ** exponent + eps**exponent) ** (1 / exponent)) / 2


def orifice(gain, w, dp, dp_cr):
    """Flow through an edge [m^3/s]."""
    return gain * w * dp / (dp * dp + dp_cr * dp_cr) ** 0.25


def leakages(p):
    """Internal and external leakage coefficients and viscous friction at the oil's state."""
    nu = kinematic_viscosity(p["oil_temperature"], p["viscosity_40"], p["viscosity_100"])
    mu = nu * density(p["oil_temperature"], p["density"])
    mu_40 = p["viscosity_40"] * density(40.0, p["density"])
    gap = p["seal_clearance"] ** 3 * mu_40 / mu
    names = ("internal_leakage", "external_leakage_a", "external_leakage_b")
    return *(p[name] * gap for name in names), p["viscous"] * mu / mu_40


def end_stop(p, x, v):
    """Force of the end stops on the piston, never pulling [N]."""
    k, d = p["stop_stiffness"], p["stop_damping"]
    if x < 0:
        return max(-k * x - d * v, 0.0)
    if x > p["stroke"]:
        return -max(k * (x - p["stroke"]) + d * v, 0.0)
    return 0.0


def terms(p, y, *, command, supply_pressure, mass, load, blocked=False):
    """Terms of every rate of the continuous state, a list of 13 lists, in its order."""
    x, v, spool, spool_velocity, pa, pb, z = y[:7]
    v = 0.0 if blocked else v
    area_a = math.pi / 4 * p["bore"] ** 2
    area_b = math.pi / 4 * (p["bore"] ** 2 - p["rod"] ** 2)
    ps, pt = supply_pressure, p["tank_pressure"]
    ci, cea, ceb, viscous = leakages(p)

    u = min(max(command + p["null_bias"], -1.0), 1.0)
    s = min(max(spool, -1.0), 1.0)
    k = p["rated_flow"] / math.sqrt(p["rated_pressure_drop"] / 2)
    forward = k * (1 + p["flow_asymmetry"])
    backward = k * (1 - p["flow_asymmetry"])
    cr = p["laminar_transition_pressure"]

    def flow(gain, spool, tank, chamber, dp):
        lap = p["lap"] + 0.5 * (
            tank * p["lap_difference_tank"] + chamber * p["lap_difference_chambers"]
        )
        return orifice(gain, opening(spool, lap, p["edge_rounding"], p["edge_exponent"]), dp, cr)

    q_pa = flow(forward, s, -1, 1, ps - pa)
    q_at = flow(backward, -s, 1, 1, pa - pt)
    q_pb = flow(backward, -s, -1, -1, ps - pb)
    q_bt = flow(forward, s, 1, -1, pb - pt)

    volume_a = p["dead_volume_a"] + area_a * x
    volume_b = p["dead_volume_b"] + area_b * (p["stroke"] - x)
    oil = (p["entrained_air"], p["polytropic_index"], p["bulk_modulus"])
    into_a = [q_pa, -q_at, -ci * pa, ci * pb, -cea * pa, -area_a * v]
    into_b = [q_pb, -q_bt, ci * pa, -ci * pb, -ceb * pb, area_b * v]
    rate_a = [bulk_modulus(pa, *oil) / volume_a * q for q in into_a]
    rate_b = [bulk_modulus(pb, *oil) / volume_b * q for q in into_b]

    seal = p["pressure_coefficient"] * (pa + pb)
    side = math.copysign(0.5, v) if v else 0.0
    fc, fs = (max(p[f] + seal + side * p["coulomb_difference"], 0.0) for f in ("coulomb", "static"))
    fall = (abs(v) / p["stribeck_velocity"]) ** p["stribeck_exponent"]
    g = max(fc + (fs - fc) * math.exp(-fall), 1e-9)
    viscous *= 1.0 + side * p["viscous_difference"] / p["viscous"] if p["viscous"] else 1.0
    sigma_0, sigma_1 = p["sigma_0"], p["sigma_1"]
    z_rate = [v, -sigma_0 * abs(v) * z / g] if sigma_0 > 0 else [0.0]
    friction = [sigma_0 * z, *(sigma_1 * r for r in z_rate), viscous * v]
    stop = end_stop(p, x, v)
    force = [pa * area_a, -pb * area_b, *(-f for f in friction), stop]

    omega = 2 * math.pi * p["bandwidth_hz"]
    spool_rate = [spool_velocity]
    spool_acceleration = [
        omega**2 * u,
        -(omega**2) * spool,
        -2 * p["damping_ratio"] * omega * spool_velocity,
    ]
    return [
        [v],
        [0.0] if blocked else [f / mass for f in [*force, -load]],
        spool_rate,
        spool_acceleration,
        rate_a,
        rate_b,
        z_rate,
        [ps * q_pa, ps * q_pb, -pt * q_at, -pt * q_bt],
        [q_pa * (ps - pa), q_at * (pa - pt), q_pb * (ps - pb), q_bt * (pb - pt)],
        [ci * (pa - pb) * pa, -ci * (pa - pb) * pb, cea * pa * pa, ceb * pb * pb],
        [*(f * v for f in friction), -stop * v],
        [*(pa * q for q in into_a), *(pb * q for q in into_b)],
        [f * v for f in force],
    ]


def derivative(p, y, **inputs):
    """Rates of the continuous state and the size of their terms, both of shape (13,)."""
    rows = terms(p, y, **inputs)
    return (
        np.array([math.fsum(row) for row in rows]),
        np.array([math.fsum(map(abs, row)) for row in rows]),
    )
