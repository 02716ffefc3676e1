"""The commands `leglab list` and `leglab parameters`, which show names with summaries."""

import re
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from leglab.base import plugins
from leglab.base.scenario import scenario_severity
from leglab.causes.table import CAUSES
from leglab.cli.details import model_values, registries, show_details
from leglab.cli.options import Json, Load
from leglab.cli.terminal import errors, print_json, print_table

Markdown = Annotated[bool, typer.Option(help="Print Markdown, as in docs/.")]


_CAUSE_HEAD = ("scenario, live name", "effect of a diagnosis", "attributes", "size")
_SIZE_HEAD = ("healthy", "bank of faults", "benchmarks")
_SCENARIO_HEAD = " size (`--severity`): default | one joint alone: `--element` |"


def list_names(
    name: Annotated[
        str | None,
        typer.Argument(
            help='Scenario, controller, reference, model, effect, "sensors" or "causes"; '
            "default: all."
        ),
    ] = None,
    model: Annotated[
        str, typer.Option(help="Machine on which causes, a scenario or an effect are shown.")
    ] = "leg",
    as_json: Json = False,
    markdown: Markdown = False,
    load: Load = None,
) -> None:
    """Shows what there is; of a NAME its settings, with defaults and units."""
    if name == "causes":
        rows = cause_rows(model)
        if as_json:
            print_json({"causes": rows})
        else:
            _show_causes(rows, magnitudes=True)
        return
    if name is not None:
        show_details(name, model, as_json=as_json)
        return
    if markdown:
        typer.echo(catalogue_page(), nl=False)
        return
    groups = summaries()
    for failure in plugins.failures():
        errors.print(f"[yellow]warning:[/yellow] {escape(failure)}")
    if as_json:
        print_json({**groups, "causes": cause_rows()})
        return
    for title, entries in groups.items():
        table = Table(title=title, title_justify="left", box=None, show_header=False)
        for name, summary in entries.items():
            alone = " [dim](--element)[/dim]" if title == "scenarios" and _per_joint(name) else ""
            table.add_row(f"  [bold]{name}[/bold]", summary + alone)
        print_table(table)
    _show_causes(cause_rows(), magnitudes=False)


def cause_rows(model: str | None = None) -> list[dict[str, str]]:
    """Returns one row per cause: its names, the parameters that it changes, and its magnitudes.

    Args:
        model: Model whose parameters give the healthy magnitudes; None for the plugins' defaults.
    """
    rows, values = [], model_values(model) if model else None
    for cause in CAUSES.values():
        healthy = cause.healthy_magnitude(values)
        sizes = {
            kind: "; ".join(
                " ".join(f"{size:.4g}" for size in cause.magnitudes(getattr(side, kind), healthy))
                for side in cause.sides
            )
            for kind in ("bank", "benchmark")
        }
        names = {"live": cause.name, "effect": cause.effect}
        what = {"attributes": ", ".join(cause.parameters), "size": cause.meaning}
        rows.append({**names, **what, "healthy": f"{healthy:.4g}", **sizes})
    return rows


def _show_causes(rows: list[dict[str, str]], *, magnitudes: bool) -> None:
    table = Table(*_CAUSE_HEAD, title="causes", title_justify="left", box=None)
    for row in rows:
        live, effect, attributes, size, *found = row.values()
        if magnitudes:
            told = zip(_SIZE_HEAD, found, strict=True)
            size += "".join(f"\n  {kind}: {sizes}" for kind, sizes in told if sizes)
        table.add_row(f"  [bold]{live}[/bold]", *map(escape, (effect, attributes, size)))
    print_table(table)


def parameters(
    plugin: Annotated[str | None, typer.Argument(help="Name of a plugin; default: all.")] = None,
    markdown: Markdown = False,
    as_json: Json = False,
) -> None:
    """Shows the physical parameters of the plugins: units, defaults, bounds, sources."""
    from leglab.base.errors import SettingsError
    from leglab.machine.parameters import markdown_tables, plugin_tables

    tables = plugin_tables()
    if plugin is not None and plugin not in tables:
        raise SettingsError.unknown("plugin", plugin, tables)
    chosen = [tables[plugin]] if plugin else list(tables.values())
    if as_json:
        print_json({entry.plugin: entry.to_json() for entry in chosen})
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
        print_table(table)


def summaries() -> dict[str, dict[str, str]]:
    """Returns the summaries of scenarios, controllers, references and models by kind and name."""
    return {
        f"{kind}s": {name: registry.get(name).summary for name in registry.names()}
        for kind, registry in registries().items()
    }


def severity_text(scenario: str) -> str:
    """Returns meaning and default of a scenario's severity; empty if it has no severity."""
    severity = scenario_severity(scenario)
    return f"{severity.meaning}: {severity.default:g}" if severity else ""


def _per_joint(scenario: str) -> bool:
    return bool(registries()["scenario"].get(scenario).per_joint)


def catalogue_page() -> str:
    """Returns all summaries as Markdown, the content of docs/reference/catalogue.md."""
    lines = [
        "# Scenarios, controllers, references, models",
        "",
        "Made by `leglab list --markdown > docs/reference/catalogue.md`.",
    ]
    for kind, entries in summaries().items():
        scenarios = kind == "scenarios"
        lines += ["", f"## {kind.capitalize()}", ""]
        lines.append("| name | what |" + (_SCENARIO_HEAD if scenarios else ""))
        lines.append("|---|---|" + ("---|---|" if scenarios else ""))
        for name, summary in entries.items():
            row = f"| `{name}` | {summary} |"
            alone = "yes" if scenarios and _per_joint(name) else ""
            lines.append(row + (f" {severity_text(name)} | {alone} |" if scenarios else ""))
    lines += ["", "## Causes", "", _line([*_CAUSE_HEAD, *_SIZE_HEAD]), "|---" * 7 + "|"]
    for cause in cause_rows():
        live, effect, attributes, *others = cause.values()
        lines.append(_line([f"`{live}`", _code(effect), _code(attributes), *others]))
    return "\n".join(lines) + "\n"


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _code(names: str) -> str:
    """Formats names that are separated by commas or "and" as Markdown code."""
    words = re.split(r"( and |, )", names) if names else []
    return "".join(w if i % 2 or " " in w else f"`{w}`" for i, w in enumerate(words))
