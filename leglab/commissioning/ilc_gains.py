"""Tuning of the learning filter of `ilc`: the greatest cutoff that converges on the linear plant.

Filters of the shipped models are stored in `ilc_gains.toml`, which
`python -m leglab.commissioning.ilc_gains` rewrites.
"""

from pathlib import Path

import numpy as np

from leglab.commissioning.adrc_gains import speeds_per_command
from leglab.commissioning.gains_file import GAINS, ControllerGains, Row
from leglab.commissioning.pd_gains import sampled_plants, stored_gains, tuned_gains
from leglab.control.iterative_learning import LearningFilter, learning_function, q_filter
from leglab.machine.sensors import SensorConfiguration, velocity_filter_coefficient
from leglab.machine.simulation import Simulation, load_model

# Largest share of an error, at any frequency, that may remain from one stride to the next.
CONTRACTION = 0.7
_CUTOFFS = np.geomspace(3.0, 300.0, 93)  # cutoffs to try [rad/s]
_LEADS = np.arange(13) / 2  # leads to try [control periods]


def closed_loops(
    simulation: Simulation,
    joint: int,
    sensors: SensorConfiguration,
    gains: tuple[float, float],
    frequency: np.ndarray,
) -> np.ndarray:
    """Computes responses of measured position [rad] to a command added to `pd`'s, (points, n).

    A point is a pose, a piston speed, and the other joints free or held.

    Args:
        simulation: The nominal machine; its positions are changed.
        joint: Index of the joint.
        sensors: Sensors and timing.
        gains: Gains of `pd` [1/rad], [s/rad].
        frequency: [rad/s], (n,).
    """
    z = np.exp(1j * frequency * sensors.control_period)
    alpha = velocity_filter_coefficient(sensors.control_period, sensors.velocity_cutoff)
    derivative = alpha * (1 - 1 / z) / sensors.control_period / (1 - (1 - alpha) / z)
    feedback = gains[0] + gains[1] * derivative
    responses = [
        plant(z).ravel()
        for held in (False, True)
        for plant in sampled_plants(simulation, joint, sensors, held=held)
    ]
    return np.array([response / (1 + response * feedback) for response in responses])


def _tuned_filter(
    simulation: Simulation,
    joint: int,
    sensors: SensorConfiguration,
    gains: tuple[float, float],
    speed_per_command: float,
) -> tuple[float, float]:
    """Finds cutoff [rad/s] and lead d [s]: the greatest cutoff with |Q (1 - L G)| <= `CONTRACTION`.

    The condition is required at every frequency, pose and piston speed, with the other joints free
    and held. It makes errors shrink monotonically from stride to stride (Bristow, Tharayil and
    Alleyne 2006). If no cutoff satisfies it, the smallest cutoff is returned.
    """
    frequency = np.geomspace(0.1, 2 * _CUTOFFS[-1], 1500)
    loops = closed_loops(simulation, joint, sensors, gains, frequency)
    best = (float(_CUTOFFS[0]), 0.0)
    for lead in _LEADS * sensors.control_period:
        learning = learning_function(
            frequency,
            lead=float(lead),
            speed_per_command=speed_per_command,
            crossover=gains[0] * speed_per_command,
        )
        left = np.abs(1 - learning * loops).max(axis=0)
        for cutoff in _CUTOFFS:
            if (q_filter(frequency, cutoff) * left).max() > CONTRACTION:
                break
            if cutoff > best[0]:
                best = (float(cutoff), float(lead))
    return best


def _rows(model: str, simulation: Simulation, sensors: SensorConfiguration) -> list[Row]:
    speeds = speeds_per_command(simulation)
    gains = stored_gains(model, simulation, sensors) or tuned_gains(
        Simulation(load_model(model)), sensors
    )
    rows = []
    for joint, speed in enumerate(speeds.tolist()):
        simulation.reset()
        cutoff, lead = _tuned_filter(simulation, joint, sensors, gains[joint], speed)
        rows.append({"cutoff": cutoff, "lead": lead, "speed_per_command": speed})
    return rows


ILC = ControllerGains(
    path=Path(__file__).with_name("ilc_gains.toml"),
    head=(
        "Learning filters by `python -m leglab.commissioning.ilc_gains`: the greatest cutoff",
        f"at which a stride leaves at most {CONTRACTION:g} of any error to the next, at every",
        "pose and piston speed of the linearised nominal plant. Not to be edited by hand.",
    ),
    timing=("control_period", "latency", "velocity_cutoff"),
    formats=dict.fromkeys(("cutoff", "lead", "speed_per_command"), ".4g"),
    kind=LearningFilter,
    tune=_rows,
)
GAINS.add("ilc", ILC, _rows)

if __name__ == "__main__":
    ILC.write()
