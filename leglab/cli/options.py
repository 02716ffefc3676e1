"""Options that several commands share."""

from typing import Annotated

import typer

Scenario = Annotated[str, typer.Argument(help="What happens to the machine.")]
Controller = Annotated[str, typer.Option(help="What drives it.")]
Model = Annotated[str, typer.Option(help="Machine.")]
Duration = Annotated[float | None, typer.Option(help="Seconds; default: the scenario's.")]
Seed = Annotated[int, typer.Option(help="Seed of sensor noise.")]
Severity = Annotated[
    float | None, typer.Option(help="How bad the change is, in the scenario's own unit.")
]
Ramp = Annotated[float, typer.Option(help="Seconds the change takes; 0 is a step.")]
Reference = Annotated[str | None, typer.Option(help="Reference; default: the scenario's.")]
Tolerance = Annotated[
    float,
    typer.Option(
        help="Relative standard deviation of the machine's parameters about those that controllers "
        "know; the seed picks the specimen."
    ),
]
Camera = Annotated[str, typer.Option(help="Camera of the model.")]
Jobs = Annotated[int, typer.Option(help="Processes at a time; -1: one a core.")]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace the folder of an earlier run.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
