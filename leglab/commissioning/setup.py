"""What a controller may know of the nominal machine, from its data sheets and its calibration."""

import copy
import functools
import hashlib

import mujoco
import numpy as np

from leglab.commissioning.backstepping_gains import backstepping_gains
from leglab.commissioning.calibration import ValveMap, directions, valve_maps
from leglab.commissioning.nominal import NominalDynamics, nominal_cylinders
from leglab.commissioning.pd_gains import stored_gains, tuned_gains
from leglab.control import ControllerSetup
from leglab.machine.sensors import SensorConfiguration, position_uncertainty, velocity_delay
from leglab.machine.simulation import Simulation


def controller_setup(
    simulation: Simulation, model: str, sensors: SensorConfiguration
) -> ControllerSetup:
    """Measures what a controller may know.

    Items: `direction` (joints,), `position_gain`, `velocity_gain` (joints,), `valve_maps`;
    `latency` and `velocity_delay` of the sensors [s], their `position_noise` [rad] and
    `pressure_noise` [Pa]; `cylinders` and `inverse_dynamics`, the nominal hydraulics and rigid
    bodies, and `backstepping_gains` for them. What takes long is done when somebody asks. A run
    adds, for controllers that only serve as a yardstick, `first_change` and `last_change`, when the
    machine is about to change [s], and `bench_runs`, recordings of the machine before and after its
    changes.

    Args:
        simulation: The nominal machine in its rest pose.
        model: Its name, by which tuned gains are stored.
        sensors: Of the run.
    """

    @functools.cache
    def gains() -> list[tuple[float, float]]:
        return stored_gains(model, simulation, sensors) or tuned_gains(model, sensors)

    def machine() -> Simulation:
        # One of its own: calibration moves it through its whole range.
        return Simulation(copy.copy(simulation.model))

    return ControllerSetup(
        joints=simulation.joints,
        control_period=sensors.control_period,
        machine={
            "direction": directions(simulation),
            "latency": sensors.latency,
            "velocity_delay": velocity_delay(sensors.control_period, sensors.velocity_cutoff),
            "position_gain": lambda: [gain[0] for gain in gains()],
            "velocity_gain": lambda: [gain[1] for gain in gains()],
            "valve_maps": lambda: _calibrated(machine()),
            "cylinders": lambda: nominal_cylinders(machine()),
            "inverse_dynamics": lambda: NominalDynamics(machine()),
            "backstepping_gains": lambda: backstepping_gains(model, machine(), sensors),
            "position_noise": position_uncertainty(sensors),
            "pressure_noise": sensors.pressure_noise,
        },
    )


_calibrations: dict[bytes, tuple[ValveMap, ...]] = {}


def _calibrated(machine: Simulation) -> tuple[ValveMap, ...]:
    """Valve maps of a machine as it is loaded; the same model is calibrated once a process."""
    content = np.empty(mujoco.mj_sizeModel(machine.model), np.uint8)
    mujoco.mj_saveModel(machine.model, None, content)
    key = hashlib.sha256(content.tobytes()).digest()
    if key not in _calibrations:
        maps = valve_maps(machine)
        for part in (array for m in maps for array in (m.position, m.velocity, m.command)):
            part.flags.writeable = False
        _calibrations[key] = maps
    return _calibrations[key]
