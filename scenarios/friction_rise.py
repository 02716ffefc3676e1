"""All friction of seals and joints grows at half time, as with swollen seals."""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "friction_rise",
    summary="three times the friction from half time on",
    severity=Severity(meaning="friction ratio", default=3.0, lowest=0.0, highest=20.0),
    per_joint=True,
)
def friction_rise(options: Options) -> tuple[ParameterChange, ...]:
    """Multiplies Coulomb, breakaway and viscous friction."""
    return tuple(
        options.scale(friction, options.severity, optional=True)
        for friction in ("coulomb", "static", "viscous")
    )


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("friction_rise")
