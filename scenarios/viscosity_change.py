"""The oil is changed for another grade at half time: VG 100 instead of VG 46.

Friction and leakage of a cylinder are given for its own oil at 40 °C, so that with another oil
they change with the viscosity there. At 100 °C mineral oils of one viscosity index (100) follow
nu_100 = 6.8 cSt (VG/46)^0.665: 5.3, 8.8, 11.4 and 14.9 for VG 32, 68, 100 and 150, against 5.4,
8.7, 11.4 and 15.0 in makers' tables.
"""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario

NOMINAL_GRADE = 46.0  # of the shipped models, cSt at 40 °C
SLOPE = 0.665
GAPS = ("internal_leakage", "external_leakage_a", "external_leakage_b")


@register_scenario(
    "viscosity_change",
    summary="oil of another grade from half time on",
    severity=Severity(
        meaning="ISO viscosity grade [cSt at 40 °C]", default=100.0, lowest=10.0, highest=460.0
    ),
)
def viscosity_change(options: Options) -> tuple[ParameterChange, ...]:
    """Sets both viscosities and what depends on them at 40 °C."""
    ratio = options.severity / NOMINAL_GRADE
    return (
        options.set("viscosity_40", 1e-6 * options.severity),
        options.set("viscosity_100", 6.8e-6 * ratio**SLOPE),
        options.scale("viscous", ratio, "*_valve"),
        *(options.scale(gap, 1 / ratio) for gap in GAPS),
    )


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("viscosity_change")
