"""The help of all commands as Markdown: `python -m leglab.cli_help > docs/command_help.md`."""

from typing import Any

import typer.main

from leglab.cli import app


def markdown() -> str:
    """A section a command: what it does, its arguments and options with their defaults."""
    lines = [
        "# Commands",
        "",
        "Made by `python -m leglab.cli_help > docs/command_help.md`, from what `--help` says.",
        "Exit status: 0 done, 1 a check failed, 2 bad input (one line on stderr), 130 interrupted.",
    ]
    group: Any = typer.main.get_command(app)
    for name, command in sorted(group.commands.items()):
        usage = " ".join(_argument(p) for p in command.params if p.param_type_name == "argument")
        lines += ["", f"## leglab {name}", "", " ".join(["`leglab", name, usage]).strip() + "`", ""]
        lines += [line.strip() for line in (command.help or "").strip().splitlines()]
        rows = [_row(parameter) for parameter in command.params if parameter.name != "help"]
        if rows:
            lines += ["", "| argument or option | default | what |", "|---|---|---|", *rows]
    return "\n".join(lines) + "\n"


def _argument(parameter: Any) -> str:
    name = parameter.name.upper() + ("..." if parameter.nargs == -1 else "")
    return name if parameter.required else f"[{name}]"


def _row(parameter: Any) -> str:
    option = parameter.param_type_name == "option"
    if option:
        names = ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
    else:
        names = f"`{_argument(parameter)}`"
    value = parameter.default
    flag = option and parameter.is_flag
    empty = value is None or value == () or value == [] or (flag and not value)
    default = "" if empty or parameter.required else ("yes" if flag else f"`{value}`")
    what = (parameter.help or "").replace("|", "\\|").replace("<", "\\<")
    return f"| {names} | {default} | {what} |"


if __name__ == "__main__":
    print(markdown(), end="")
