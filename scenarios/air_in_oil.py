"""Air gets into the oil at half time.

The chambers become soft: at 30 bar 5 % of air instead of 0.5 % lower the bulk modulus from 1.2 to
0.6 GPa. Well-kept systems have 0.5 to 2 %; a low tank or a leaking suction line lets in more.
"""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "air_in_oil",
    summary="ten times the air in the oil from half time on",
    severity=Severity(
        meaning="volume fraction of entrained air at atmospheric pressure",
        default=0.05,
        lowest=0.0,
        highest=0.3,
    ),
    per_joint=True,
)
def air_in_oil(options: Options) -> tuple[ParameterChange, ...]:
    """Sets the entrained air of every cylinder; chambers keep their pressures."""
    return (options.set("entrained_air", options.severity),)


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("air_in_oil")
