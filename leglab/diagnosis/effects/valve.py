"""Servovalve of a cylinder."""

from leglab.diagnosis.effects.base import Group
from leglab.diagnosis.effects.cylinder_parameter import VALVE, Row, define

_GROUP: Group = "valve and command"

define(
    "valve_deadband",
    _GROUP,
    "Overlap of the metering edges: no flow while |x_s| < lap.",
    f"{VALVE}; overlapped spools up to 10 %",
    "commands through zero",
    Row(name="lap", trials=(-0.03, 0.012, 0.04, 0.09), lower=-0.2, upper=0.4, relative=False),
)

define(
    "valve_bias",
    _GROUP,
    "Null shift: the spool stands at u + bias.",
    f"{VALVE}: null shift within 2 %",
    "any motion; small openings show it best",
    Row(
        name="null_bias",
        trials=(-0.04, -0.012, 0.012, 0.04),
        tolerance=0.002,
        lower=-0.3,
        upper=0.3,
        relative=False,
    ),
)

define(
    "valve_gain",
    _GROUP,
    "Another flow at the same opening, in both directions: Q_n of the orifice equation.",
    f"{VALVE}: flow within 10 %",
    "large openings",
    Row(name="rated_flow", trials=(0.6, 0.85, 1.15, 1.5), tolerance=0.02, lower=0.2, upper=3.0),
)

define(
    "valve_gain_asymmetry",
    _GROUP,
    "Flow gain 1 + a for positive and 1 - a for negative spool position.",
    f"{VALVE}: symmetry of flow within 10 %",
    "large openings in both directions",
    Row(
        name="flow_asymmetry",
        trials=(-0.25, -0.06, 0.06, 0.25),
        lower=-0.8,
        upper=0.8,
        relative=False,
    ),
)

define(
    "valve_hysteresis",
    _GROUP,
    "Play of full width h between command and spool: friction of the spool, magnet of the motor.",
    f"{VALVE}: hysteresis below 3 %",
    "commands that reverse",
    Row(name="hysteresis", trials=(0.008, 0.03, 0.08), lower=0.0, upper=0.5, relative=False),
)

define(
    "valve_bandwidth",
    _GROUP,
    "A slow spool: x_s'' = w^2 (u - x_s) - 2 zeta w x_s'.",
    "servovalves of the E024 class: 250 Hz; clogged first stages fall to a tenth",
    "commands that change within some hundredths of a second",
    Row(name="bandwidth_hz", trials=(0.05, 0.12, 0.35), lower=0.015, upper=2.0),
)
