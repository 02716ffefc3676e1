"""The commands `leglab run`, `leglab compare` and `leglab view`, which run scenarios."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leglab.base.errors import LeglabError
from leglab.base.output import claimed_folder, new_folder, write_json
from leglab.cli import options, terminal

if TYPE_CHECKING:
    from leglab.runs.comparison import Comparison
    from leglab.runs.run import Result

_RunFolder = Annotated[
    Path | None,
    typer.Option(
        help="Output folder; default runs/SCENARIO-CONTROLLER-MODEL-SEED and what else is not as "
        "by default."
    ),
]
_CompareFolder = Annotated[
    Path | None,
    typer.Option(
        help="Output folder, to which more seeds and controllers may come; default "
        "runs/compare-SCENARIOS-MODEL and what else is not as by default."
    ),
]
_Repeat = Annotated[bool, typer.Option("--overwrite", help="Repeat runs that are there.")]


def run(
    context: typer.Context,
    scenario: options.ScenarioOrFile,
    controller: options.Controller = "pd",
    model: options.Model = "leg",
    duration: options.Duration = None,
    seed: options.Seed = 0,
    severity: options.Severity = None,
    ramp: options.Ramp = 0.0,
    element: options.Element = None,
    reference: options.Reference = None,
    timestep: Annotated[float | None, typer.Option(help=r"Simulation step \[s].")] = None,
    tolerance: options.Tolerance = 0.0,
    vary: options.Vary = False,
    set_: options.Set = None,
    out: _RunFolder = None,
    overwrite: options.Overwrite = False,
    figures: Annotated[bool, typer.Option(help="Draw plots.")] = True,
    as_json: options.Json = False,
    load: options.Load = None,
) -> None:
    """Runs a scenario headless and writes metrics, recording, configuration and plots.

    With the run.json of a run it makes that run again on the model that ran, to the bit where code
    and versions are the same; options that are given hold over a file.
    """
    from leglab.base.scenario import get_scenario
    from leglab.report.figures import draw_run
    from leglab.runs.folder import default_folder, write_result
    from leglab.runs.interrupts import held
    from leglab.runs.record import METRICS, RECORDING, RUN_FOLDER
    from leglab.runs.run import record_scenario

    settings = options.settings_of(context)
    folder = out or default_folder(settings)
    length = get_scenario(settings.scenario, duration=settings.duration).duration
    with (
        held(later=True) as hold,
        new_folder(folder, mark=METRICS, made=RUN_FOLDER, overwrite=overwrite) as partial,
        terminal.progress(f"{settings.scenario} · {settings.controller}", length) as show,
    ):
        result = record_scenario(settings, partial / RECORDING, lambda now: show(completed=now))
        show(description="writing", completed=length)
        write_result(result, partial)
        if figures:
            draw_run(result, partial)
        late = hold.take()
    if as_json:
        terminal.print_json(result.metrics)
    else:
        _show(result)
        terminal.tell(f"written to {folder}")
    failure = result.record.failure or ("interrupted when the run was over" if late else "")
    if failure:
        interrupted = failure.startswith("interrupted")
        terminal.complain(f"{failure}; what was recorded is in {folder}")
        raise typer.Exit(terminal.INTERRUPTED if interrupted else terminal.BAD_INPUT)


def _show(result: "Result") -> None:
    """Prints metrics and events of a run, and warns of commands that took too long."""
    settings = result.configuration.settings
    terminal.print_table(terminal.metrics_table(result.record))
    lines = [event.told() for event in result.record.events]
    lines += [trend.told() for trend in result.record.health]
    lines += terminal.timing_lines(result.settings.sensors, settings)
    lines += terminal.reference_lines(settings, result.joints)
    for line in lines:
        terminal.output.print(line, soft_wrap=True, markup=False)
    for line in terminal.slow_lines(result.record, settings["sensors"]["control_period"]):
        terminal.complain(line, "warning")


def compare(
    context: typer.Context,
    scenarios: Annotated[list[str], typer.Argument(help="What happens to the machine.")],
    controllers: Annotated[
        str, typer.Option(help="Names, separated by commas; ratios refer to the first.")
    ] = "pd,static_feedforward",
    model: options.Model = "leg",
    seeds: Annotated[int, typer.Option(help="Number of seeds, from 0 on.")] = 3,
    duration: options.Duration = None,
    severity: options.Severity = None,
    ramp: options.Ramp = 0.0,
    element: options.Element = None,
    reference: options.Reference = None,
    tolerance: options.Tolerance = 0.0,
    vary: options.Vary = False,
    jobs: options.Jobs = -1,
    scheduler: options.Scheduler = None,
    out: _CompareFolder = None,
    overwrite: _Repeat = False,
    figures: Annotated[bool, typer.Option(help="Draw a figure a scenario.")] = True,
    as_json: options.Json = False,
    load: options.Load = None,
) -> None:
    """Runs scenarios with several controllers and seeds and compares the tracking errors.

    Writes compare.json and a figure a scenario. Runs that the output folder holds with the same
    settings, code and model are not repeated: an interrupted comparison goes on where it was. A run
    that fails stops no other; a line below the table says why. `leglab report OUT` writes its page.
    """
    from leglab.report.comparison.words import failures, untold
    from leglab.runs.comparison import RUNS, SUMMARY, Comparison, run_all
    from leglab.runs.comparison import compare as summarise
    from leglab.runs.folder import default_folder

    options.check_jobs(jobs)
    given = options.given_for(Comparison, context)
    given |= {"scenarios": tuple(scenarios), "controllers": tuple(options.split(controllers))}
    comparison = Comparison(**given)
    runs = comparison.runs()
    out = out or default_folder(runs[0], "compare", *comparison.scenarios, Path(model).stem)
    make = partial(run_all, runs, out / RUNS, jobs=jobs, scheduler=scheduler, overwrite=overwrite)
    with claimed_folder(out):
        results, there = _made(make, len(runs))
        summary = summarise(comparison, results)
        write_json(out / SUMMARY, summary)
        if figures:
            _draw(comparison, results, out)
    if as_json:
        terminal.print_json(summary)
    else:
        terminal.print_wide(terminal.comparison_table(summary))
        for line in untold(summary):
            terminal.tell(line)
        kept = f"{there} of {len(runs)} runs were there; " if there else ""
        terminal.tell(f"{kept}written to {out}")
    for line in failures(summary):
        terminal.complain(line, "warning")
    if not any(result["metrics"]["completed"] for result in results):
        raise typer.Exit(terminal.FAILED)


def _made(make: Callable[..., list[dict]], count: int) -> tuple[list[dict], int]:
    """Makes runs and shows how many are done; returns results, and how many were there before."""
    there: list[int] = []

    def noted(progress: Callable[[int, int, str], None]) -> list[dict]:
        def note(done: int, total: int, name: str) -> None:
            there.append(done)
            progress(done, total, name)

        return make(progress=note)

    return terminal.make_many("comparing", count, noted), there[0]


def _draw(comparison: "Comparison", results: list[dict], folder: Path) -> None:
    """Draws a figure of each scenario of a comparison; warns if one cannot be drawn."""
    from leglab.report.figures import save_comparison_figure

    model, seeds = Path(comparison.model).stem, comparison.seeds
    with terminal.progress("drawing"):
        for name in comparison.scenarios:
            shown = [r for r in results if r["metrics"]["scenario"] == name and r["time"]]
            title = f"{name}, {model}, {seeds} seed{'s' * (seeds > 1)}"
            try:
                save_comparison_figure(shown, folder / f"{name}.png", title=title)
            except LeglabError as error:  # The results are already written.
                terminal.complain(f"no figure of {name}: {error}", "warning")


def view(
    context: typer.Context,
    scenario: options.ScenarioOrFile,
    controller: options.Controller = "bsnn_arx",
    model: options.Model = "leg",
    duration: options.Duration = None,
    seed: options.Seed = 0,
    severity: options.Severity = None,
    ramp: options.Ramp = 0.0,
    element: options.Element = None,
    reference: options.Reference = None,
    tolerance: options.Tolerance = 0.0,
    vary: options.Vary = False,
    set_: options.Set = None,
    load: options.Load = None,
) -> None:
    """Opens MuJoCo's viewer: the controller lives, and sliders wear, heat and load the leg.

    The scenario's change comes at its time, or when Enter is pressed. The run has no end.
    """
    from leglab.viewer.session import Session
    from leglab.viewer.window import HELP, Window, check_window

    check_window()
    settings = options.settings_of(context)
    session = Session(settings)
    terminal.output.print(HELP)
    window = Window(session, settings.model)
    try:
        window.run()
    finally:
        window.close()
    if session.failure:
        terminal.complain(session.failure)
        raise typer.Exit(terminal.BAD_INPUT)
