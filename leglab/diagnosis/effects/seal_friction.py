"""Seal friction of a cylinder: LuGre, F = sigma_0 z + sigma_1 z' + b v."""

from leglab.diagnosis.effects.base import Group
from leglab.diagnosis.effects.cylinder_parameter import HYQ, Row, define

_GROUP: Group = "friction"

define(
    "viscous_friction",
    _GROUP,
    "b v, of the oil film under the seals.",
    HYQ,
    "fast sliding",
    Row(name="viscous", trials=(0.3, 2.0, 5.0), tolerance=0.06, lower=0.0, upper=30.0),
)

define(
    "coulomb_friction",
    _GROUP,
    "F_c sgn(v); breakaway friction moves along with it.",
    HYQ,
    "sliding in both directions",
    Row(
        name="coulomb",
        trials=(0.3, 2.0, 4.0),
        tolerance=0.06,
        lower=0.0,
        upper=30.0,
        follows=("static",),
    ),
)

define(
    "stiction",
    _GROUP,
    "(F_s - F_c) exp(-(v/v_s)^2): breakaway above Coulomb friction.",
    f"{HYQ}; docs/physics.md",
    "slow motion and standstill",
    Row(name="static", trials=(1.6, 3.0, 5.0), lower=0.67, upper=30.0),
)

define(
    "pressure_dependent_friction",
    _GROUP,
    "k_p (p_A + p_B): seals that are pressed on by the oil.",
    "lip and step seals",
    "sliding at different pressures",
    Row(
        name="pressure_coefficient",
        trials=(2e-6, 1e-5, 3e-5),
        lower=0.0,
        upper=1e-3,
        relative=False,
    ),
)
