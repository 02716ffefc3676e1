"""The knee's encoder slips on its shaft at half time.

What the controller believes to be tracked is off by the slip: nothing but another sensor can tell.
The tracking error counts from the true position. On a machine without a knee it is the last
joint's encoder.
"""

from leglab.base.scenario import Options, ParameterChange, Severity, register_scenario


@register_scenario(
    "encoder_shift",
    summary="the knee's encoder slips at half time",
    severity=Severity(meaning="slip of the encoder [rad]", default=0.03, lowest=-0.3, highest=0.3),
    per_joint=True,
)
def encoder_shift(options: Options) -> tuple[ParameterChange, ...]:
    """Adds an offset to the readings of the knee's encoder."""
    return (options.set("encoder_offset", options.severity, "knee", fallback=True),)


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("encoder_shift")
