"""Writes docs/reference/command_line.md: `python docs/_tools/make_command_line.py`."""

from pathlib import Path

import typer

from leglab.cli.app import app
from leglab.cli.conventions import EXAMPLES, EXIT_STATUS

PAGE = Path(__file__).parents[1] / "reference" / "command_line.md"

HEAD = """# Command line

Made by `python docs/_tools/make_command_line.py`; do not edit.

`leglab --help` lists the commands, `leglab COMMAND --help` explains one. Options of the same name
mean the same everywhere.

- **Exit status**: {status}.
- **Errors** are one line on standard error that begins with `error:`. `-v` (`--verbose`), before or
  after the command, shows the traceback as well.
- **`--json`** prints JSON on standard output and nothing else; progress and messages go to standard
  error.
- **Completion**: `leglab --install-completion` sets it up for bash, zsh, fish or PowerShell. It
  completes commands, options, the names of scenarios, controllers, references, models, effects and
  formats, and recordings by their suffix. Open a new shell afterwards.

| command | what it does |
|---|---|
"""


def page() -> str:
    """Returns the page."""
    status = ", ".join(f"{code} {text}" for code, text in EXIT_STATUS.items())
    lines = [HEAD.format(status=status).rstrip("\n")]
    commands = typer.main.get_command(app).commands
    for name, command in sorted(commands.items()):
        lines.append(f"| [`{name}`](#leglab-{name}) | {_text(command.help).splitlines()[0]} |")
    for name, command in sorted(commands.items()):
        lines += _section(name, command)
    return "\n".join(lines) + "\n"


def _section(name, command) -> list[str]:
    context = command.make_context(name, [], resilient_parsing=True)
    usage = " ".join(("leglab", name, *command.collect_usage_pieces(context)))
    lines = ["", f"## leglab {name}", "", _text(command.help), "", f"`{usage}`", ""]
    rows = [row for p in command.params if p.name != "help" for row in _rows(p, context)]
    if rows:
        lines += ["| argument or option | default | meaning |", "|---|---|---|", *rows]
    if name in EXAMPLES:
        lines += ["", "```sh", *EXAMPLES[name], "```"]
    return lines


def _rows(parameter, context) -> list[str]:
    meaning = _text(parameter.help)
    if parameter.param_type_name == "argument":
        label = " ".join(f"`{piece}`" for piece in parameter.get_usage_pieces(context))
        return [f"| {label} | {'required' if parameter.required else ''} | {meaning} |"]
    both = [*parameter.opts, *parameter.secondary_opts]
    label = ", ".join(f"`{option}`" for option in both)
    default = parameter.default
    if default is None or default is False or callable(default):
        shown = ""
    elif default is True:
        shown = f"`{parameter.opts[0]}`"
    else:
        shown = f"`{default}`"
    return [f"| {label} | {shown} | {meaning} |"]


def _text(text: str | None) -> str:
    return (text or "").replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(f"written to {PAGE}")
