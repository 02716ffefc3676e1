"""The gains file of `adaptive_backstepping`, and how it is made.

`python -m leglab.backstepping_gains` writes it anew (some minutes).
"""

import tomllib
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

import leglab.controllers
from leglab.backstepping.data import BacksteppingGains
from leglab.gains import TUNED_MODELS
from leglab.measurement import SensorConfiguration
from leglab.simulation import Simulation, load_model

GAINS_FILE = Path(leglab.controllers.__path__[0]) / "backstepping_gains.toml"
_NAMES = tuple(field.name for field in fields(BacksteppingGains))
_TIMING = ("control_period", "latency")


def gains_text(models: Sequence[str]) -> str:
    """Tunes models for the default sensors and formats the gains as TOML."""
    from leglab.backstepping_tuning import (
        SENSITIVITY,
        SLOW_SENSITIVITY,
        VALVE_SHARE,
        joint_loop,
        tuned_gains,
    )

    sensors = SensorConfiguration()
    lines = [
        "# Gains of adaptive_backstepping by `python -m leglab.backstepping_gains`: the smallest",
        f"# response to unknown flow and force with a sensitivity of at most {SENSITIVITY:g}",
        "# at every pose and piston speed of the linearised nominal plant, slowed down for",
        f"# {SLOW_SENSITIVITY:g} at {VALVE_SHARE:g} times the valves' bandwidth. Not to be edited.",
    ]
    for model in models:
        lines += ["", f"[{model}]"]
        lines += [f"{name} = {getattr(sensors, name)!r}" for name in _TIMING]
        simulation = Simulation(load_model(model))
        for joint, name in enumerate(simulation.joints):
            gains = tuned_gains(simulation, joint, sensors)
            response, peak = joint_loop(simulation, joint, sensors).judge(gains)
            values = [f"{key} = {getattr(gains, key)[0]:.4g}" for key in _NAMES]
            values += [f"response = {response:.3g}", f"sensitivity = {peak:.3f}"]
            lines.append(f"joints.{name} = {{ {', '.join(values)} }}")
            print(lines[-1], flush=True)
    return "\n".join(lines) + "\n"


def backstepping_gains(
    model: str, simulation: Simulation, sensors: SensorConfiguration
) -> BacksteppingGains:
    """Gains of a shipped model from `GAINS_FILE`; for others, and other timing, tuned now.

    Args:
        model: Name or path of the model.
        simulation: The nominal machine in its rest pose, where it is left.
        sensors: Sensors and timing.
    """
    file = tomllib.loads(GAINS_FILE.read_text()) if GAINS_FILE.exists() else {}
    stored = file.get(str(model), {})
    joints = stored.get("joints", {})
    known = all(stored.get(name) == getattr(sensors, name) for name in _TIMING)
    if known and all(name in joints for name in simulation.joints):
        rows = [joints[name] for name in simulation.joints]
        return BacksteppingGains(**{key: np.array([row[key] for row in rows]) for key in _NAMES})
    # Needs python-control, which takes a second to import.
    from leglab.backstepping_tuning import tuned_gains

    tuned = [tuned_gains(simulation, joint, sensors) for joint in range(len(simulation.joints))]
    return BacksteppingGains(
        **{key: np.concatenate([getattr(gains, key) for gains in tuned]) for key in _NAMES}
    )


if __name__ == "__main__":
    GAINS_FILE.write_text(gains_text(TUNED_MODELS))
