"""Cases f and f2: viscosity and bulk modulus of the oil."""

from collections.abc import Iterator

from leglab.machine.cylinder import Cylinder
from leglab.studies.verification.experiment import CYLINDER
from leglab.studies.verification.geometry import BULK_MODULUS, walther
from leglab.studies.verification.rows import Row

# Kinematic viscosity [cSt] of VG 46 as physics.md rounds it.
_TABLE = {-10: 1474.0, 0: 577.0, 20: 133.8, 40: 46.0, 60: 20.6, 80: 11.1}
_GRADES = {"VG 32": (32.0, 5.4), "VG 46": (46.0, 6.8), "VG 68": (68.0, 8.7)}
_ATMOSPHERE = 101325.0  # Pa


def viscosity() -> Iterator[Row]:
    """Case f: ASTM D341 for three grades."""
    for grade, (nu_40, nu_100) in _GRADES.items():
        native = Cylinder(
            {**CYLINDER, "viscosity_40": nu_40 * 1e-6, "viscosity_100": nu_100 * 1e-6}
        ).native
        for celsius in (-20, -10, 0, 10, 20, 30, 40, 50, 60, 70, 80, 100):
            yield Row(
                case="f",
                quantity=f"viscosity of {grade} at {celsius} degC",
                solver="core",
                unit="cSt",
                expected=walther(celsius, nu_40, nu_100),
                got=native.kinematic_viscosity(float(celsius)) * 1e6,
                tolerance=1e-9,
            )
    native = Cylinder(CYLINDER).native
    for celsius, rounded in _TABLE.items():
        yield Row(
            case="f",
            quantity=f"VG 46 at {celsius} degC as tabled",
            solver="core",
            unit="cSt",
            expected=rounded,
            got=native.kinematic_viscosity(float(celsius)) * 1e6,
            tolerance=5e-3,
        )


def bulk_modulus(gauge: float, air: float, index: float) -> float:
    """Beta = (g + l)/(g/(n p) + l/beta_l) with l about 1 - x_0 by its own exponential [Pa]."""
    p = gauge + _ATMOSPHERE
    g = air * (_ATMOSPHERE / p) ** (1 / index)
    liquid = (1 - air) * 2.718281828459045 ** (-gauge / BULK_MODULUS)
    return (g + liquid) / (g / (index * p) + liquid / BULK_MODULUS)


def compressibility() -> Iterator[Row]:
    """Case f2: bulk modulus of oil with entrained air."""
    for air in (0.005, 0.01, 0.03):
        for index in (1.0, 1.4):
            native = Cylinder({**CYLINDER, "entrained_air": air, "polytropic_index": index}).native
            for bar in (0, 1, 5, 10, 20, 50, 100, 160, 210):
                yield Row(
                    case="f2",
                    quantity=f"beta at {bar} bar, air {air:.1%}, n = {index:g}",
                    solver="core",
                    unit="Pa",
                    expected=bulk_modulus(bar * 1e5, air, index),
                    got=native.bulk_modulus(bar * 1e5),
                    tolerance=1e-9,
                )
