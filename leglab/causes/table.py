"""The table of causes: a new cause is a row, plus a function in `changes` if its changes are new.

Magnitudes are steps from the model's healthy value (`record`). Sources of values without a source
in this file are in the plugins' tables, docs/reference/parameters.md.
"""

from functools import partial

from leglab.causes import changes
from leglab.causes.record import Cause, EffectRow, Side, Trials, plus

_HYQ = "HyQ leg parameters (Ledezma 2016)"
_VALVE = "tolerances of small servovalves (type 30 data sheets)"
_GAPS = ("internal_leakage", "external_leakage_a", "external_leakage_b")

_oil = partial(EffectRow, group="oil and seals")
_friction = partial(EffectRow, group="friction")
_valve = partial(EffectRow, group="valve and command")
_added = partial(Trials, step=plus)

CAUSES: dict[str, Cause] = {}


def add_cause(cause: Cause) -> None:
    """Adds a row to the table."""
    CAUSES[cause.name] = cause


for _row in (
    Cause(  # Leakage grows with the cube of the clearance: x10 is 2.15 times the clearance.
        "seal_wear", "all piston seals leak ten times as much from half time on",
        effect="internal_leakage", parameters=("internal_leakage",), per_joint=True,
        meaning="internal leakage ratio", default=10.0, allowed=(1.0, 1000.0),
        sides=(Side((3.0, 10.0, 25.0), (5.0, 15.0, 40.0)),),
        effects=(_oil(
            "internal_leakage",
            (Trials("internal_leakage", (3.0, 10.0, 35.0), tolerance=0.15, upper=300.0,
                    faults="above"),),
            physics="Flow past the piston seal, C_i (p_A - p_B); grows with the cube of the "
            "clearance.",
            source=f"{_HYQ}; seal wear up to x50",
            excitation="a pressure difference across the piston while the valve opens little",
        ),),
    ),
    Cause(  # 5e-13 is 0.24 l/min per chamber at 80 bar, the highest published detection limit.
        "external_leak", "all rod and piston seals leak to the outside from half time on",
        effect="external_leakage", parameters=("external_leakage_a", "external_leakage_b"),
        per_joint=True, meaning="external leakage of each chamber [m^3/s/Pa]",
        healthy="external_leakage_a", step=plus, default=5e-13, allowed=(-1.0, 1e-10),
        sides=(Side((2e-13, 5e-13, 1e-12), (3e-13, 7e-13, 1.5e-12)),),
        effects=(_oil(
            "external_leakage",
            (_added("external_leakage_a", (2e-13, 1.5e-12), upper=3e-11),
             _added("external_leakage_b", (2e-13, 1.5e-12), upper=3e-11)),
            physics="Flow from the chambers to the outside, C_e p: rod seal, fittings, hoses.",
            source="ASME FPMC 2014: detectable at 0.07 to 0.25 l/min",
            excitation="chamber pressures well above the tank's",
        ),),
    ),
    Cause(  # For example swollen seals.
        "friction_rise", "three times the friction from half time on",
        effect="coulomb_friction and viscous_friction", parameters=("coulomb", "static", "viscous"),
        optional=True, per_joint=True, meaning="friction ratio", default=3.0, allowed=(0.0, 20.0),
        sides=(Side((2.0, 3.0, 5.0), (2.5, 4.0, 7.0)),),
        effects=(_friction(
            "viscous_friction", (Trials("viscous", (0.3, 2.0, 5.0), tolerance=0.06, upper=30.0),),
            physics="b v, of the oil film under the seals.", source=_HYQ, excitation="fast sliding",
        ),),
    ),
    Cause(
        "stiction", "four times the breakaway friction from half time on", effect="stiction",
        parameters=("static",), per_joint=True, meaning="breakaway friction ratio", default=4.0,
        allowed=(1.0, 20.0), sides=(Side((2.5, 4.0, 7.0), (3.0, 5.5, 9.0)),),
        effects=(_friction(
            "stiction",
            (Trials("static", (1.6, 3.0, 5.0), lower=0.67, upper=30.0),
             Trials("stribeck_velocity", (), lower=0.25, upper=4.0, role="shape"),
             Trials("stribeck_exponent", (), lower=0.25, upper=2.0, role="shape")),
            physics="(F_s - F_c) exp(-|v/v_s|^n): breakaway above Coulomb friction.",
            source=f"{_HYQ}; exponents from 0.5 to above 2 (Armstrong-Helouvry et al. 1994, sect. "
            "2.1.3)",
            excitation="slow motion and standstill",
        ),),
    ),
    Cause(  # k_1 and k_2 of Eq. 23 of Folgheraiter.
        "spring_fatigue", "the parallel springs lose half of their stiffness at half time",
        effect="spring_stiffness", parameters=("k1", "k2"), optional=True, per_joint=True,
        meaning="stiffness ratio", default=0.5, allowed=(0.0, 1.0),
        sides=(Side((0.7, 0.4, 0.1), (0.55, 0.25, 0.05)),),
    ),
    Cause(  # A new small servovalve has less than 3 % of hysteresis.
        "valve_wear", "dead band and hysteresis of all valves grow at half time",
        effect="valve_deadband and valve_hysteresis", parameters=("lap", "hysteresis"),
        per_joint=True, meaning="lap and hysteresis, of full spool travel", healthy="hysteresis",
        step=plus, default=0.06, allowed=(-1.0, 0.3),
        sides=(Side((0.03, 0.06, 0.1), (0.045, 0.08, 0.12)),), changes=changes.worn_valve,
    ),
    Cause(  # New servovalves stay within 2 % over temperature and supply pressure.
        "valve_null_shift", "the null of all valves shifts at half time", effect="valve_bias",
        parameters=("null_bias",), per_joint=True, meaning="null shift, of full command",
        healthy="null_bias", step=plus, default=0.03, allowed=(-0.3, 0.3),
        sides=(
            Side((0.02, 0.05), (0.01, 0.035, 0.06)), Side((-0.02, -0.05), (-0.01, -0.035, -0.06)),
        ),
        effects=(_valve(
            "valve_bias",
            (_added("null_bias", (-0.04, -0.012, 0.012, 0.04), tolerance=0.002, lower=-0.3,
                    upper=0.3),),
            physics="Null shift: the spool stands at u + bias.",
            source=f"{_VALVE}: null shift within 2 %",
            excitation="any motion; small openings show it best",
        ),),
    ),
    Cause(  # For example a clogged pilot stage.
        "slow_valve", "the spools follow with a sixth of their bandwidth from half time on",
        effect="valve_bandwidth", parameters=("bandwidth_hz",), per_joint=True,
        meaning="natural frequency of the spools [Hz]", healthy="bandwidth_hz", default=0.16,
        allowed=(0.02, 1.0), sides=(Side((0.4, 0.24, 0.16, 0.1), (0.3, 0.2, 0.08)),),
        trials=(
            Trials("bandwidth_hz", (0.05, 0.12, 0.35), lower=0.015, upper=2.0, faults="below",
                   inverse=True),
            # A large damping ratio makes the spool a first-order lag.
            Trials("damping_ratio", (), lower=0.5, upper=8.0, role="shape"),
        ),
    ),
    Cause(  # Well-kept systems have 0.5 to 2 %; a low tank or a leaking suction line lets in more.
        "air_in_oil", "4.5 % more air in the oil from half time on", effect="entrained_air",
        parameters=("entrained_air",), per_joint=True,
        meaning="volume fraction of entrained air at atmospheric pressure", healthy="entrained_air",
        step=plus, default=0.045, allowed=(-1.0, 0.295),
        sides=(Side((0.045, 0.145), (0.02, 0.095, 0.195)),),
        effects=(_oil(
            "entrained_air",
            (Trials("entrained_air", (0.3, 3.0, 10.0), tolerance=0.2, upper=40.0, faults="above"),),
            physics="Air in the oil makes it soft at low pressure: "
            "beta = (g + l)/(g/(n p) + l/beta_l).",
            source="docs/concepts/physics.md; 0.5 % is normal, foaming oil holds several per cent",
            excitation="pressures that change quickly",
        ),),
    ),
    Cause(  # A step, to compare before and after; a real machine takes minutes to warm up.
        "hot_oil", "oil 40 °C hotter from half time on", effect="oil_viscosity",
        condition="oil_temperature", parameters=("oil_temperature",),
        meaning="oil temperature [°C]", healthy="oil_temperature", step=plus, default=40.0,
        allowed=(0.0, 80.0), sides=(Side((20.0, 40.0, 60.0), (30.0, 50.0, 70.0)),),
        # Starting at 40 °C, the steps make 9, 3.3, 1.5, 0.65 and 0.38 times the viscosity of VG 46.
        trials=(_added("oil_temperature", (-36.0, -22.0, -8.0, 10.0, 25.0), lower=-20.0,
                       upper=110.0),),
    ),
    Cause(
        "cold_oil", "oil 40 °C colder from half time on", effect="oil_viscosity",
        condition="oil_temperature", parameters=("oil_temperature",),
        meaning="oil temperature [°C]", healthy="oil_temperature", step=plus, default=-40.0,
        allowed=(-50.0, 0.0), sides=(Side((-15.0, -25.0, -33.0, -40.0), (-20.0, -30.0, -45.0)),),
    ),
    Cause(  # A worn pump, or a relief valve set too low.
        "supply_drop", "the pressure of the supply falls by three eighths at half time",
        effect="supply_pressure", parameters=("supply_pressure",), meaning="supply pressure [bar]",
        healthy="supply_pressure", unit=1e5, default=0.625, allowed=(0.125, 1.0),
        sides=(Side((0.8125, 0.65625, 0.5), (0.72, 0.58, 0.45)),),
        effects=(_oil(
            "supply_pressure",
            (Trials("supply_pressure", (0.8, 0.94, 1.1), tolerance=0.01, lower=0.2, upper=1.6),),
            physics="The supply holds another pressure than the model says.",
            source="HyQ class machines run at 160 bar; relief valves drift by some per cent",
            excitation="valve openings in both directions",
        ),),
    ),
    Cause(  # Only models with an accumulator can droop.
        "supply_droop", "fast strides on a pump that gives too little from half time on",
        effect="supply_droop", parameters=("pump_flow", "accumulator_volume"),
        meaning="share of the pump's flow that is left", default=0.5, allowed=(0.0, 1.0),
        sides=(Side((0.7, 0.5, 0.35), (0.6, 0.42, 0.3)),), changes=changes.droop,
        reference_config={"period": 0.9},
    ),
    Cause(  # Added at the centre of mass; 5 kg double the mass of the knee bench's shank.
        "payload", "5 kg more on the shank from half time on", effect="payload",
        parameters=("added_mass",), element="shank", fallback=True, meaning="added mass [kg]",
        step=plus, default=5.0, allowed=(0.0, 50.0),
        sides=(Side((2.5, 5.0, 10.0), (3.5, 7.5, 12.0)),),
    ),
    Cause(
        "valve_deadband", effect="valve_deadband", part_of="valve_wear", parameters=("lap",),
        per_joint=True, meaning="lap ratio", sides=(Side((1.5, 3.0, 5.0), (2.0, 4.0, 6.0)),),
        effects=(_valve(
            "valve_deadband",
            (_added("lap", (-0.03, 0.012, 0.04, 0.09), tolerance=0.004, lower=-0.2, upper=0.4),),
            physics="Overlap of the metering edges: no flow while |x_s| < lap.",
            source=f"{_VALVE}; overlapped spools up to 10 %; edges are ground to 2 um of a stroke "
            "of 0.5 mm",
            excitation="commands through zero",
        ),),
    ),
    Cause(
        "valve_hysteresis", effect="valve_hysteresis", part_of="valve_wear",
        parameters=("hysteresis",), per_joint=True, meaning="hysteresis, of full spool travel",
        healthy="hysteresis", step=plus, sides=(Side((0.03, 0.06, 0.1), (0.045, 0.08, 0.12)),),
        effects=(_valve(
            "valve_hysteresis", (_added("hysteresis", (0.008, 0.03, 0.08), upper=0.5),),
            physics="Play of full width h between command and spool: friction of the spool, magnet "
            "of the motor.",
            source=f"{_VALVE}: hysteresis below 3 %", excitation="commands that reverse",
        ),),
    ),
    Cause(
        "coulomb_friction", effect="coulomb_friction", part_of="friction_rise",
        parameters=("coulomb", "static"), per_joint=True,
        meaning="ratio of Coulomb and breakaway friction",
        sides=(Side((2.0, 3.0, 5.0), (2.5, 4.0, 7.0)),),
        effects=(_friction(
            "coulomb_friction", (Trials("coulomb", (0.3, 2.0, 4.0), tolerance=0.06, upper=30.0),),
            physics="F_c sgn(v); breakaway friction moves along with it.", source=_HYQ,
            excitation="sliding in both directions",
        ),),
    ),
    Cause(
        "chamber_leak", effect="external_leakage", part_of="external_leak",
        parameters=("external_leakage_a", "external_leakage_b"), per_joint=True,
        meaning="external leakage of the cap side, negative of the rod side [m^3/s/Pa]", step=plus,
        sides=(
            Side((5e-13, 1.5e-12, 4.5e-12), (9e-13, 2.5e-12, 6e-12)),
            Side((-5e-13, -1.5e-12, -4.5e-12), (-9e-13, -2.5e-12, -6e-12)),
        ),
        changes=changes.leak_of_one_chamber,
    ),
    Cause(
        "viscosity_change", "oil of another grade from half time on", effect="oil_viscosity",
        parameters=("viscosity_40", "viscosity_100", *_GAPS),
        meaning="ISO viscosity grade [cSt at 40 °C]", healthy="viscosity_40", unit=1e-6,
        step=changes.grades, default=2.0, allowed=(-99.0, 99.0), sides=(Side((), (1.0, 2.0, 4.0)),),
        changes=changes.another_grade,
    ),
    Cause(  # The leakage needs more flow while the supply gives less.
        "seal_wear_supply_drop", "seals leak ten times as much and the supply falls by a quarter",
        effect="internal_leakage and supply_pressure",
        parameters=("internal_leakage", "supply_pressure"), meaning="internal leakage ratio",
        default=10.0, allowed=(1.0, 1000.0), sides=(Side((), (5.0, 15.0, 40.0)),),
        changes=changes.leak_and_drop,
    ),
    Cause(  # Only another sensor could detect it; the tracking error refers to the true position.
        "encoder_shift", "the knee's encoder slips at half time", effect="encoder_offset",
        parameters=("encoder_offset",), element="knee", fallback=True, per_joint=True,
        meaning="slip of the encoder [rad]", step=plus, default=0.03, allowed=(-0.3, 0.3),
    ),
    Cause(  # For example a bad bus connector; readings are lost at random, by the run's seed.
        "sensor_dropout", "the encoders lose a third of their readings from half time on",
        parameters=("encoder_dropout",), per_joint=True, meaning="share of lost readings",
        step=plus, default=0.3, allowed=(0.0, 0.95),
    ),
):  # fmt: skip
    add_cause(_row)


def names(kind: str) -> set[str]:
    """Returns the names of all "scenarios" or "effects" of the table, depending on `kind`."""
    if kind == "scenarios":
        return {cause.name for cause in CAUSES.values() if cause.summary}
    return {name for cause in CAUSES.values() for name in cause.effect.split(" and ") if name}


def effect_of(live: str) -> str:
    """Returns the names of a cause's effects in a diagnosis; empty if they equal the cause's."""
    effect = CAUSES[live].effect if live in CAUSES else ""
    return "" if effect == live else effect


def live_of(effect: str) -> tuple[str, ...]:
    """Returns the names of the causes with this effect; empty if one has the effect's name."""
    names = tuple(cause.name for cause in CAUSES.values() if cause.effect == effect)
    return () if effect in names else names


def kind_of(name: str) -> tuple[str, ...]:
    """Returns the cause of which this one is a part (or itself), and all parts of that cause."""
    whole = CAUSES[name].part_of or name
    return whole, *(cause.name for cause in CAUSES.values() if cause.part_of == whole)
