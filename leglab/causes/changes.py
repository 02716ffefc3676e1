"""Changes of parameters by causes that do more than set or scale their parameters."""

from leglab.base.scenario import Options, ParameterChange
from leglab.causes.record import Cause, model_values

# Viscosity grades of ISO 3448 [cSt at 40 °C].
_GRADES = (10.0, 15.0, 22.0, 32.0, 46.0, 68.0, 100.0, 150.0, 220.0, 320.0, 460.0)


def grades(healthy: float, step: float) -> float:
    """Returns the viscosity `step` ISO grades above the grade nearest to the healthy viscosity."""
    nearest = min(range(len(_GRADES)), key=lambda i: abs(_GRADES[i] - healthy))
    return _GRADES[min(max(nearest + int(step), 0), len(_GRADES) - 1)]


def another_grade(cause: Cause, options: Options) -> tuple[ParameterChange, ...]:
    """Changes the viscosities at 40 and 100 °C, and the friction and leakage that depend on them.

    Viscous friction and leakage of a cylinder refer to the healthy oil at 40 °C. Mineral oils of
    viscosity index 100 follow nu_100 = 6.8 cSt (VG/46)^0.665: 5.3, 8.8, 11.4 and 14.9 cSt for VG
    32, 68, 100 and 150, where makers' tables have 5.4, 8.7, 11.4 and 15.0 cSt.
    """
    grade = options.severity
    ratio = grade / cause.healthy_magnitude(options.healthy)
    first, second, *gaps = cause.parameters
    return (
        options.set(first, cause.unit * grade),
        options.set(second, 6.8e-6 * (grade / 46.0) ** 0.665),
        options.scale("viscous", ratio, "*_valve"),
        *(options.scale(gap, 1 / ratio) for gap in gaps),
    )


def worn_valve(_: Cause, options: Options) -> tuple[ParameterChange, ...]:
    """Sets hysteresis and overlap of the valve to the severity, but keeps an overlap if wider."""
    lap = max(options.severity, *model_values("lap", options.healthy))
    return options.set("lap", lap), options.set("hysteresis", options.severity)


def leak_of_one_chamber(cause: Cause, options: Options) -> tuple[ParameterChange, ...]:
    """Adds external leakage to the cap side or, if the severity is negative, to the rod side."""
    side = cause.parameters[options.severity < 0]
    present = max(model_values(side, options.healthy))
    return (options.set(side, present + abs(options.severity)),)


def droop(_: Cause, options: Options) -> tuple[ParameterChange, ...]:
    """Scales pump flow by the severity and accumulator volume by 1/4, so demand lowers pressure."""
    return options.scale("pump_flow", options.severity), options.scale("accumulator_volume", 0.25)


def leak_and_drop(_: Cause, options: Options) -> tuple[ParameterChange, ...]:
    """Scales the internal leakage by the severity, and the supply pressure by three quarters."""
    leak = options.scale("internal_leakage", options.severity)
    return leak, options.scale("supply_pressure", 0.75)
