"""The oil is cold from half time on.

Viscous friction grows and leakage shrinks with the viscosity: 577 cSt instead of 46 for VG 46
(docs/concepts/physics.md, case f). A machine does not change its temperature at once; the step
shows what a controller meets that was tuned at 40 °C, and has a before and an after to compare.
"""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "cold_oil",
    summary="oil at 0 °C instead of 40 °C from half time on",
    severity=Severity(meaning="oil temperature [°C]", default=0.0, lowest=-10.0, highest=40.0),
)
def cold_oil(options: Options) -> tuple[ParameterChange, ...]:
    """Sets the oil temperature of every cylinder to the size."""
    return (options.set("oil_temperature", options.severity),)


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("cold_oil")
