"""The shank carries a load from half time on.

The point mass sits at the shank's centre of mass: 5 kg weigh as much again as the shank of the
knee bench (4.5 kg). On a machine without a shank the last moving body carries it.
"""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "payload",
    summary="5 kg more on the shank from half time on",
    severity=Severity(meaning="added mass [kg]", default=5.0, lowest=0.0, highest=50.0),
)
def payload(options: Options) -> tuple[ParameterChange, ...]:
    """Fixes a point mass at the shank's centre of mass."""
    return (options.set("added_mass", options.severity, "shank", fallback=True),)


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("payload")
