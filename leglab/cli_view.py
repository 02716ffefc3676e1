"""The command `leglab view`."""

from typing import Annotated

import typer

from leglab.terminal import TOLERANCE, errors, output


def view(
    scenario: Annotated[str, typer.Argument(help="Name of a scenario; `leglab list` shows them.")],
    controller: Annotated[str, typer.Option(help="Name of a controller.")] = "bsnn_arx",
    model: Annotated[str, typer.Option(help="leg, leg_rail, knee_bench, or an MJCF file.")] = "leg",
    duration: Annotated[
        float | None, typer.Option(help="Seconds of the scenario; default: its own.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of sensor noise.")] = 0,
    severity: Annotated[
        float | None, typer.Option(help="How bad the change is, in the scenario's own unit.")
    ] = None,
    ramp: Annotated[float, typer.Option(help="Seconds the change takes; 0 is a step.")] = 0.0,
    reference: Annotated[str | None, typer.Option(help="Name of a reference trajectory.")] = None,
    tolerance: Annotated[float, typer.Option(help=TOLERANCE)] = 0.0,
) -> None:
    """Opens MuJoCo's viewer: the controller lives, and sliders wear, heat and load the leg.

    The scenario's change comes at its time, or when Enter is pressed. The run has no end.
    """
    from leglab.preparation import RunSettings
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
