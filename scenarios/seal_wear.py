"""The piston seals wear out half way.

Leakage grows with the cube of the seal's clearance (docs/reference/parameters.md): x2, x10 and x50
stand for 1.26, 2.15 and 3.68 times the clearance.
"""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "seal_wear",
    summary="all piston seals leak ten times as much from half time on",
    severity=Severity(meaning="internal leakage ratio", default=10.0, lowest=1.0, highest=1000.0),
    per_joint=True,
)
def seal_wear(options: Options) -> tuple[ParameterChange, ...]:
    """Multiplies the internal leakage of every cylinder by the size."""
    return (options.scale("internal_leakage", options.severity),)


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("seal_wear")
