"""The nominal machine as controllers know it, from data sheets, calibration and tuning."""

import copy
import hashlib
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from leglab.commissioning.calibration import ValveMap, drive_signs, valve_maps
from leglab.commissioning.gains_file import GAINS
from leglab.commissioning.nominal import NominalDynamics, nominal_cylinders
from leglab.commissioning.pd_gains import stored_gains, tuned_gains
from leglab.control import ControllerSetup, NominalMachine
from leglab.machine.sensors import SensorConfiguration, position_uncertainty, velocity_delay
from leglab.machine.simulation import Simulation


class CommissionedMachine(NominalMachine):
    """Properties of the machine that a controller may know; calibrated and tuned at first use.

    Args:
        simulation: The nominal machine in its rest pose.
        model: Name of the model, by which tuned gains are stored.
        sensors: Sensors and timing of the run.
    """

    def __init__(self, simulation: Simulation, model: str, sensors: SensorConfiguration) -> None:
        super().__init__(
            direction=drive_signs(simulation),
            latency=sensors.latency,
            velocity_delay=velocity_delay(sensors.control_period, sensors.velocity_cutoff),
            position_noise=position_uncertainty(sensors),
            pressure_noise=sensors.pressure_noise,
        )
        self._simulation, self._model, self._sensors = simulation, model, sensors

    def find(self, name: str) -> Any:
        """Computes a property of the machine by calibration or tuning; see `NominalMachine`."""
        if name in ("position_gain", "velocity_gain"):
            stored = stored_gains(self._model, self._simulation, self._sensors)
            position, velocity = zip(*(stored or _tuned(self._own(), self._sensors)), strict=True)
            return position if name == "position_gain" else velocity
        if name == "setpoint":
            return _setpoint(self._simulation)
        own = self._own()
        match name:
            case "valve_maps":
                return _calibrated(own)
            case "cylinders":
                return nominal_cylinders(own)
            case "inverse_dynamics":
                return NominalDynamics(own)
            case "tuned":
                return _Tuned(self._tuned)
        return super().find(name)

    def _tuned(self, controller: str) -> Any:
        """Returns the gains of a controller, stored or tuned."""
        return GAINS.get(controller).gains(self._model, self._own(), self._sensors)

    def _own(self) -> Simulation:
        """Returns a copy of the machine, which calibration may move through its whole range."""
        return Simulation(copy.copy(self._simulation.model))


class _Tuned(dict[str, Any]):
    """Gains by name of the controller, looked up or tuned at first use."""

    def __init__(self, make: Callable[[str], Any]) -> None:
        self._make = make

    def __missing__(self, controller: str) -> Any:
        self[controller] = made = self._make(controller)
        return made


def _setpoint(simulation: Simulation) -> np.ndarray | None:
    """Returns `NominalMachine.setpoint` of the servos, (3, joints); None without servos."""
    rows = np.zeros((3, len(simulation.joints)))
    for drive in simulation.native.values():
        rows[:, drive.id] = drive.setpoint(simulation.data)
    return rows if rows.any() else None


def controller_setup(
    simulation: Simulation, model: str, sensors: SensorConfiguration
) -> ControllerSetup:
    """Makes the inputs of a controller; arguments as for `CommissionedMachine`."""
    return ControllerSetup(
        joints=simulation.joints,
        control_period=sensors.control_period,
        machine=CommissionedMachine(simulation, model, sensors),
    )


def model_digest(machine: Simulation) -> bytes:
    """Computes a digest of the complete model of a machine."""
    content = np.empty(mujoco.mj_sizeModel(machine.model), np.uint8)
    mujoco.mj_saveModel(machine.model, None, content)
    return hashlib.sha256(content.tobytes()).digest()


_calibrations: dict[bytes, tuple[ValveMap, ...]] = {}
_gains: dict[tuple[bytes, str], list[tuple[float, float]]] = {}


def _tuned(machine: Simulation, sensors: SensorConfiguration) -> list[tuple[float, float]]:
    """Tunes `pd` for a machine without stored gains; once per process for equal models."""
    key = model_digest(machine), sensors.model_dump_json()
    if key not in _gains:
        _gains[key] = tuned_gains(machine, sensors)
    return _gains[key]


def _calibrated(machine: Simulation) -> tuple[ValveMap, ...]:
    """Calibrates the valve maps of a machine as loaded; once per process for equal models."""
    key = model_digest(machine)
    if key not in _calibrations:
        maps = valve_maps(machine)
        for part in (array for m in maps for array in (m.position, m.velocity, m.command)):
            part.flags.writeable = False
        _calibrations[key] = maps
    return _calibrations[key]
