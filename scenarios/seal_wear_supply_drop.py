"""Two changes at once at half time: worn seals, and a supply pressure of 120 bar.

The leakage asks for more flow and the supply gives less.
"""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "seal_wear_supply_drop",
    summary="seals leak ten times as much and the supply falls to 120 bar",
    severity=Severity(meaning="internal leakage ratio", default=10.0, lowest=1.0, highest=1000.0),
)
def seal_wear_supply_drop(options: Options) -> tuple[ParameterChange, ...]:
    """Multiplies the internal leakage by the size and sets the supply to 120 bar."""
    return (
        options.scale("internal_leakage", options.severity),
        options.set("supply_pressure", 120e5),
    )


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("seal_wear_supply_drop")
