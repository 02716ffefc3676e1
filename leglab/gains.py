"""The gains file: PD gains of the shipped models, written by `leglab tune`."""

from collections.abc import Callable, Sequence

from leglab.measurement import SensorConfiguration
from leglab.simulation import Simulation, load_model
from leglab.tuning import GAIN_MARGIN_DB, PHASE_MARGIN_DEG, tune

TUNED_MODELS = ("knee_bench", "leg", "leg_rail")


def gains_text(models: Sequence[str], progress: Callable[[str], None]) -> str:
    """Tunes models for the default sensors and formats the gains as TOML."""
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
