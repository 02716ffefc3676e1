"""The command line: `leglab` and its commands; their exit status is in `conventions`."""

import sys
from collections.abc import Callable
from typing import Annotated

import typer

from leglab import __version__
from leglab.cli.catalogue import list_names, parameters
from leglab.cli.conventions import Command, Commands, execute, exit_status, explain
from leglab.cli.convert import convert, inspect
from leglab.cli.diagnose import diagnose
from leglab.cli.doctor import doctor
from leglab.cli.fit import fit
from leglab.cli.identify import identify
from leglab.cli.improve import improve
from leglab.cli.report import index, report, video
from leglab.cli.run import compare, run, view
from leglab.cli.studies import benchmark, replicate, tune, verify
from leglab.cli.sweep import query, sweep

app = typer.Typer(
    cls=Commands,
    help="Testbed for hydraulic humanoid-leg control on MuJoCo.",
    epilog=f"{exit_status()}. With --json a command prints JSON alone on standard output.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
_COMMANDS: tuple[Callable[..., None], ...] = (
    run, compare, sweep, query, report, video, view, index, diagnose, improve, fit, identify,
    inspect, convert, list_names, parameters, doctor, tune, benchmark, replicate, verify,
)  # fmt: skip
for _command in _COMMANDS:
    app.command("list" if _command is list_names else None, cls=Command)(_command)
explain(app)


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


def run_scenario_as_script(name: str) -> None:
    """Runs `leglab run NAME` with further options: `python -m leglab.scenarios.NAME` calls this."""
    main(["run", name, *sys.argv[1:]])


def main(arguments: list[str] | None = None) -> None:
    """Runs the command line; errors are one line on stderr."""
    execute(app, sys.argv[1:] if arguments is None else arguments)
