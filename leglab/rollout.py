"""The closed loop: machine, sensors, controller and a scenario's changes, headless."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from leglab.changes import Schedule
from leglab.control import (
    Controller,
    ControllerSetup,
    ReferencePoint,
    check_command,
)
from leglab.errors import LeglabError
from leglab.measurement import SensorConfiguration
from leglab.references import Reference
from leglab.sampled_machine import SampledMachine
from leglab.scenario import Scenario
from leglab.simulation import Simulation, SimulationError

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
    model, data = simulation.model, simulation.data
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
    schedule, encoders = machine.schedule, machine.encoders
    wanted = reference.sample(times)
    joints = len(setup.joints)
    columns, slots = _state_columns(simulation, schedule)

    all_qpos, all_qvel = np.empty((count, model.nq)), np.empty((count, model.nv))
    command, states = np.empty((count, joints)), np.empty((count, len(slots)))
    others = np.empty((count, len(schedule.others)))
    reports: dict[str, np.ndarray] = {}

    # The loop runs thousands of times a second: everything that can be looked up once is.
    measure, advance = machine.measure, machine.advance
    qpos, qvel, ctrl, plugin_state = data.qpos, data.qvel, data.ctrl, data.plugin_state
    qpos_index = simulation.qpos_index
    failure, rows = "", 0
    # MuJoCo would write its warnings to a log file; what they warn of is checked here.
    mujoco.set_mju_user_warning(_ignore)
    start = time.perf_counter()
    rows_of = zip(times.tolist(), map(ReferencePoint, *wanted), command, strict=True)
    try:
        for k, (now, point, output) in enumerate(rows_of):
            measurement = measure()
            if k == 0:
                controller.reset(measurement)
            wish = check_command(controller.command(measurement, point), setup, name, now)

            all_qpos[k] = qpos
            all_qvel[k] = qvel
            plugin_state.take(slots, out=states[k])
            others[k] = schedule.values
            np.minimum(wish, 1.0, out=output)
            np.maximum(output, -1.0, out=output)
            ctrl[:] = output
            if reports or k == 0:
                _record(reports, controller.diagnostics(), k, (count, joints))
            rows = k + 1
            advance()
            if k % _CHECK_INTERVAL == 0:
                simulation.check()
                if progress:
                    progress(now)
        simulation.check()
    except LeglabError as error:
        failure, rows = _first_failure(simulation, times[:rows], all_qvel[:rows], error)
    except KeyboardInterrupt:
        failure = f"interrupted at {data.time:.6g} s"
    finally:
        mujoco.set_mju_user_warning(None)
        machine.close()
    wall_time = time.perf_counter() - start
    if rows == 0:
        raise LeglabError(failure)
    return History(
        time=times[:rows],
        position=all_qpos[:rows, qpos_index],
        velocity=all_qvel[:rows, simulation.dof_index],
        passive={name: all_qpos[:rows, index] for name, index in simulation.passive_joints.items()},
        command=command[:rows],
        reference=ReferencePoint(*[part[:rows] for part in wanted]),
        states={
            **{column: states[:rows, i] for i, column in enumerate(columns)},
            **{"_".join(key): others[:rows, i] for i, key in enumerate(schedule.others)},
        },
        encoder_shift=encoders.shift[:rows],
        encoder_lost=encoders.lost[:rows],
        diagnostics={key: values[:rows] for key, values in reports.items()},
        wall_time=wall_time,
        failure=failure,
    )


def _ignore(warning: str) -> None:
    pass


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


def _record(
    reports: dict[str, np.ndarray], values: dict[str, np.ndarray], k: int, shape: tuple[int, int]
) -> None:
    for key, value in values.items():
        if key not in reports:
            reports[key] = np.full(shape, np.nan)
        reports[key][k] = value


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
