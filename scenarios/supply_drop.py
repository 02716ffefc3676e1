"""The supply pressure falls at half time, as with a worn pump or a relief valve set too low.

Speed and force of every joint shrink, and the flow gain of the valves with the root of the
pressure. With an accumulator the cylinders see the fall as fast as they empty it.
"""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "supply_drop",
    summary="the pressure of the supply falls to 100 bar at half time",
    severity=Severity(meaning="supply pressure [bar]", default=100.0, lowest=20.0, highest=160.0),
)
def supply_drop(options: Options) -> tuple[ParameterChange, ...]:
    """Sets the pressure that the pump holds, of the shared supply or of each cylinder."""
    return (options.set("supply_pressure", 1e5 * options.severity),)


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("supply_drop")
