"""Recording of a closed loop: true values, and readings with noise independent of the loop's."""

import copy
from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np

from leglab.base.recording import DRIVES, SIMULATION
from leglab.base.units import CONTROL_UNIT, units_of_columns
from leglab.machine.changes import parameter_units
from leglab.machine.sensors import (
    CHAMBERS,
    PressureFaults,
    VelocityFilter,
    held,
    quantise,
    skip_normal,
)
from leglab.runs.history import Rows
from leglab.runs.loop import Loop


class Recorder:
    """Converter of one run's rows into columns of a recording, block after block.

    Results do not depend on the block size: in the random sequence the noise of each sensor starts
    where the noise of the previous sensor, for a complete run, ends.

    Args:
        loop: The loop that makes the rows.
    """

    def __init__(self, loop: Loop) -> None:
        self._loop, self._sensors = loop, loop.preparation.sensors
        hydraulic = loop.simulation.hydraulic_joints
        faults = PressureFaults.of(loop.simulation.model, hydraulic)
        places = [f"{joint}_{chamber}" for chamber in CHAMBERS for joint in hydraulic]
        values = zip(faults.scale.tolist(), faults.offset.tolist(), strict=True)
        self._pressures = dict(zip(places, values, strict=True))
        self._noise: dict[str, np.random.Generator] = {}
        self._filters: dict[str, VelocityFilter] = {}
        self._last: list[float | None] = [None] * len(loop.simulation.joints)

    def columns(self, rows: Rows) -> dict[str, np.ndarray]:
        """Returns the columns of the next rows, by name, each (n,); some are views of `rows`."""
        simulation, sensors = self._loop.simulation, self._sensors
        if not self._noise:
            self._begin(rows)
        columns = {}
        measured = self._positions(rows)
        velocities = self._filter("").of(measured)
        for i, (joint, actuator) in enumerate(
            zip(simulation.joints, simulation.actuators, strict=True)
        ):
            columns[f"{joint}_position"] = measured[:, i]
            columns[f"{joint}_velocity"] = velocities[:, i]
            columns[f"{joint}_truth"] = rows.position[:, i]
            columns[f"{joint}_truth_velocity"] = rows.velocity[:, i]
            columns[f"{actuator}_command"] = rows.control[:, i]
            for name, values in rows.reference._asdict().items():
                ending = "" if name == "position" else f"_{name}"
                columns[f"{joint}_reference{ending}"] = values[:, i]
            for name, values in rows.diagnostics.items():
                columns[f"{joint}_{name}"] = values[:, i]
        for name, values in rows.passive.items():
            columns[f"{name}_truth"] = values
        for name, values in rows.states.items():
            columns[name] = values
            if name in self._pressures:
                scale, offset = self._pressures[name]
                noisy = values + self._noise[name].normal(0, sensors.pressure_noise, len(values))
                columns[name] = scale * noisy + offset
                columns[name].setflags(write=False)  # so that the recording need not copy it
        # Encoders of passive joints have no quantisation, and the same noise in rad or m.
        for name, values in rows.passive.items():
            read = values + self._noise[name].normal(0, sensors.position_noise, len(values))
            columns[f"{name}_position"] = read
            columns[f"{name}_velocity"] = self._filter(name).of(read[:, None])[:, 0]
        return columns

    def metadata(self, columns: Iterable[str]) -> dict[str, Any]:
        """Returns the metadata of the recording.

        Args:
            columns: Names of the recording's columns.
        """
        simulation, settings = self._loop.simulation, self._loop.settings
        units = units_of_columns(columns, simulation.slides)
        changeable = parameter_units()
        if self._loop.machine:
            schedule = self._loop.machine.schedule
            for element, parameter in (*schedule.parameters, *schedule.others):
                units[f"{element}_{parameter}"] = changeable[parameter]
        drives = {
            simulation.model.joint(drive.joint).name: {
                "actuator": name,
                "centre": drive.centre,
                "half": drive.half,
            }
            for name, drive in simulation.native.items()
        }
        for drive in drives.values():
            units[f"{drive['actuator']}_command"] = CONTROL_UNIT
        options = simulation.model.opt
        integrator = mujoco.mjtIntegrator(options.integrator).name
        return {
            **{name: str(getattr(settings, name)) for name in ("scenario", "controller", "model")},
            "seed": settings.seed,
            SIMULATION: {
                "timestep": options.timestep,
                "integrator": integrator.removeprefix("mjINT_").lower(),
            },
            **({DRIVES: drives} if drives else {}),
            "units": units,
        }

    def _begin(self, rows: Rows) -> None:
        """Creates a noise generator for each sensor, independent of the loop's sensor noise."""
        noise = np.random.default_rng([self._loop.settings.seed, 1])
        pressures = [name for name in rows.states if name in self._pressures]
        for name in (*self._loop.simulation.joints, *pressures, *rows.passive):
            self._noise[name] = copy.deepcopy(noise)
            skip_normal(noise, self._loop.count)

    def _positions(self, rows: Rows) -> np.ndarray:
        """Returns encoder readings without latency [rad], (n, joints)."""
        columns = []
        for i, joint in enumerate(self._loop.simulation.joints):
            true = rows.position[:, i]
            noisy = true + self._noise[joint].normal(0, self._sensors.position_noise, len(true))
            noisy += rows.encoder_shift[:, i]
            reading = quantise(noisy, self._sensors.encoder_counts)
            reading = held(reading, rows.encoder_lost[:, i], self._last[i])
            self._last[i] = float(reading[-1])
            columns.append(reading)
        return np.column_stack(columns)

    def _filter(self, name: str) -> VelocityFilter:
        return self._filters.setdefault(name, VelocityFilter(self._sensors))
