"""Conventions of all commands: examples, groups of options, completion, one-line errors."""

import inspect
import io
import os
import signal
import sys
import threading
import traceback
import typing
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.models import OptionInfo, ParameterInfo

from leglab.base import plugins
from leglab.base.errors import LeglabError, SettingsError
from leglab.cli.options import RECORDINGS, completion, controllers_after, names_of, path_completion
from leglab.cli.terminal import BAD_INPUT, DONE, FAILED, INTERRUPTED, complain, errors

EXIT_STATUS = {
    DONE: "done",
    FAILED: "a check or every run failed",
    BAD_INPUT: "bad input, or a run that broke off",
    INTERRUPTED: "interrupted",
}

EXAMPLES = {
    "run": (
        "leglab run seal_wear --controller static_feedforward",
        "leglab run cold_oil --model knee_bench --ramp 2 --seed 3",
        "leglab run nominal --reference random_stride --json > metrics.json",
        "leglab run seal_wear --controller bsnn_arx --set controller.memory=1500",
        "leglab run runs/seal_wear-pd-leg-0/run.json --out runs/again",
    ),
    "compare": (
        "leglab compare seal_wear hot_oil --controllers pd,bsnn_arx --seeds 5",
        "leglab compare seal_wear --tolerance 0.1 --out runs/specimens --jobs 2",
    ),
    "sweep": (
        "leglab sweep sweep.toml --out out/sweep",
        "leglab sweep sweep.toml --out out/sweep --scheduler tcp://10.0.0.1:8786",
    ),
    "benchmark": (
        "leglab benchmark adaptation --controllers bsnn_arx,arx",
        "leglab benchmark adaptation --controllers overlap --load overlap.py --specimens 3",
    ),
    "query": (
        'leglab query out/sweep "SELECT controller, median(t90_s) FROM runs GROUP BY controller"',
        "leglab query out/sweep \"SELECT run, error FROM runs WHERE status = 'failed'\" --json",
    ),
    "diagnose": (
        "leglab diagnose knee_bench rec --from 2 --out out/knee",
        "leglab diagnose knee_bench after/*.parquet --healthy before/*.parquet",
        "leglab diagnose axis.xml log.mcap --columns map.toml --effect backlash",
    ),
    "improve": (
        "leglab improve knee_bench rec/*.parquet --out out/better",
        "leglab improve axis.xml log.mcap --columns map.toml --no-effects",
    ),
    "fit": (
        "leglab fit knee_bench rec/*.parquet --parameter knee_valve:viscous_friction",
        "leglab fit axis.xml log.mcap --parameter slide:armature --parameter "
        "slide:coulomb_friction=0:50",
    ),
    "identify": (
        "leglab identify train.csv --test test.csv",
        "leglab identify log.mat --input valve --output pressure --period 0.01",
    ),
    "convert": (
        "leglab convert run.parquet run.mat",
        "leglab convert log.mcap run.parquet --columns map.toml",
    ),
    "inspect": (
        "leglab inspect log.mcap --plot log.png",
        "leglab inspect log.csv --model arm.xml --out map.toml",
        "leglab inspect run.csv --json | jq .rate_hz",
    ),
    "list": (
        "leglab list",
        "leglab list bsnn_arx",
        "leglab list --json | jq -r '.scenarios | keys[]'",
    ),
    "video": (
        "leglab video runs/seal_wear-pd-leg-0",
        "leglab video runs/seal_wear-*-leg-0 --start 8 --duration 6 --out film.mp4",
    ),
    "report": (
        "leglab report --scenario seal_wear --controllers pd,static_feedforward,bsnn_arx",
        "leglab report runs/a runs/b --out out/a_b --start 8 --duration 6",
    ),
    "index": ("leglab index runs", "leglab index runs --json | jq '.[].told'"),
    "view": ("leglab view seal_wear", "leglab view cold_oil --controller pd --model knee_bench"),
    "tune": ("leglab tune --model knee_bench", "leglab tune --write"),
    "replicate": ("leglab replicate", "leglab replicate --instances 10 --out out/quick"),
    "verify": ("leglab verify", "leglab verify --json > verification.json"),
    "doctor": ("leglab doctor", "leglab doctor --json > doctor.json"),
    "parameters": (
        "leglab parameters leglab.cylinder",
        "leglab parameters --markdown > docs/reference/parameters.md",
    ),
}
"""Two or three lines for the shell by command."""

# Python names of the command parameters that each panel of the help text shows.
_PANELS = {
    "What runs": (
        "scenario", "scenarios", "controller", "controllers", "model", "models", "reference",
        "duration", "severity", "ramp", "element", "seed", "seeds", "timestep", "tolerance",
        "set_", "load",
    ),
    "Data": ("recordings", "held_out", "columns", "recording", "since", "until", "salvage", "to"),
    "Output": ("out", "overwrite", "figures", "as_json", "markdown", "write", "csv"),
}  # fmt: skip

# Kind of the names that the help text of a parameter lists, by the parameter's Python name.
_LISTED = {
    "scenario": "scenarios",
    "scenarios": "scenarios",
    "controller": "controllers",
    "controllers": "controllers",
    "reference": "references",
    "model": "models",
    "to": "formats",
}

_COMPLETION: dict[str, Callable[[str], list[str]]] = {
    **{parameter: completion(kind) for parameter, kind in _LISTED.items()},
    "controllers": controllers_after,
    "scenario": path_completion(".toml", ".json", kind="scenarios"),
    "model": path_completion(".xml", kind="models"),
    "models": completion("models"),
    "effect": completion("effects"),
    "recordings": path_completion(*RECORDINGS),
    "healthy": path_completion(*RECORDINGS),
    "columns": path_completion(".toml"),
    "load": path_completion(".py"),
}

# Values of the environment variable MUJOCO_GL that MuJoCo accepts.
_OPENGL = (
    "egl", "osmesa", "glfw", "glx", "enable", "enabled", "on", "true", "1",
    "disable", "disabled", "off", "false", "0",
)  # fmt: skip

# Options with an optional value: suffix that marks a value, and the value that stands for none.
_DEFAULTS = {"--plot": (".png", "-")}

# Options that take all words up to the next option, because a shell expands `*` to several words.
_SEVERAL = ("--healthy",)

# Exception class of typer for wrong arguments, whose name is not public.
_UsageError: Any = typer.BadParameter.__base__


class Commands(TyperGroup):
    """Group of the commands; an interrupted command reports this and ends with status 130."""

    def invoke(self, ctx: Any) -> Any:
        """Runs the command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            errors.print("[red]interrupted[/red]")
            raise typer.Exit(INTERRUPTED) from None


class Command(TyperCommand):
    """Command that imports the plug-ins of its option `--load` before it runs."""

    def invoke(self, ctx: Any) -> Any:
        """Runs the command."""
        for source in ctx.params.get("load") or ():
            plugins.load(source)
        return super().invoke(ctx)


def exit_status() -> str:
    """Returns one line with all exit statuses."""
    return "Exit status: " + ", ".join(f"{code} {text}" for code, text in EXIT_STATUS.items())


def explain(app: typer.Typer) -> None:
    """Adds examples, panels, completion and allowed values to all commands of an application.

    A second call changes nothing.
    """
    for command in app.registered_commands:
        assert command.callback is not None
        name = command.name or command.callback.__name__
        # \b keeps the line breaks of a paragraph.
        command.epilog = "\n".join(("\b", "Examples:", *(f"  {e}" for e in EXAMPLES[name])))
        paragraphs = inspect.cleandoc(command.callback.__doc__ or "").split("\n\n")
        command.help = "\n\n".join(" ".join(text.split()) for text in paragraphs)
        for parameter, hint in typing.get_type_hints(command.callback, include_extras=True).items():
            for info in getattr(hint, "__metadata__", ()):
                if isinstance(info, ParameterInfo):
                    _explain(parameter, info)


def execute(app: typer.Typer, arguments: Sequence[str]) -> None:
    """Runs a command line; wrong input is one line on stderr.

    Args:
        app: The application.
        arguments: Words of the command line; -v or --verbose before any `--` adds error tracebacks.

    Raises:
        SystemExit: The command does not succeed; the status is one of `EXIT_STATUS`.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # Escapes letters that the encoding lacks.
            stream.reconfigure(errors="backslashreplace")
    given = list(arguments)
    end = given.index("--") if "--" in given else len(given)
    kept = [a for a in given[:end] if a not in ("-v", "--verbose")]
    try:
        with _ends_cleanly():
            _check_opengl()
            status = app(args=spread(kept) + given[end:], prog_name="leglab", standalone_mode=False)
    except (LeglabError, _UsageError) as error:
        if len(kept) < end:
            traceback.print_exc()
        text = error.format_message() if isinstance(error, _UsageError) else str(error)
        if text:  # Empty if the help was printed, since no command was given.
            complain(text)
        sys.exit(BAD_INPUT)
    except BrokenPipeError:  # The program that reads the output has closed it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.exit(128 + signal.SIGPIPE)
    except (OSError, MemoryError, ImportError) as error:  # Disk, memory or a package is lacking.
        if len(kept) < end:
            traceback.print_exc()
        if _written_to_the_end():
            named = getattr(error, "filename", None)
            what = f"{named}: " if named else ""
            reason = getattr(error, "strerror", None) or str(error) or "out of memory"
            complain(f"{what}{reason.splitlines()[0]}")
        sys.exit(BAD_INPUT)
    if not _written_to_the_end():
        sys.exit(BAD_INPUT)
    if isinstance(status, int) and status:
        sys.exit(status)


def _check_opengl() -> None:
    """Rejects a MUJOCO_GL with which the import of MuJoCo would end in a traceback."""
    chosen = os.environ.get("MUJOCO_GL", "")
    if chosen.lower().strip() not in ("", *_OPENGL):
        raise SettingsError(f"MUJOCO_GL is {chosen!r}; allowed: ", given=chosen, allowed=_OPENGL)


def _written_to_the_end() -> bool:
    """Tests whether all output reached standard output; prints an error if it did not."""
    try:
        sys.stdout.flush()
    except OSError as error:
        complain(f"standard output cannot be written: {error.strerror}")
        # Discards the remaining output, which Python would fail to write again when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return False
    return True


@contextmanager
def _ends_cleanly() -> Iterator[None]:
    """Converts SIGTERM and SIGHUP to SystemExit: workers end and partial output is removed then."""

    def end(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    numbers = [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) == signal.SIG_DFL]
    if threading.current_thread() is not threading.main_thread():
        numbers = []
    for number in numbers:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)


def spread(arguments: Sequence[str]) -> list[str]:
    """Repeats options of `_SEVERAL` before each of their words, and adds the values in `_DEFAULTS`.

    Otherwise all files of `--healthy before/*.csv` but the first would be recordings of the fault.
    """
    found: list[str] = []
    option = ""
    for argument, following in zip(arguments, [*arguments, ""][1:], strict=True):
        if argument.startswith("-"):
            option = argument if argument in _SEVERAL else ""
        elif option and found[-1] != option:
            found.append(option)
        found.append(argument)
        if argument in _DEFAULTS and not following.endswith(_DEFAULTS[argument][0]):
            found.append(_DEFAULTS[argument][1])
    return found


def _explain(parameter: str, info: ParameterInfo) -> None:
    if isinstance(info, OptionInfo):
        panels = (panel for panel, names in _PANELS.items() if parameter in names)
        info.rich_help_panel = next(panels, None)
    info.autocompletion = _COMPLETION.get(parameter)
    if parameter in _LISTED:
        also = ("an MJCF file",) if parameter == "model" else ()
        allowed = f"One of: {', '.join((*names_of(_LISTED[parameter]), *also))}."
        if info.help is not None and allowed not in info.help:
            info.help = f"{info.help} {allowed}"
