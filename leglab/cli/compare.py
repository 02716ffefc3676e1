"""The command `leglab compare`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from leglab.base.errors import LeglabError
from leglab.cli.options import Duration, Jobs, Json, Model, Ramp, Reference, Severity, Tolerance
from leglab.cli.terminal import comparison_table, errors, output, print_wide, progress_bar


def compare(
    scenarios: Annotated[list[str], typer.Argument(help="What happens to the machine.")],
    controllers: Annotated[
        str, typer.Option(help="Names, separated by commas; ratios refer to the first.")
    ] = "pd,static_feedforward",
    model: Model = "leg",
    seeds: Annotated[int, typer.Option(help="Number of seeds, from 0 on.")] = 3,
    duration: Duration = None,
    severity: Severity = None,
    ramp: Ramp = 0.0,
    reference: Reference = None,
    tolerance: Tolerance = 0.0,
    jobs: Jobs = -1,
    out: Annotated[Path, typer.Option(help="Output folder.")] = Path("runs/compare"),
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Repeat runs that are there.")
    ] = False,
    figures: Annotated[bool, typer.Option(help="Draw a figure a scenario.")] = True,
    as_json: Json = False,
) -> None:
    """Runs scenarios with several controllers and seeds and compares the tracking errors.

    Writes compare.json and a figure a scenario. Runs that the output folder holds with the same
    settings and code are not repeated: an interrupted comparison goes on where it was.
    """
    from leglab.report.figures import save_comparison_figure
    from leglab.runs.sweep import Comparison, run_all
    from leglab.runs.sweep import compare as summarise

    if jobs == 0:
        raise LeglabError("jobs is 0; allowed: 1 or more, or -1 for one a core")
    comparison = Comparison(
        scenarios=tuple(scenarios),
        controllers=tuple(name.strip() for name in controllers.split(",") if name.strip()),
        seeds=seeds,
        model=model,
        duration=duration,
        severity=severity,
        ramp_duration=ramp,
        reference=reference,
        tolerance=tolerance,
    )
    runs = comparison.runs()
    finished = 0
    with progress_bar() as bar:
        task = bar.add_task("comparing", total=len(runs))

        def show(done: int, total: int, label: str) -> None:
            nonlocal finished
            finished = done
            bar.update(task, completed=done, total=total, description=label or "comparing")

        try:
            results = run_all(runs, out / "runs", jobs=jobs, overwrite=overwrite, progress=show)
        except KeyboardInterrupt:
            bar.stop()
            errors.print(
                f"[red]interrupted[/red] after {finished} of {len(runs)} runs: "
                "the same command goes on from there"
            )
            raise typer.Exit(130) from None
        summary = summarise(comparison, results)
        (out / "compare.json").write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n")
        if figures:
            bar.update(task, description="drawing")
            for name in comparison.scenarios:
                shown = [r for r in results if r["metrics"]["scenario"] == name]
                title = f"{name}, {Path(model).stem}, {seeds} seed{'s' * (seeds > 1)}"
                save_comparison_figure(shown, out / f"{name}.png", title=title)
    if as_json:
        typer.echo(json.dumps(summary, indent=2))
    else:
        print_wide(comparison_table(summary))
        output.print(f"written to {out}")
