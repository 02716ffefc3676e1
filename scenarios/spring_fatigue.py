"""The parallel springs tire at half time (k_1 and k_2 of Eq. 23 of Folgheraiter)."""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "spring_fatigue",
    summary="the parallel springs lose half of their stiffness at half time",
    severity=Severity(meaning="stiffness ratio", default=0.5, lowest=0.0, highest=1.0),
    per_joint=True,
)
def spring_fatigue(options: Options) -> tuple[ParameterChange, ...]:
    """Multiplies both stiffnesses of every parallel spring."""
    return tuple(options.scale(k, options.severity, optional=True) for k in ("k1", "k2"))


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("spring_fatigue")
