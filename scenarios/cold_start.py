"""The machine starts in the cold and warms up by its own losses.

All oil is at 0 °C when the run begins; throttling, leakage and friction heat it, and the
surroundings, as cold as the oil was, cool it. Choices of this project: 250 J/K for 25 cm^3 of oil
(875 kg/m^3, 1900 J/kg/K) and 0.45 kg of steel around it (470 J/kg/K); 5 W/K for what goes to the
air and, with the oil, to the tank.
"""

from leglab.base.errors import SettingsError
from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario

THERMAL_CAPACITY = 250.0  # J/K
HEAT_TRANSFER = 5.0  # W/K


@register_scenario(
    "cold_start",
    summary="a start with oil at 0 °C, which warms up by its own losses",
    duration=60.0,
    severity=Severity(
        meaning="temperature of oil and surroundings at the start [°C]",
        default=0.0,
        lowest=-10.0,
        highest=40.0,
    ),
)
def cold_start(options: Options) -> tuple[ParameterChange, ...]:
    """Sets oil and surroundings of every cylinder to the size at the start.

    Raises:
        LeglabError: A ramp is asked for.
    """
    if options.ramp_duration:
        raise SettingsError("scenario 'cold_start' starts cold, so it has no ramp_duration")
    return tuple(
        ParameterChange(parameter=parameter, kind="set", value=value, start=0.0)
        for parameter, value in (
            ("thermal_capacity", THERMAL_CAPACITY),
            ("heat_transfer", HEAT_TRANSFER),
            ("ambient_temperature", options.severity),
            ("oil_temperature", options.severity),
        )
    )


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("cold_start")
