"""Options that several commands share, and the names that they take.

Names for shell completion and help are collected without importing the named objects. Scenarios and
effects are in the table of causes; other scenarios and controllers are named after their files,
models after their MJCF files; the rest is listed. A test compares all names with the registries.
"""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from leglab.base import plugins
from leglab.base.errors import SettingsError

if TYPE_CHECKING:
    from leglab.runs.preparation import RunSettings

Scenario = Annotated[str, typer.Argument(help="What happens to the machine.")]
ScenarioOrFile = Annotated[
    str,
    typer.Argument(
        help="What happens to the machine, or a file with settings: TOML, or the run.json of a run."
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="SECTION.SETTING=VALUE",
        help="A setting of the controller, the reference or the sensors, for instance "
        "controller.memory=1500; repeatable.",
    ),
]
Controller = Annotated[str, typer.Option(help="What drives it.")]
Model = Annotated[str, typer.Option(help="Machine.")]
Duration = Annotated[float | None, typer.Option(help="Seconds; default: the scenario's.")]
Seed = Annotated[int, typer.Option(help="Seed of sensor noise and of everything drawn.")]
Severity = Annotated[
    float | None, typer.Option(help="Size of the change, in the scenario's own unit.")
]
Ramp = Annotated[float, typer.Option(help="Seconds the change takes; 0 is a step.")]
Element = Annotated[
    str | None,
    typer.Option(help="Joint to which it happens alone; `leglab list` says which scenarios can."),
]
Reference = Annotated[
    str | None,
    typer.Option(help="Reference, or a file with positions of joints; default: the scenario's."),
]
Tolerance = Annotated[
    float,
    typer.Option(
        help="Relative standard deviation of the machine's parameters about those that controllers "
        "know; the seed picks the specimen."
    ),
]
Vary = Annotated[
    bool,
    typer.Option(
        "--vary",
        help="The seed also draws when the machine changes (a tenth of the run about its own "
        "time) and the motion's phase.",
    ),
]
Camera = Annotated[str, typer.Option(help="Camera of the model.")]
Jobs = Annotated[int, typer.Option(help="Processes at a time; -1: one a core.")]
ReplaceSweep = Annotated[
    bool, typer.Option("--overwrite", help="Replace the sweep that the folder holds.")
]
Scheduler = Annotated[
    str | None, typer.Option(help="Dask scheduler whose workers do the work, as tcp://HOST:PORT.")
]
MachineArgument = Annotated[str, typer.Argument(help="Machine.")]
Out = Annotated[Path, typer.Option(help="Output folder.")]
_READ = typer.Argument(help="Recordings: .parquet, .csv, .mcap, .mat, .npz, or folders of them.")
Recordings = Annotated[list[Path], _READ]
SomeRecordings = Annotated[list[Path] | None, _READ]
From = Annotated[
    float | None,
    typer.Option("--from", metavar="S", help="Ignore samples before this time, in seconds."),
]
To = Annotated[
    float | None,
    typer.Option("--to", metavar="S", help="Ignore samples from this time on, in seconds."),
]
Salvage = Annotated[
    bool,
    typer.Option(
        "--salvage", help="Read the intact part of a damaged file and report what is lost."
    ),
]
Which = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Which recording of a file or dataset that holds several."),
]
HeldOut = Annotated[
    list[str] | None,
    typer.Option(help="Recording kept from all fits, repeatable; default: chosen by excitation."),
]
FixBase = Annotated[
    bool, typer.Option("--fix-base", help="Hold bodies with a free joint where the model has them.")
]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace the folder of an earlier run.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
Columns = Annotated[
    Path | None, typer.Option(help="TOML file: what the columns are called here, and their units.")
]

Load = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FILE_OR_MODULE",
        help="Python file or module that registers controllers, scenarios, references, effects or "
        "models; repeatable.",
    ),
]

RECORDINGS = (".parquet", ".csv", ".txt", ".tsv", ".log", ".dat", ".mcap", ".mat", ".npz")
"""Suffixes that `leglab.data.read` knows."""

_PACKAGE = Path(__file__).parent.parent
_FILES = {"scenarios": "*.py", "controllers": "*.py", "models": "*.xml"}
# Effects that no cause names. They are listed because several classes may share one name, and
# because loading the classes imports MuJoCo.
_EFFECTS = (
    "actuator_gain", "armature", "asymmetric_friction", "backlash", "base_tilt", "cogging",
    "command_bandwidth", "command_bias", "command_deadband", "command_deadband_asymmetry",
    "command_delay", "command_gain", "command_gain_asymmetry", "command_hysteresis",
    "command_saturation", "encoder_scale", "force_offset", "force_saturation", "joint_flexibility",
    "load_dependent_friction", "pressure_dependent_friction", "pressure_sensor_offset",
    "pressure_sensor_scale", "quadratic_damping", "sensor_delay", "servo_stiffness",
    "spring_hardening", "spring_offset", "valve_gain", "valve_gain_asymmetry", "valve_null_leakage",
)  # fmt: skip
_LISTED = {
    "effects": _EFFECTS,
    "references": (
        "file",
        "multisine",
        "random_stride",
        "sine_sweep",
        "squat",
        "step",
        "walking_stride",
    ),
    "formats": ("parquet", "csv", "mcap", "matlab", "sysid"),
}


def given_for(kind: type, context: typer.Context) -> dict[str, Any]:
    """Returns the options of a command that have the names of a dataclass's fields."""
    from dataclasses import fields

    given = {**context.params, "ramp_duration": context.params["ramp"]}
    return {field.name: given[field.name] for field in fields(kind) if field.name in given}


def settings_of(context: typer.Context) -> "RunSettings":
    """Builds the settings of a run from the options of a command that have the settings' names.

    If the scenario is a file of settings, options that the user gives override the file's settings;
    entries of `--set` override both.

    Raises:
        LeglabError: A name or value of the file or of an entry is not allowed.
    """
    from leglab.cli.terminal import complain
    from leglab.runs import run_settings
    from leglab.runs.folder import model_note
    from leglab.runs.preparation import RunSettings

    values = given_for(RunSettings, context)
    file = Path(values["scenario"])
    if file.suffix in run_settings.SUFFIXES:
        sources = {name: context.get_parameter_source(name) for name in context.params}
        sources |= {"ramp_duration": sources["ramp"], "scenario": None}
        told = {n: v for n, v in values.items() if getattr(sources[n], "name", "") == "COMMANDLINE"}
        values = run_settings.read_settings(file)
        for line in run_settings.replace_names(values, told):
            complain(f"{file}: {line}", "warning")
        if file.suffix == ".json" and "model" not in told and (note := model_note(file)):
            complain(note, "warning")
    values = run_settings.with_entries(values, context.params.get("set_") or ())
    return RunSettings(**values)


def check_order(model: str, recordings: Sequence[Path]) -> None:
    """Raises `LeglabError` if a recording is given in place of the model."""
    if Path(model).suffix in RECORDINGS:
        other = next((str(path) for path in recordings if path.suffix == ".xml"), "an MJCF file")
        text = f"{model} is a recording: the model comes first, "
        raise SettingsError(text, given=model, allowed=f"{other} {model}")


def check_jobs(jobs: int, name: str = "jobs") -> None:
    """Raises `LeglabError` unless the number of processes is -1, or from 1 to 16 per core."""
    most = 16 * (os.cpu_count() or 1)
    if jobs != -1 and not 1 <= jobs <= most:
        allowed = f"1 to {most}, or -1 for one a core"
        raise SettingsError(f"{name} is {jobs}; allowed: ", given=jobs, allowed=allowed)


def split(names: str) -> list[str]:
    """Returns names that are separated by commas."""
    return [name.strip() for name in names.split(",") if name.strip()]


def names_of(kind: str) -> tuple[str, ...]:
    """Returns the names of all scenarios, controllers, models, effects, references or formats.

    Plug-ins are included by the names of their entry points.
    """
    if kind == "formats":
        return _LISTED[kind]
    if kind in _LISTED:
        found = set(_LISTED[kind])
    else:
        found = {path.stem for path in (_PACKAGE / kind).glob(_FILES[kind])}
    if kind in ("scenarios", "effects"):
        from leglab.causes.table import names

        found.update(names(kind))
    found.update(plugins.entry_points(kind))
    return tuple(sorted(name for name in found if not name.startswith("_")))


def completion(kind: str) -> Callable[[str], list[str]]:
    """Returns a completion function for typer: the names that begin with what is typed."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in names_of(kind) if name.startswith(incomplete)]

    return complete


def controllers_after(incomplete: str) -> list[str]:
    """Completes a list of controllers separated by commas; offers none that it already has."""
    before, comma, last = incomplete.rpartition(",")
    left = (name for name in names_of("controllers") if name not in before.split(","))
    return [before + comma + name for name in left if name.startswith(last)]


def path_completion(*suffixes: str, kind: str | None = None) -> Callable[[str], list[str]]:
    """Returns a completion function: names of a kind, files with one of the suffixes, folders."""

    def complete(incomplete: str) -> list[str]:
        found = completion(kind)(incomplete) if kind else []
        typed = Path(incomplete)
        folder = typed if incomplete.endswith("/") else typed.parent
        start = "" if incomplete.endswith("/") else typed.name
        prefix = incomplete.removesuffix(start) if start else incomplete
        if not folder.is_dir():
            return found
        for path in sorted(folder.iterdir()):
            if path.name.startswith(start) and (start or not path.name.startswith(".")):
                if path.is_dir():
                    found.append(f"{prefix}{path.name}/")
                elif path.suffix in suffixes:
                    found.append(f"{prefix}{path.name}")
        return found

    return complete
