"""Nothing changes: the machine as it was built."""

from leglab.base.scenario import Options, ParameterChange, register_scenario


@register_scenario("nominal", summary="the machine as it was built", duration=10.0)
def nominal(options: Options) -> tuple[ParameterChange, ...]:
    """Changes nothing."""
    return ()


if __name__ == "__main__":
    from leglab.cli import run_scenario_as_script

    run_scenario_as_script("nominal")
