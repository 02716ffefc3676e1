"""The command `leglab view`."""

import typer

from leglab.cli.options import (
    Controller,
    Duration,
    Model,
    Ramp,
    Reference,
    Scenario,
    Seed,
    Severity,
    Tolerance,
)
from leglab.cli.terminal import errors, output


def view(
    scenario: Scenario,
    controller: Controller = "bsnn_arx",
    model: Model = "leg",
    duration: Duration = None,
    seed: Seed = 0,
    severity: Severity = None,
    ramp: Ramp = 0.0,
    reference: Reference = None,
    tolerance: Tolerance = 0.0,
) -> None:
    """Opens MuJoCo's viewer: the controller lives, and sliders wear, heat and load the leg.

    The scenario's change comes at its time, or when Enter is pressed. The run has no end.
    """
    from leglab.runs.preparation import RunSettings
    from leglab.viewer.session import Session
    from leglab.viewer.window import HELP, Window, check_display

    check_display()
    settings = RunSettings(
        scenario=scenario,
        controller=controller,
        model=model,
        duration=duration,
        seed=seed,
        severity=severity,
        ramp_duration=ramp,
        reference=reference,
        tolerance=tolerance,
    )
    session = Session(settings)
    output.print(HELP)
    window = Window(session, model)
    try:
        window.run()
    finally:
        window.close()
    if session.failure:
        errors.print(f"[red]error:[/red] {session.failure}")
        raise typer.Exit(2)
