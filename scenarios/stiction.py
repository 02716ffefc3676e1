"""Seals stick from half time on: breakaway friction grows, Coulomb friction stays."""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "stiction",
    summary="four times the breakaway friction from half time on",
    severity=Severity(meaning="breakaway friction ratio", default=4.0, lowest=1.0, highest=20.0),
    per_joint=True,
)
def stiction(options: Options) -> tuple[ParameterChange, ...]:
    """Multiplies the breakaway friction alone."""
    return (options.scale("static", options.severity),)


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("stiction")
