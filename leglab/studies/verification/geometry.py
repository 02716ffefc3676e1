"""Closed-form quantities of the cylinder of physics.md, computed apart from the core."""

import math

from leglab.studies.verification.experiment import CYLINDER

AREA_A = math.pi / 4 * CYLINDER["bore"] ** 2  # m^2
AREA_ROD = math.pi / 4 * CYLINDER["rod"] ** 2
AREA_B = AREA_A - AREA_ROD
BULK_MODULUS = 1.4e9  # Pa
LEAKAGE = 1.7e-13  # m^3/s/Pa at 40 degC
GAIN = 1.25e-4 / math.sqrt(7e6 / 2)  # m^3/s/sqrt(Pa): K = Q_n / sqrt(dp_n/2) per edge
DEAD_VOLUME_A, DEAD_VOLUME_B = 2.903e-6, 1.676e-6  # m^3


def volumes(position: float) -> tuple[float, float]:
    """Chamber volumes [m^3] at a piston position [m]."""
    return (
        DEAD_VOLUME_A + AREA_A * position,
        DEAD_VOLUME_B + AREA_B * (CYLINDER["stroke"] - position),
    )


def stiffness(position: float) -> float:
    """Hydraulic stiffness with both ports blocked [N/m]."""
    volume_a, volume_b = volumes(position)
    return BULK_MODULUS * (AREA_A**2 / volume_a + AREA_B**2 / volume_b)


def walther(celsius: float, nu_40: float = 46.0, nu_100: float = 6.8) -> float:
    """Kinematic viscosity [cSt] by ASTM D341 through two points."""
    w40, w100 = (math.log10(math.log10(nu + 0.7)) for nu in (nu_40, nu_100))
    t40, t100, t = (math.log10(273.15 + c) for c in (40.0, 100.0, celsius))
    return 10**10 ** (w40 + (w100 - w40) * (t - t40) / (t100 - t40)) - 0.7


def dynamic_viscosity_ratio(celsius: float) -> float:
    """mu(T)/mu(40 degC) of ISO VG 46; the density falls by 7e-4 per K from 15 degC on."""
    density = (1 - 7e-4 * (celsius - 15)) / (1 - 7e-4 * 25)
    return walther(celsius) / walther(40.0) * density
