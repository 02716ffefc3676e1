"""The command line. Exit status: 0 done, 1 a check failed, 2 bad input, 130 interrupted."""

import json
import sys
import tomllib
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from leglab import __version__
from leglab.cli.compare import compare
from leglab.cli.conventions import (
    BAD_INPUT,
    FAILED,
    INTERRUPTED,
    Commands,
    execute,
    exit_status,
    explain,
)
from leglab.cli.convert import convert, inspect
from leglab.cli.diagnose import diagnose
from leglab.cli.options import (
    Controller,
    Duration,
    Json,
    Model,
    Overwrite,
    Ramp,
    Reference,
    Scenario,
    Seed,
    Severity,
    Tolerance,
)
from leglab.cli.report import index, report
from leglab.cli.terminal import errors, metrics_table, output, progress_bar
from leglab.cli.video import video
from leglab.cli.view import view

app = typer.Typer(
    cls=Commands,
    help="Testbed for hydraulic humanoid-leg control on MuJoCo.",
    epilog=f"{exit_status()}. With --json a command prints JSON alone on standard output.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(compare)
app.command()(diagnose)
app.command()(convert)
app.command()(inspect)
app.command()(video)
app.command()(report)
app.command()(index)
app.command()(view)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"leglab {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("-v", "--verbose", help="Show the traceback of an error.")
    ] = False,
) -> None:
    pass


@app.command()
def run(
    scenario: Scenario,
    controller: Controller = "pd",
    model: Model = "leg",
    duration: Duration = None,
    seed: Seed = 0,
    severity: Severity = None,
    ramp: Ramp = 0.0,
    reference: Reference = None,
    timestep: Annotated[float | None, typer.Option(help="Simulation step [s].")] = None,
    tolerance: Tolerance = 0.0,
    out: Annotated[
        Path | None,
        typer.Option(help="Output folder; default runs/SCENARIO-CONTROLLER-MODEL-SEED."),
    ] = None,
    overwrite: Overwrite = False,
    figures: Annotated[bool, typer.Option(help="Draw plots.")] = True,
    as_json: Json = False,
) -> None:
    """Runs a scenario headless and writes metrics, recording, configuration and plots."""
    from leglab.report.figures import draw_run
    from leglab.runs.folder import check_folder, write_run
    from leglab.runs.preparation import RunSettings
    from leglab.runs.run import run_scenario

    folder = out or Path("runs") / f"{scenario}-{controller}-{Path(model).stem}-{seed}"
    settings = RunSettings(
        scenario=scenario,
        controller=controller,
        model=model,
        duration=duration,
        seed=seed,
        severity=severity,
        ramp_duration=ramp,
        reference=reference,
        timestep=timestep,
        tolerance=tolerance,
    )
    check_folder(folder, overwrite=overwrite)
    with progress_bar() as bar:
        task = bar.add_task(f"{scenario} · {controller}", total=duration)

        def show(now: float) -> None:
            bar.update(task, completed=now)

        from leglab.base.scenario import get_scenario

        bar.update(task, total=get_scenario(scenario, duration=duration).duration)
        result = run_scenario(settings, show)
        bar.update(task, description="writing", completed=result.scenario.duration)
        write_run(result, folder, overwrite=overwrite, draw=draw_run if figures else None)
    if as_json:
        typer.echo(json.dumps(result.metrics, indent=2))
    else:
        output.print(metrics_table(result.metrics))
        output.print(f"written to {folder}")
    failure = result.history.failure
    if failure:
        interrupted = failure.startswith("interrupted")
        errors.print(f"[red]error:[/red] {failure}; what was recorded is in {folder}")
        raise typer.Exit(INTERRUPTED if interrupted else BAD_INPUT)


@app.command("list")
def list_names(
    as_json: Json = False,
    markdown: Annotated[bool, typer.Option(help="Print Markdown, as in docs/.")] = False,
) -> None:
    """Shows scenarios, controllers, references and models."""
    from leglab.cli import catalogue as listing

    if markdown:
        typer.echo(listing.markdown(), nl=False)
        return
    groups = listing.summaries()
    if as_json:
        typer.echo(json.dumps(groups, indent=2))
        return
    for title, entries in groups.items():
        table = Table(title=title, title_justify="left", box=None, show_header=False)
        for name, summary in entries.items():
            table.add_row(f"  [bold]{name}[/bold]", summary)
        output.print(table)


@app.command()
def tune(
    models: Annotated[
        list[str] | None,
        typer.Option("--model", help="Repeatable; default: knee_bench, leg, leg_rail."),
    ] = None,
    write: Annotated[bool, typer.Option(help="Write the gains file of the package.")] = False,
    as_json: Json = False,
) -> None:
    """Finds the PD gains that keep 6 dB and 45 degrees of margin on the linearised plant."""
    from leglab.commissioning.pd_gains import TUNED_MODELS, gains_text

    names = models or list(TUNED_MODELS)
    with progress_bar() as bar:
        task = bar.add_task("tuning", total=None)
        text = gains_text(names, lambda label: bar.update(task, description=label))
    if write:
        from leglab.commissioning.pd_gains import GAINS_FILE

        GAINS_FILE.write_text(text)
        (errors if as_json else output).print(f"written to {GAINS_FILE}")
    if as_json:
        typer.echo(json.dumps(tomllib.loads(text), indent=2))
    elif not write:
        typer.echo(text, nl=False)


@app.command()
def replicate(
    instances: Annotated[int, typer.Option(help="Instances of each model.")] = 100,
    seed: Annotated[int | None, typer.Option(help="Default: the seed of the paper mode.")] = None,
    out: Annotated[Path, typer.Option(help="Folder of page and figures.")] = Path(
        "out/replication"
    ),
    as_json: Json = False,
) -> None:
    """Replicates the BSNN-ARX paper: Table 1, figures, sensitivities, on one page."""
    from leglab.studies.replication import paper
    from leglab.studies.replication import replicate as run_replication

    with progress_bar() as bar:
        task = bar.add_task("replicating", total=None)
        result = run_replication(
            instances,
            out,
            paper.SEED if seed is None else seed,
            progress=lambda line: bar.update(task, description=line),
        )
    if as_json:
        typer.echo(json.dumps(result.to_json(), indent=2))
        return
    output.print(result.table, soft_wrap=True)
    output.print(f"largest deviation of a validation mean: {result.worst_deviation:.1%}")
    output.print(f"written to {result.page}")


@app.command()
def verify(as_json: Json = False) -> None:
    """Checks the physics against closed forms and recordings; status 1 where a check fails."""
    from leglab.studies.verification import checks_as_json
    from leglab.studies.verification import verify as run_checks

    if as_json:
        found = checks_as_json()
        typer.echo(json.dumps(found, indent=2))
        passed = found["passed"]
    else:
        passed = run_checks()
    if not passed:
        raise typer.Exit(FAILED)


@app.command()
def parameters(
    plugin: Annotated[str | None, typer.Argument(help="Name of a plugin; default: all.")] = None,
    markdown: Annotated[bool, typer.Option(help="Print Markdown, as in docs/.")] = False,
    as_json: Json = False,
) -> None:
    """Shows the physical parameters of the plugins: units, defaults, bounds, sources."""
    from leglab.base.errors import unknown_name
    from leglab.machine.parameters import markdown_tables, plugin_tables

    tables = plugin_tables()
    if plugin is not None and plugin not in tables:
        raise unknown_name("plugin", plugin, tables)
    chosen = [tables[plugin]] if plugin else list(tables.values())
    if as_json:
        typer.echo(json.dumps({entry.plugin: entry.to_json() for entry in chosen}, indent=2))
        return
    if markdown:
        typer.echo(markdown_tables(chosen), nl=False)
        return
    for entry in chosen:
        table = Table(title=entry.plugin, title_justify="left")
        for column in ("parameter", "default", "allowed", "meaning"):
            table.add_column(column)
        for row in entry.parameters.values():
            default = "required" if row.nominal != row.nominal else f"{row.nominal:g}"
            table.add_row(row.name, default, escape(row.allowed), escape(row.description))
        output.print(table)


explain(app)


def run_scenario_as_script(name: str) -> None:
    """What `python -m leglab.scenarios.NAME` does: `leglab run NAME` with further options."""
    main(["run", name, *sys.argv[1:]])


def main(arguments: list[str] | None = None) -> None:
    """Runs the command line; errors are one line on stderr."""
    execute(app, sys.argv[1:] if arguments is None else arguments)
