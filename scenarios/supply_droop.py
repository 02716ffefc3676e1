"""The pump cannot keep up with fast strides from half time on.

The flow that a worn pump has left is the size, and a quarter of the accumulator's gas volume:
the pressure now swings with the demand of all joints together. Only models with an accumulator can
droop.
"""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "supply_droop",
    summary="fast strides on a pump that gives too little from half time on",
    severity=Severity(
        meaning="share of the pump's flow that is left", default=0.5, lowest=0.0, highest=1.0
    ),
    reference_config={"period": 0.9},
)
def supply_droop(options: Options) -> tuple[ParameterChange, ...]:
    """Takes flow from the pump and gas volume from the accumulator."""
    return (options.scale("pump_flow", options.severity), options.scale("accumulator_volume", 0.25))


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("supply_droop")
