"""Every cylinder leaks to the outside from half time on.

5e-13 m^3/s/Pa are 0.24 l/min a chamber at 80 bar, the upper end of the leakage that the literature
detects (0.07 to 0.25 l/min; ASME FPMC 2014). The pump has to make up for it.
"""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "external_leak",
    summary="all rod and piston seals leak to the outside from half time on",
    severity=Severity(
        meaning="external leakage of each chamber [m^3/s/Pa]",
        default=5e-13,
        lowest=0.0,
        highest=1e-10,
    ),
    per_joint=True,
)
def external_leak(options: Options) -> tuple[ParameterChange, ...]:
    """Sets the leakage of both chambers of every cylinder to the surroundings."""
    return (
        options.set("external_leakage_a", options.severity),
        options.set("external_leakage_b", options.severity),
    )


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("external_leak")
