"""The gains file: PD gains of the shipped models, written by `leglab tune`."""

import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

import leglab.controllers
from leglab.measurement import SensorConfiguration
from leglab.simulation import Simulation, load_model

# Tuned once by `leglab tune`, and not touched afterwards.
GAINS_FILE = Path(leglab.controllers.__path__[0]) / "pd_gains.toml"
TUNED_MODELS = ("knee_bench", "leg", "leg_rail")


def gains_text(models: Sequence[str], progress: Callable[[str], None]) -> str:
    """Tunes models for the default sensors and formats the gains as TOML."""
    from leglab.tuning import GAIN_MARGIN_DB, PHASE_MARGIN_DEG, tune

    sensors = SensorConfiguration()
    lines = [
        "# PD gains by `leglab tune --write`: the greatest K_p that keeps "
        f"{GAIN_MARGIN_DB:g} dB and {PHASE_MARGIN_DEG:g} degrees",
        "# at every pose and piston speed of the linearised plant. Not to be edited by hand.",
    ]
    for model in models:
        lines += [
            "",
            f"[{model}]",
            f"control_period = {sensors.control_period!r}",
            f"latency = {sensors.latency!r}",
            f"velocity_cutoff = {sensors.velocity_cutoff!r}",
        ]
        simulation = Simulation(load_model(model))
        for i, joint in enumerate(simulation.joints):
            progress(f"{model} {joint}")
            simulation.reset()
            gains = tune(simulation, i, sensors=sensors)
            lines.append(
                f"joints.{joint} = {{ position = {gains.position:.4g}, "
                f"velocity = {gains.velocity:.4g}, gain_margin_db = {gains.gain_margin_db:.2f}, "
                f"phase_margin_deg = {gains.phase_margin_deg:.1f}, "
                f"crossover = {gains.crossover:.2f} }}"
            )
    return "\n".join(lines) + "\n"


def stored_gains(
    model: str, simulation: Simulation, sensors: SensorConfiguration
) -> list[tuple[float, float]] | None:
    """Gains of a shipped model from `GAINS_FILE`; None where it has none for this loop."""
    if not GAINS_FILE.exists():
        return None
    entry = tomllib.loads(GAINS_FILE.read_text()).get(str(model))
    timing = ("control_period", "latency", "velocity_cutoff")
    if entry is None or any(entry[name] != getattr(sensors, name) for name in timing):
        return None
    joints = entry["joints"]
    if any(name not in joints for name in simulation.joints):
        return None
    return [(joints[name]["position"], joints[name]["velocity"]) for name in simulation.joints]


def tuned_gains(model: str, sensors: SensorConfiguration) -> list[tuple[float, float]]:
    """Gains tuned now, for a model or a timing without stored ones."""
    from leglab.tuning import tune  # needs python-control, which takes a second to import

    simulation = Simulation(load_model(model))
    result = []
    for joint in range(len(simulation.joints)):
        simulation.reset()
        gains = tune(simulation, joint, sensors=sensors)
        result.append((gains.position, gains.velocity))
    return result
