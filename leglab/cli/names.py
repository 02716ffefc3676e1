"""Names for shell completion and help, found without importing what they name.

Scenarios and controllers are called like their files, models like their MJCF; the others are
listed. A test compares all of them with the registries.
"""

from collections.abc import Callable
from pathlib import Path

_PACKAGE = Path(__file__).parent.parent

EFFECTS = (
    "actuator_gain", "armature", "asymmetric_friction", "backlash", "base_tilt",
    "command_bandwidth", "command_bias", "command_deadband", "command_delay",
    "command_hysteresis", "coulomb_friction", "encoder_offset", "encoder_scale", "entrained_air",
    "external_leakage", "force_offset", "internal_leakage", "load_dependent_friction",
    "oil_viscosity", "payload", "pressure_dependent_friction", "quadratic_damping", "sensor_delay",
    "spring_hardening", "spring_offset", "spring_stiffness", "stiction", "supply_droop",
    "supply_pressure", "valve_bandwidth", "valve_bias", "valve_deadband", "valve_gain",
    "valve_gain_asymmetry", "valve_hysteresis", "viscous_friction",
)  # fmt: skip
"""Several classes may stand behind one name, and loading them takes MuJoCo: so they are listed."""

REFERENCES = ("random_stride", "sine_sweep", "squat", "step", "walking_stride")
"""Registered references."""

FORMATS = ("parquet", "csv", "mcap", "matlab", "sysid", "plotjuggler")
"""What `leglab.data.write` knows."""

RECORDINGS = (".parquet", ".csv", ".mcap", ".mat", ".npz")
"""Suffixes that `leglab.data.read` knows."""


def scenarios() -> tuple[str, ...]:
    """Names of scenarios."""
    return _files("scenarios", "*.py")


def controllers() -> tuple[str, ...]:
    """Names of controllers."""
    return _files("controllers", "*.py")


def references() -> tuple[str, ...]:
    """Names of references."""
    return REFERENCES


def models() -> tuple[str, ...]:
    """Names of the models that ship with leglab."""
    return _files("models", "*.xml")


def effects() -> tuple[str, ...]:
    """Names of effects that a diagnosis considers."""
    return EFFECTS


def formats() -> tuple[str, ...]:
    """Names of recording formats."""
    return FORMATS


def completion(names: Callable[[], tuple[str, ...]]) -> Callable[[str], list[str]]:
    """Returns a completion function for typer: the names that begin with what is typed."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return complete


def list_completion(names: Callable[[], tuple[str, ...]]) -> Callable[[str], list[str]]:
    """The same for names separated by commas; none is offered twice."""

    def complete(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",")
        taken = before.split(",")
        return [
            before + comma + name for name in names() if name.startswith(last) and name not in taken
        ]

    return complete


def path_completion(
    *suffixes: str, names: Callable[[], tuple[str, ...]] = tuple
) -> Callable[[str], list[str]]:
    """Returns a completion function: names, files with one of the suffixes, folders."""

    def complete(incomplete: str) -> list[str]:
        found = [name for name in names() if name.startswith(incomplete)]
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


def _files(folder: str, pattern: str) -> tuple[str, ...]:
    found = (path.stem for path in (_PACKAGE / folder).glob(pattern))
    return tuple(sorted(name for name in found if not name.startswith("_")))
