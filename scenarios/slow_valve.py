"""The spools of all valves become slow at half time, as with a clogged pilot stage."""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "slow_valve",
    summary="the spools follow with 40 Hz instead of 250 Hz from half time on",
    severity=Severity(
        meaning="natural frequency of the spools [Hz]", default=40.0, lowest=5.0, highest=250.0
    ),
    per_joint=True,
)
def slow_valve(options: Options) -> tuple[ParameterChange, ...]:
    """Sets the bandwidth of every valve."""
    return (options.set("bandwidth_hz", options.severity),)


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("slow_valve")
