"""The commands `leglab list` and `leglab parameters`: what there is, with summaries."""

import re
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from leglab.base import plugins
from leglab.base.causes import CAUSES
from leglab.cli.details import registries, show_details
from leglab.cli.options import Json, Load
from leglab.cli.terminal import errors, print_json, print_table

Markdown = Annotated[bool, typer.Option(help="Print Markdown, as in docs/.")]


_CAUSE_HEAD = ("scenario, live name", "effect of a diagnosis", "attributes", "size")
_SCENARIO_HEAD = " size (`--severity`): default | one joint alone: `--element` |"


def list_names(
    name: Annotated[
        str | None,
        typer.Argument(help="Scenario, controller, reference, model or effect; default: all."),
    ] = None,
    model: Annotated[str, typer.Option(help="Machine on which an effect is shown.")] = "leg",
    as_json: Json = False,
    markdown: Markdown = False,
    load: Load = None,
) -> None:
    """Shows what there is; of a NAME its settings, with defaults and units."""
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
        print_json({**groups, "causes": [vars(cause) for cause in CAUSES]})
        return
    for title, entries in groups.items():
        table = Table(title=title, title_justify="left", box=None, show_header=False)
        for name, summary in entries.items():
            alone = " [dim](--element)[/dim]" if title == "scenarios" and _per_joint(name) else ""
            table.add_row(f"  [bold]{name}[/bold]", summary + alone)
        print_table(table)
    table = Table(*_CAUSE_HEAD, title="causes", title_justify="left", box=None)
    for cause in CAUSES:
        live, *others = vars(cause).values()
        table.add_row(f"  [bold]{live}[/bold]", *map(escape, others))
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
    """Returns the meaning and default of a scenario's size; empty without one."""
    severity = registries()["scenario"].get(scenario).severity
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
    lines += ["", "## Causes", "", "| " + " | ".join(_CAUSE_HEAD) + " |", "|---|---|---|---|"]
    lines += [
        f"| `{c.live}` | {_code(c.effect)} | {_code(c.attributes)} | {c.size} |" for c in CAUSES
    ]
    return "\n".join(lines) + "\n"


def _code(names: str) -> str:
    """Names in a sentence as code."""
    words = re.split(r"( and | or |, )", names)
    return "".join(w if i % 2 or " " in w else f"`{w}`" for i, w in enumerate(words))
