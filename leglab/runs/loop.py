"""The closed loop: machine, sensors, controller and a scenario's changes, headless."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from leglab._native.loop import Rows, Valves
from leglab.base.errors import LeglabError
from leglab.base.scenario import Scenario
from leglab.control import (
    Controller,
    ControllerSetup,
    Measurement,
    ReferencePoint,
    check_command,
)
from leglab.machine.changes import Bodies, Schedule
from leglab.machine.plugin import headless
from leglab.machine.sensors import EncoderFaults, Encoders, SensorConfiguration, loop_timing
from leglab.machine.simulation import Simulation, SimulationError
from leglab.references import Reference


class SampledMachine:
    """Takes a simulation through a scenario in steps of one control period.

    One period is `measure`, `send` and `advance`. Whoever steps the machine, a headless run, an
    environment or a viewer, gets the same bits from the same seed.

    Args:
        simulation: The machine, at the start of the run.
        scenario: Changes.
        sensors: Resolution, noise and timing.
        count: Periods for which noise is drawn; it repeats after them.
        seed: Of the sensor noise.
        pressures: Whether pressures are measured.

    Attributes:
        simulation: The machine.
        period: Control period [s].
        bodies: Loads on its bodies; `close` takes them off.
        encoders: Its encoders and their faults.
        schedule: Carries out the scenario's changes.
        send: Function that sends commands (joints,) to the valves, clipped to [-1, 1]; False, and
            nothing sent, for what is no array of finite numbers.
        row: Number of the present period within the drawn noise.

    Raises:
        LeglabError: If the timing or a change does not fit the machine.
    """

    def __init__(
        self,
        simulation: Simulation,
        scenario: Scenario,
        sensors: SensorConfiguration,
        *,
        count: int,
        seed: int,
        pressures: bool,
    ) -> None:
        joints = len(simulation.joints)
        self._to_sample, self._to_command = loop_timing(sensors, simulation.model.opt.timestep)
        self.simulation = simulation
        self.period = sensors.control_period
        self.bodies = Bodies(simulation.model)
        self._noise = np.random.default_rng(seed)
        self.encoders = Encoders(
            simulation.joints,
            sensors,
            positions=simulation.data.qpos,
            index=simulation.qpos_index,
            noise=self._noise.normal(0.0, sensors.position_noise, (count, joints)),
            seed=seed,
            built_in=EncoderFaults.of(simulation.model, simulation.joints),
        )
        self.schedule = Schedule(scenario, simulation, self.bodies, self.encoders)
        self._pressure_noise = sensors.pressure_noise
        self._pressures = pressures
        # A control loop runs thousands of times a second: what can be looked up once is.
        self._step, self._state = simulation.step, simulation.data.plugin_state
        self._apply, self._read = self.schedule.apply, self.encoders.read
        self._sample = self.encoders.sample
        self._readings = self.encoders.position, self.encoders.velocity
        self.send = Valves(simulation.data.ctrl).send
        self._pressure_slots = np.concatenate(
            [simulation.slots("pressure_a"), simulation.slots("pressure_b")]
        )
        self._supply_slot = simulation.supply_slot
        self._joints, self._count = joints, count
        self._sampled_pressures = self._state.take(self._pressure_slots)
        self._periods = 0
        self.row = -1

    def measure(self) -> Measurement:
        """Begins a period: what changes now does so, and the sensors are read."""
        now = self._periods * self.period
        row = self.row + 1
        if row == self._count:
            row = 0
        self._periods += 1
        self.row = row
        self._apply(now)
        self._read(row)
        if not self._pressures:
            return Measurement(now, *self._readings)
        joints = self._joints
        noisy = self._sampled_pressures + self._noise.normal(0.0, self._pressure_noise, 2 * joints)
        supply = float(self._state[self._supply_slot])
        return Measurement(now, *self._readings, noisy[:joints], noisy[joints:], supply)

    def advance(self) -> None:
        """Ends a period: the command is held, and the next sample taken ahead of its end."""
        if self._to_sample:
            self._step(self._to_sample)
        self._sample()
        if self._pressures:
            self._sampled_pressures = self._state.take(self._pressure_slots)
        if self._to_command:
            self._step(self._to_command)

    def close(self) -> None:
        """Takes the loads off the model's bodies."""
        self.bodies.restore()


# Periods between two looks at the clock, the blow-up check and the progress report.
_CHECK_INTERVAL = 50

# Columns of a recording by plugin state; `_position` is kept for joints.
_RECORDED = {
    "pressure_a": "pressure_a",
    "pressure_b": "pressure_b",
    "oil_temperature": "oil_temperature",
    "spool": "spool_position",
    "energy_supply": "energy_supply",
    "seal_clearance": "seal_clearance",
}

Progress = Callable[[float], None]


@dataclass(frozen=True, kw_only=True)
class History:
    """Everything that a closed loop left behind, one row a control period.

    Attributes:
        time: [s], shape (n,).
        position: True positions of the driven joints [rad], (n, joints).
        velocity: True velocities of the driven joints [rad/s], (n, joints).
        passive: True positions of joints that no cylinder drives, by joint [rad or m], each (n,).
        command: Valve commands in [-1, 1] from `time` on, (n, joints).
        reference: Position [rad], velocity [rad/s] and acceleration [rad/s^2], each (n, joints).
        states: Values of the plugin states asked for, by column name, each (n,).
        encoder_shift: Added to every position by encoder faults [rad], (n, joints).
        encoder_lost: Where an encoder repeated its last reading, (n, joints).
        diagnostics: What the controller reports, by name, each (n, joints).
        wall_time: Of the loop alone [s].
        failure: Why the loop ended early; empty if it did not.
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    passive: dict[str, np.ndarray]
    command: np.ndarray
    reference: ReferencePoint
    states: dict[str, np.ndarray]
    encoder_shift: np.ndarray
    encoder_lost: np.ndarray
    diagnostics: dict[str, np.ndarray]
    wall_time: float
    failure: str = ""

    @property
    def error(self) -> np.ndarray:
        """True tracking error, position less reference [rad], (n, joints)."""
        return self.position - self.reference.position


def closed_loop(
    simulation: Simulation,
    controller: Controller,
    setup: ControllerSetup,
    reference: Reference,
    scenario: Scenario,
    sensors: SensorConfiguration,
    *,
    seed: int,
    name: str,
    progress: Progress | None = None,
) -> History:
    """Runs a controller on a machine from its present state through a scenario.

    The loop ends early, and keeps what was recorded, if the simulation blows up, the controller
    gives something that is no command, or the user interrupts it.

    Args:
        simulation: The machine, at the start of the run.
        controller: Sees measurements and references only.
        setup: What the controller was made with.
        reference: Trajectory of the driven joints.
        scenario: Duration and changes.
        sensors: Resolution, noise and timing.
        seed: Of the sensor noise.
        name: Of the controller, for messages.
        progress: Called now and then with the simulated time [s].

    Raises:
        LeglabError: If the timing or the reference does not fit the machine.
    """
    period = sensors.control_period
    count = round(scenario.duration / period) + 1
    times = np.arange(count) * period
    machine = SampledMachine(
        simulation,
        scenario,
        sensors,
        count=count,
        seed=seed,
        pressures=bool(getattr(controller, "uses_pressures", False)),
    )
    wanted = reference.sample(times)
    records = _Records(simulation, machine.schedule, count)
    # The loop runs thousands of times a second: everything that can be looked up once is.
    measure, send, advance, record = machine.measure, machine.send, machine.advance, records.take
    command, diagnostics = controller.command, controller.diagnostics
    failure, rows = "", 0
    start = time.perf_counter()
    try:
        with headless(simulation.model):
            for k, point in enumerate(map(ReferencePoint, *wanted)):
                measurement = measure()
                if k == 0:
                    controller.reset(measurement)
                wish = command(measurement, point)
                if not send(wish):  # wrong, or of another type of number
                    send(check_command(wish, setup, name, measurement.time).astype(float))
                record(k, diagnostics())
                rows = k + 1
                advance()
                if k % _CHECK_INTERVAL == 0:
                    simulation.check()
                    if progress:
                        progress(measurement.time)
        simulation.check()
    except LeglabError as error:
        failure, rows = _first_failure(simulation, times[:rows], records.qvel[:rows], error)
    except KeyboardInterrupt:
        failure = f"interrupted at {simulation.data.time:.6g} s"
    finally:
        machine.close()
    wall_time = time.perf_counter() - start
    if rows == 0:
        raise LeglabError(failure)
    return History(
        time=times[:rows],
        **records.first(rows),
        reference=ReferencePoint(*[part[:rows] for part in wanted]),
        encoder_shift=machine.encoders.shift[:rows],
        encoder_lost=machine.encoders.lost[:rows],
        wall_time=wall_time,
        failure=failure,
    )


class _Records:
    """Rows of everything that a run keeps, one a control period."""

    def __init__(self, simulation: Simulation, schedule: Schedule, count: int) -> None:
        model, data = simulation.model, simulation.data
        self._simulation, self._schedule = simulation, schedule
        self._columns, slots = _state_columns(simulation, schedule)
        self._qpos, self.qvel = np.empty((count, model.nq)), np.empty((count, model.nv))
        self._command, self._states = np.empty((count, model.nu)), np.empty((count, len(slots)))
        self._others = np.empty((count, len(schedule.others)))
        self._reports: dict[str, np.ndarray] = {}
        rows = (
            Rows(data.qpos, np.arange(model.nq), self._qpos),
            Rows(data.qvel, np.arange(model.nv), self.qvel),
            Rows(data.ctrl, np.arange(model.nu), self._command),
            Rows(data.plugin_state, slots, self._states),
        )
        self._takes = tuple(row.take for row in rows)

    def take(self, k: int, reported: dict[str, np.ndarray]) -> None:
        """Keeps the machine as it is now and what its controller reports, as row `k`."""
        for take in self._takes:
            take(k)
        if self._schedule.others:
            self._others[k] = self._schedule.values
        reports = self._reports
        for key, value in reported.items():
            if key not in reports:
                reports[key] = np.full(self._command.shape, np.nan)
            reports[key][k] = value

    def first(self, rows: int) -> dict[str, Any]:
        """The first rows, by attribute of `History`."""
        machine, qpos = self._simulation, self._qpos[:rows]
        keys = enumerate(self._schedule.others)
        return {
            "position": qpos[:, machine.qpos_index],
            "velocity": self.qvel[:rows, machine.dof_index],
            "passive": {name: qpos[:, index] for name, index in machine.passive_joints.items()},
            "command": self._command[:rows],
            "states": {
                **{column: self._states[:rows, i] for i, column in enumerate(self._columns)},
                **{"_".join(key): self._others[:rows, i] for i, key in keys},
            },
            "diagnostics": {key: values[:rows] for key, values in self._reports.items()},
        }


def _first_failure(
    simulation: Simulation, times: np.ndarray, velocity: np.ndarray, error: LeglabError
) -> tuple[str, int]:
    """Why a loop failed, and how many rows are sound: blow-ups are looked for now and then only."""
    for row, values in enumerate(velocity):
        try:
            simulation.check(float(times[row]), values)
        except SimulationError as first:
            return str(first), max(row, 1)
    return str(error), len(times)


def _state_columns(simulation: Simulation, schedule: Schedule) -> tuple[list[str], np.ndarray]:
    """Columns of the plugin states that every run records, and their places."""
    columns, slots = [], []
    for joint, actuator in zip(simulation.joints, simulation.actuators, strict=True):
        for column, quantity in _RECORDED.items():
            columns.append(f"{joint}_{column}")
            slots.append(simulation.slot(actuator, quantity))
    columns.append("supply_pressure")
    slots.append(simulation.supply_slot)
    for element, parameter in schedule.parameters:
        columns.append(f"{element}_{parameter}")
        slots.append(simulation.slot(element, parameter))
    return columns, np.array(slots)
