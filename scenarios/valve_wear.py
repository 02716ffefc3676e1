"""Dirt and wear give all valves a wider dead band and hysteresis from half time on.

A new small servovalve has an overlap of 2 % and less than 3 % of hysteresis
(docs/reference/parameters.md).
"""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "valve_wear",
    summary="dead band and hysteresis of all valves grow at half time",
    severity=Severity(
        meaning="lap and hysteresis, of full spool travel", default=0.06, lowest=0.0, highest=0.3
    ),
    per_joint=True,
)
def valve_wear(options: Options) -> tuple[ParameterChange, ...]:
    """Sets overlap and hysteresis of every valve to the size."""
    return (options.set("lap", options.severity), options.set("hysteresis", options.severity))


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("valve_wear")
