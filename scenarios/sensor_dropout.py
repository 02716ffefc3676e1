"""The encoders lose readings from half time on, as on a bus with a bad connector.

A lost reading is replaced by the last good one; each is lost by itself, by chance and by the seed
of the run. Positions stand still and jump, and so the speeds that are made of them.
"""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "sensor_dropout",
    summary="the encoders lose a third of their readings from half time on",
    severity=Severity(meaning="share of lost readings", default=0.3, lowest=0.0, highest=0.95),
    per_joint=True,
)
def sensor_dropout(options: Options) -> tuple[ParameterChange, ...]:
    """Sets the share of readings that every encoder loses."""
    return (options.set("encoder_dropout", options.severity),)


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("sensor_dropout")
