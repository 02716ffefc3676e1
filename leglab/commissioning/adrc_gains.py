"""Tuning of the bandwidths of `adrc` on the linearised plant, with the stability margins of `pd`.

Bandwidths of the shipped models are stored in `adrc_gains.toml`, which
`python -m leglab.commissioning.adrc_gains` rewrites.
"""

import math
from dataclasses import asdict
from pathlib import Path

import numpy as np

from leglab.commissioning.calibration import drive_signs, valve_maps
from leglab.commissioning.gains_file import GAINS, ControllerGains, Row
from leglab.commissioning.pd_gains import (
    GAIN_MARGIN_DB,
    PHASE_MARGIN_DEG,
    native_plant,
    sampled_plants,
    stability_margins,
)
from leglab.control.extended_state_observer import DisturbanceGains, DisturbanceRejection
from leglab.control.feedforward.valve_table import ValveTable
from leglab.machine.sensors import SensorConfiguration
from leglab.machine.simulation import Simulation

# Ratios of control to observer bandwidth to try. Gao 2003 has a fast observer (1/5 to 1/3). With a
# lightly damped oil spring a slow observer may be better, so larger ratios are tried as well.
RATIOS = (0.1, 0.2, 0.33, 1.0, 3.0, 10.0, 30.0)
# Observer bandwidths to try [rad/s].
_TRIED = np.geomspace(0.3, 600.0, 160)
# For native actuators: ratios as above, and observer bandwidths to try [rad/s]. Their observer must
# be fast; the phase lag of a slow observer's integrator would reduce the law's phase margin.
FORCE_RATIOS = (0.05, 0.1, 0.2, 0.5)
_FORCE_TRIED = np.geomspace(3.0, 300.0, 30)
_FREQUENCIES = 1500


def plant_gain(simulation: Simulation, joint: int) -> tuple[float, int]:
    """Computes b_0 of a joint in the present pose, and its order, the number of integrations.

    A valve sets a speed: b_0 is speed per command by the calibrated map at mid-position. A native
    actuator sets an acceleration: b_0 is acceleration per filtered command, other joints free.
    """
    if simulation.actuators[joint] in simulation.native:
        plant = native_plant(simulation, joint, 0.0)
        # The command enters the acceleration directly, or through the actuator's filter state.
        a, b = np.asarray(plant.A), np.asarray(plant.B)
        return abs(float(b[1, 0] if len(a) == 2 else a[1, 2])), 2
    return float(speeds_per_command(simulation)[joint]), 1


def speeds_per_command(simulation: Simulation) -> np.ndarray:
    """Computes speed per command by the calibrated maps at mid-position [rad/s], (joints,)."""
    table = ValveTable.of(valve_maps(simulation), drive_signs(simulation))
    return table.full_speed / table.command_per_share()


class JointMargins:
    """Function of bandwidths to stability margins of one joint; linearises the plants once.

    Args:
        simulation: The nominal machine; its positions are changed.
        joint: Index of the joint.
        sensors: Sensors and timing.
    """

    def __init__(self, simulation: Simulation, joint: int, sensors: SensorConfiguration) -> None:
        self._plants = sampled_plants(simulation, joint, sensors)
        self._sensors, period = sensors, sensors.control_period
        self._frequencies = np.geomspace(0.05, 0.999 * math.pi / period, _FREQUENCIES)
        self._z = np.exp(1j * self._frequencies * period)
        self._responses = [plant(self._z).ravel() for plant in self._plants]

    def __call__(self, gains: DisturbanceGains) -> tuple[float, float, float]:
        """Computes the smallest gain margin [dB] and phase margin [deg], and the worst response.

        The response is the integrated squared error after a disturbance step of magnitude b_0. It
        is infinite if a margin is below the one required of `pd`, or if the loop is unstable.

        Args:
            gains: Gains of this object's joint alone.
        """
        sensors = self._sensors
        law = DisturbanceRejection(
            gains, np.ones(1), period=sensors.control_period, latency=sensors.latency
        ).linear(0)
        resolvent = self._z[:, None, None] * np.eye(len(law.a)) - law.a
        answer = np.linalg.solve(resolvent, law.b[None, :, None])[:, :, 0] @ law.c + law.d
        gain, phase, worst = math.inf, math.inf, 0.0
        for plant, response in zip(self._plants, self._responses, strict=True):
            loop = answer * response
            found = stability_margins(loop, self._frequencies, stable=True)
            gain, phase = min(gain, found[0]), min(phase, found[1])
            if gain < GAIN_MARGIN_DB or phase < PHASE_MARGIN_DEG:
                return gain, phase, math.inf
            b, c = plant.B, plant.C
            closed = np.block([[plant.A - law.d * b @ c, b * law.c], [-law.b[:, None] * c, law.a]])
            if np.abs(np.linalg.eigvals(closed)).max() >= 1.0:
                return -math.inf, -math.inf, math.inf
            error = np.abs(response / (1 + loop)) ** 2 / self._frequencies**2
            worst = max(worst, float(np.trapezoid(error, self._frequencies)) / math.pi)
        return gain, phase, worst


def tuned_gains(
    simulation: Simulation, joint: int, sensors: SensorConfiguration
) -> DisturbanceGains:
    """Finds the bandwidths with the smallest response to a disturbance at 6 dB and 45 degrees.

    The margins are required at the poses and piston speeds for which `pd` is tuned. For each ratio
    of the two bandwidths, both are raised until a margin is violated.

    Args:
        simulation: The nominal machine; its positions are changed.
        joint: Index of the joint.
        sensors: Sensors and timing.
    """
    gain, order = plant_gain(simulation, joint)
    judge, best = JointMargins(simulation, joint, sensors), math.inf
    ratios, tried = (RATIOS, _TRIED) if order == 1 else (FORCE_RATIOS, _FORCE_TRIED)
    chosen = _gains(ratios[0] * tried[0], tried[0], gain, order)
    for ratio in ratios:
        begun = order == 1
        for bandwidth in tried:
            gains = _gains(ratio * bandwidth, bandwidth, gain, order)
            response = judge(gains)[2]
            if not math.isfinite(response):
                if begun:
                    break
                continue  # the observer is too slow to damp the joint
            begun = True
            if response < best:
                chosen, best = gains, response
    return chosen


def _gains(control: float, observer: float, gain: float, order: int) -> DisturbanceGains:
    return DisturbanceGains(
        control_bandwidth=np.array([control]),
        observer_bandwidth=np.array([observer]),
        plant_gain=np.array([gain]),
        order=np.array([order]),
    )


def _rows(model: str, simulation: Simulation, sensors: SensorConfiguration) -> list[Row]:
    rows = []
    for joint in range(len(simulation.joints)):
        simulation.reset()
        gains = tuned_gains(simulation, joint, sensors)
        rows.append({name: values[0] for name, values in asdict(gains).items()})
    return rows


ADRC = ControllerGains(
    path=Path(__file__).with_name("adrc_gains.toml"),
    head=(
        "Bandwidths by `python -m leglab.commissioning.adrc_gains`: smallest response to a",
        f"disturbance with {GAIN_MARGIN_DB:g} dB and {PHASE_MARGIN_DEG:g} degrees at every "
        "pose and",
        "piston speed of the linearised nominal plant. Not to be edited by hand.",
    ),
    timing=("control_period", "latency"),
    formats=dict.fromkeys(
        ("control_bandwidth", "observer_bandwidth", "plant_gain", "order"), ".4g"
    ),
    kind=DisturbanceGains,
    tune=_rows,
)
GAINS.add("adrc", ADRC, _rows)

if __name__ == "__main__":
    ADRC.write()
