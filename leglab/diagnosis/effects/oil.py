"""Oil, seals and supply of a cylinder."""

from leglab.diagnosis.effects.cylinder_parameter import HYQ, Row, define

define(
    "internal_leakage",
    "oil and seals",
    "Flow past the piston seal, C_i (p_A - p_B); grows with the cube of the clearance.",
    f"{HYQ}; seal wear up to x50",
    "pressure difference across the piston at low flow",
    Row(
        name="internal_leakage",
        trials=(3.0, 12.0, 40.0),
        tolerance=0.1,
        lower=0.0,
        upper=200.0,
    ),
)
