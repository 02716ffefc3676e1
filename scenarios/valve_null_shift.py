"""The null of all valves shifts at half time.

New servovalves stay within 2 % over temperature and supply pressure (docs/reference/parameters.md).
"""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "valve_null_shift",
    summary="the null of all valves shifts at half time",
    severity=Severity(
        meaning="null shift, of full command", default=0.03, lowest=-0.3, highest=0.3
    ),
    per_joint=True,
)
def valve_null_shift(options: Options) -> tuple[ParameterChange, ...]:
    """Sets the null bias of every valve."""
    return (options.set("null_bias", options.severity),)


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("valve_null_shift")
