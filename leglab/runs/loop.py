"""Closed loop of machine, sensors, controller and a scenario's changes, in control periods."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from leglab._native.loop import Reports
from leglab._native.loop import Rows as RowTaker
from leglab.base.errors import LeglabError, SettingsError, SimulationError, origin
from leglab.base.scenario import Scenario
from leglab.control import (
    Controller,
    Foreknowledge,
    Measurement,
    ReferencePoint,
    check_command,
    make_controller,
)
from leglab.control.contract import diagnostics_of
from leglab.control.feedforward.offline import BenchRun
from leglab.controllers.exact_inverse import ExactInverse
from leglab.controllers.pd import PdConfiguration
from leglab.machine.changes import Schedule
from leglab.machine.plugin import headless
from leglab.machine.simulation import Simulation
from leglab.references import Samples
from leglab.runs.call_times import CallTimes
from leglab.runs.fault_simulation import fault_bank
from leglab.runs.history import Ending, History, Rows, Whole
from leglab.runs.inversion import exact_commands, valve_slopes
from leglab.runs.preparation import Preparation, RunSettings, prepared, scenario_of
from leglab.runs.sampled_machine import SampledMachine

# Number of control periods between two blow-up checks, progress reports and interrupt checks.
_CHECK_INTERVAL = 50

# Upper limit on the control periods of a run.
_MOST_PERIODS = 50_000_000

# Minimum number of samples per evaluation of a reference. Earlier samples are added to a shorter
# piece, because products of matrices with few rows are rounded differently.
_LEAST_SAMPLES = 64

# Recorded plugin states by suffix of their column. The suffix `_position` is reserved for joints.
_RECORDED = {
    "pressure_a": "pressure_a",
    "pressure_b": "pressure_b",
    "oil_temperature": "oil_temperature",
    "spool": "spool_position",
    "energy_supply": "energy_supply",
    "seal_clearance": "seal_clearance",
}

# Length of the pieces in which the reference is sampled after the scenario's duration [s].
_PIECE = 1.0

BENCH_SEED = 1_000_003  # seed of recordings for offline identification; no comparison uses it
# `_BENCH_DURATION`: their duration [s]. `_BENCH_SETTLED`: time before which they are not used [s].
_BENCH_DURATION, _BENCH_SETTLED = 40.0, 10.0

# Sensors without noise and quantisation; their latency is kept.
_EXACT_SENSORS = {"position_noise": 0.0, "encoder_counts": 0}

Progress = Callable[[float], None]


@dataclass(slots=True, eq=False)
class Period:
    """Data of one control period for the controller; a loop overwrites one instance each period."""

    number: int  #: Counted from 0
    measurement: Measurement  #: Sensor readings
    reference: ReferencePoint  #: Reference of the joints
    #: Command of the controller, not checked or clipped; None without a controller.
    command: np.ndarray | None


class Loop:
    """Closed loop of a controller and a machine for headless runs, viewer and environment.

    A period is `observe`, `act` and `advance`; `step` does all three. The same settings give
    bitwise equal results in all three uses. A loop can continue after the scenario's duration; its
    sensor noise repeats then.

    Args:
        settings: Settings of the run.
        preparation: Preparation for the same model, sensors and tolerance; None for a cached one.
        scenario: Scenario to use instead of the one in the settings.
        simulation: Machine from `preparation.machine`; None to make a new one.
        controller: Controller to use instead of the one in the settings.
        controlled: Whether there is a controller; without one, every `act` needs an action.
        pressures: Whether pressures are measured; None to measure them if the controller uses them.
        ahead: Periods by which `reference_ahead` looks beyond the scenario's duration.
        kept: Number of periods whose noise and reference are in memory at a time, if `ahead` is 0;
            None for all of the scenario's duration. Results do not depend on it.

    Attributes:
        settings: Settings of the run.
        scenario: Scenario with the changes of the machine.
        preparation: Preparation of the run.
        simulation: The machine.
        controller: The controller; None without one.
        reference: Trajectory of the driven joints.
        machine: The machine with sensors and commands in control periods.
        period: Control period [s].
        count: Number of periods in the scenario's duration.
        wanted: Samples of the reference for the `kept` periods in memory and `ahead` more periods.
        present: The period that `observe` began last; its number is -1 before the first period.
        call_times: Durations of the controller's `command` calls since `reset`.
        watch: Called with the number of each period, after its command and before `advance`.

    Raises:
        LeglabError: A name, a setting or the machine is not suitable.
    """

    def __init__(
        self,
        settings: RunSettings,
        *,
        preparation: Preparation | None = None,
        scenario: Scenario | None = None,
        simulation: Simulation | None = None,
        controller: Controller | None = None,
        controlled: bool = True,
        pressures: bool | None = None,
        ahead: int = 0,
        kept: int | None = None,
    ) -> None:
        self.settings = settings
        self.preparation = preparation = preparation or prepared(settings)
        wanted = scenario or scenario_of(settings, preparation)
        self.scenario = scenario = preparation.fitted(wanted)
        self.reference = preparation.reference(settings, scenario)
        foreknowledge = Foreknowledge(
            first_change=min(scenario.breakpoints, default=math.inf),
            last_change=max(scenario.breakpoints, default=math.inf),
            bench_runs=self._bench_runs,
            exact_commands=self._exact_commands,
        )
        self._setup = replace(
            preparation.controller_setup,
            reference_period=self.reference.period,
            foreknowledge=foreknowledge,
            fault_bank=partial(fault_bank, settings, scenario, Loop),
        )
        self.controller = controller
        if controlled and controller is None:
            self.controller = make_controller(
                settings.controller, self._setup, settings.controller_config
            )
        self.simulation = simulation or preparation.machine()
        self.period = preparation.sensors.control_period
        if scenario.duration > _MOST_PERIODS * self.period:
            raise SettingsError(
                f"duration {scenario.duration:g} s has more than {_MOST_PERIODS:g} control periods "
                f"of {self.period:g} s; allowed: ",
                given=scenario.duration,
                allowed=f"at most {_MOST_PERIODS * self.period:g} s",
            )
        self.count = round(scenario.duration / self.period) + 1
        self.watch: Callable[[int], None] | None = None
        if pressures is None:
            pressures = bool(getattr(self.controller, "uses_pressures", False))
        self._pressures, self._ahead = pressures, ahead
        self._kept = min(kept or self.count, self.count)
        self.machine: SampledMachine | None = None
        for first in range(self._kept, self.count, self._kept):  # raises errors of later pieces now
            self._sample_reference(first, min(self._kept, self.count - first))
        self.reset()

    def reset(self) -> None:
        """Restarts the run: specimen at rest, noise from its start, controller not yet adapted."""
        self.close()
        self.preparation.start(self.simulation, self.settings.seed, self.settings.tolerance)
        self.machine = machine = SampledMachine(
            self.simulation,
            self.scenario,
            self.preparation.sensors,
            count=self.count,
            kept=self._kept,
            seed=self.settings.seed,
            pressures=self._pressures,
        )
        # A period takes some tens of microseconds, so attribute look-ups are cached.
        self._measure, self._send, self.advance = machine.measure, machine.send, machine.advance
        self._next, self._clock = 0, time.perf_counter_ns
        self.call_times = CallTimes(self.period)
        self._sample_reference(0, self._kept + self._ahead)
        nothing = np.zeros(len(self.simulation.joints))
        first = Measurement(0.0, nothing, nothing)
        self.present = Period(-1, first, self.reference_now(), None)

    def observe(self) -> Period:
        """Begins a period: applies changes, reads the sensors and calls the controller."""
        measurement = self._measure()
        number = self._next
        self._next = number + 1
        try:
            point = next(self._points)
        except StopIteration:
            left = min(self._kept, self.count - number)
            self._sample_reference(number, left if left > 0 else round(_PIECE / self.period))
            point = next(self._points)
        controller, wish = self.controller, None
        if controller is not None:
            try:
                if number == 0:
                    controller.reset(measurement)
                began = self._clock()
                wish = controller.command(measurement, point)
                self.call_times.add(self._clock() - began)
            except LeglabError:
                raise
            except (Exception, SystemExit) as error:
                raise self.failed("", error) from error
        period = self.present
        period.number, period.measurement = number, measurement
        period.reference, period.command = point, wish
        return period

    def failed(self, method: str, error: BaseException) -> SimulationError:
        """Returns the error that ends a run after an exception in the controller's code.

        Args:
            method: Prefix of the message, for instance "diagnostics: "; "" for `command`.
            error: The exception.
        """
        name, now = self.settings.controller, self.simulation.data.time
        return SimulationError(
            f"controller {name!r} failed at {now:.6g} s: {method}{type(error).__name__}: {error} "
            f"({origin(error, type(self.controller))})",
            given=name,
        )

    def act(self, action: np.ndarray | None = None) -> None:
        """Sends the valve commands of the period, clipped to [-1, 1].

        Args:
            action: Commands, (joints,); None for the controller's.

        Raises:
            LeglabError: The commands are not finite numbers or have the wrong shape.
        """
        wish = self.present.command if action is None else action
        if not self._send(wish):  # invalid, or not an array of float64
            wish = self.checked(wish).astype(float)
            self._send(wish)
        sent = getattr(self.controller, "sent", None)
        if action is not None and sent is not None:
            sent(wish)

    def step(self, action: np.ndarray | None = None) -> Period:
        """Runs one control period.

        Args:
            action: Valve commands, (joints,); None for the controller's.

        Raises:
            LeglabError: As `act`.
        """
        period = self.observe()
        if action is not None or not self._send(period.command):
            self.act(action)
        if self.watch is not None:
            self.watch(period.number)
        self.advance()
        return period

    def checked(self, command: Any) -> np.ndarray:
        """Returns the commands of the present period if they are valid; raises as `act`."""
        time = self.present.measurement.time
        return check_command(command, self._setup, self.settings.controller, time)

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Returns the controller's reports for the present period, by name, (joints,) each."""
        return {} if self.controller is None else diagnostics_of(self.controller)

    def reference_now(self) -> ReferencePoint:
        """Returns the reference of the next period, before it is observed."""
        row, wanted = self._next - self._first, self.wanted
        if row == len(wanted.position):  # `observe` samples the next piece.
            row, wanted = 0, self.reference.sample(np.array([self._next * self.period]))
        return ReferencePoint(*(part[row] for part in wanted))

    def reference_ahead(self, periods: np.ndarray) -> np.ndarray:
        """Returns reference positions [rad] at offsets `periods` from now, (periods, joints)."""
        return self.wanted.position[self.present.number - self._first + periods]

    def run(
        self, progress: Progress | None = None, *, interrupted: Callable[[], bool] = lambda: False
    ) -> History:
        """Runs the scenario headless, from the present state to its end.

        Args:
            progress: As in `stream`.
            interrupted: As in `stream`.

        Raises:
            LeglabError: Not a single period could be recorded.
        """
        whole = Whole(self.count)
        return whole.history(self.stream(whole.keep, progress, interrupted=interrupted))

    def stream(
        self,
        keep: Callable[[Rows], object],
        progress: Progress | None = None,
        *,
        freeze: bool = False,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> Ending:
        """Runs the scenario headless and passes its rows to `keep`, `kept` periods at a time.

        It ends early, with the rows recorded so far, if the simulation blows up, the controller
        returns an invalid command, or the user interrupts it.

        Args:
            keep: Called with blocks of rows, in order. Their arrays are overwritten after it
                returns.
            progress: Called periodically with the simulated time [s].
            freeze: Whether the controller stops adapting just before the machine changes.
            interrupted: Called periodically; the run ends if it returns True.

        Raises:
            LeglabError: Not a single period could be recorded.
        """
        records = _Records(self, self._kept)
        change = min(self.scenario.breakpoints, default=math.inf)
        frozen = math.inf
        if freeze and change < self.count * self.period:
            times = np.arange(self.count) * self.period
            frozen = int(np.searchsorted(times, change))
        rows, wall_time, failure = 0, 0.0, ""
        self.watch = records.take
        try:
            with headless(self.simulation.model):
                while rows < self.count and not failure:
                    start = time.perf_counter()
                    last = min(rows + self._kept, self.count)
                    failure = self._run(range(rows, last), records, frozen, progress, interrupted)
                    wall_time += time.perf_counter() - start
                    if records.rows:
                        keep(records.given(rows))
                    rows += records.rows
                    records.clear()
        finally:
            self.watch = None
            self.close()
        if rows == 0:
            raise SimulationError(failure)
        return Ending(rows=rows, wall_time=wall_time, failure=failure)

    def _run(
        self,
        numbers: range,
        records: "_Records",
        frozen: float,
        progress: Progress | None,
        interrupted: Callable[[], bool],
    ) -> str:
        """Runs the periods `numbers`; returns the reason of an early end, or ""."""
        simulation, step = self.simulation, self.step
        try:
            for k in numbers:
                if k == frozen:
                    self.controller.freeze()  # type: ignore[union-attr]
                step()
                if k % _CHECK_INTERVAL == 0:
                    simulation.check()
                    if interrupted():
                        raise KeyboardInterrupt
                    if progress:
                        progress(self.present.measurement.time)
            simulation.check()
        except LeglabError as error:
            return records.cut(numbers.start, error)
        except KeyboardInterrupt:
            return f"interrupted at {simulation.data.time:.6g} s"
        return ""

    def close(self) -> None:
        """Restores the model: removes loads from bodies, undoes changes of joints and drives."""
        if self.machine is not None:
            self.machine.close()

    def _sample_reference(self, first: int, count: int) -> None:
        early = min(first, max(0, _LEAST_SAMPLES - count))
        times = (first - early + np.arange(early + count)) * self.period
        samples = self.reference.sample(times)
        self._first = first
        self.wanted = Samples(*(part[early:] for part in samples))
        self._points = map(ReferencePoint, *self.wanted)

    def _bench_runs(self) -> tuple[BenchRun, BenchRun]:
        """Records this machine before and after its changes, for offline identification."""
        # With a tolerance the run's seed selects the specimen. The noise is then the run's, too.
        seed = self.settings.seed if self.settings.tolerance else BENCH_SEED
        settings = replace(self.settings, controller="bsnn_arx", controller_config={}, seed=seed)
        before = replace(self.scenario, duration=_BENCH_DURATION, changes=())
        after = replace(self.scenario.changed_from_start(), duration=_BENCH_DURATION)
        return (
            _bench_run(settings, before, self.preparation),
            _bench_run(settings, after, self.preparation),
        )

    def _exact_commands(self) -> np.ndarray:
        """Computes valve commands by which this machine tracks its reference with exact sensors."""
        settings = self.settings
        exact = replace(settings, sensors={**settings.sensors, **_EXACT_SENSORS})
        controller = ExactInverse(self._setup, PdConfiguration())
        wanted = self.reference.sample(np.arange(self.count) * self.period)
        maps = self._setup.machine.valve_maps
        start, slope = valve_slopes(maps, wanted.position, wanted.velocity)
        changes = [math.ceil(time / self.period) for time in self.scenario.breakpoints if time > 0]
        trial = Loop(exact, scenario=self.scenario, controller=controller)

        def try_out(commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            controller.commands = commands
            trial.reset()
            history = trial.run()
            if history.failure:
                raise SimulationError(f"no exact commands were found: {history.failure}")
            return -history.error, history.diagnostics["feedback"]

        return exact_commands(try_out, slope, start, self.period, changes)


_bench_cache: dict[str, BenchRun] = {}


def _bench_run(settings: RunSettings, scenario: Scenario, preparation: Preparation) -> BenchRun:
    """Records measurements and commands of a run once the motion is close to the reference.

    The measurements have the sensor latency, which the identification has to consider.
    """
    # The key omits name and severity, so all scenarios share the recording of the healthy machine.
    told = replace(scenario, name="", summary="", severity=None)
    common = replace(settings, scenario="nominal", severity=None, ramp_duration=0.0, element=None)
    key = f"{common!r} {told!r}"
    if key not in _bench_cache:
        loop = Loop(settings, scenario=scenario, preparation=preparation)
        position = np.empty((loop.count, len(loop.simulation.joints)))
        command = np.empty_like(position)
        with headless(loop.simulation.model):
            for k in range(loop.count):
                position[k] = loop.step().measurement.position
                command[k] = loop.simulation.commands(loop.simulation.data.ctrl)
        loop.close()
        loop.simulation.check()
        time = np.arange(loop.count) * loop.period
        kept = time >= _BENCH_SETTLED
        _bench_cache[key] = BenchRun(
            time=time[kept],
            position=position[kept],
            command=command[kept],
            reference=ReferencePoint(*(part[kept] for part in loop.reference.sample(time))),
        )
    return _bench_cache[key]


class _Records:
    """Buffer of at most `most` rows of a run, one per control period, until they are passed on."""

    def __init__(self, loop: Loop, most: int) -> None:
        assert loop.machine is not None
        simulation, schedule = loop.simulation, loop.machine.schedule
        model, data = simulation.model, simulation.data
        self._loop, self._encoders = loop, loop.machine.encoders
        self._simulation, self._schedule = simulation, schedule
        self._diagnostics = getattr(loop.controller, "diagnostics", dict)
        self._columns, slots = _state_columns(simulation, schedule)
        self._qpos, self._qvel = np.empty((most, model.nq)), np.empty((most, model.nv))
        self._command = np.empty((most, model.nu))
        self._states = np.empty((most, len(slots)))
        pairs = zip(simulation.joints, simulation.actuators, strict=True)
        native = [joint for joint, name in pairs if name in simulation.native]
        self._native = tuple((joint, i) for i, joint in enumerate(native))
        driven = simulation.dof_index[[simulation.joints.index(joint) for joint in native]]
        self._effort = np.empty((most, len(native)))
        self._others = np.empty((most, len(schedule.others)))
        self._reports: dict[str, np.ndarray] = {}
        self._copier: Reports | None = None
        self.rows = 0
        takers = (
            RowTaker(data.qpos, np.arange(model.nq), self._qpos),
            RowTaker(data.qvel, np.arange(model.nv), self._qvel),
            RowTaker(data.ctrl, np.arange(model.nu), self._command),
            RowTaker(data.plugin_state, slots, self._states),
            RowTaker(data.qfrc_actuator, np.asarray(driven, dtype=np.int64), self._effort),
        )
        self._takes = tuple(taker.take for taker in takers)

    def take(self, _number: int) -> None:
        """Stores the current state of the machine and the controller's reports as the next row."""
        row = self.rows
        for take in self._takes:
            take(row)
        if self._schedule.others:
            self._others[row] = self._schedule.values
        try:
            reports: dict[str, np.ndarray] = self._diagnostics()
            if self._copier is None or not self._copier.take(reports, row):
                self._keep(reports, row)
        except (Exception, SystemExit) as error:
            raise self._loop.failed("diagnostics: ", error) from error
        self.rows = row + 1

    def _keep(self, reports: dict[str, np.ndarray], row: int) -> None:
        """Stores a controller's reports as a row; row 0 makes a fast copier of the same arrays."""
        kept = self._reports
        for key, value in reports.items():
            if key not in kept:
                kept[key] = np.full(self._command.shape, np.nan)
            if np.shape(value) not in ((), kept[key].shape[1:]):
                text = f"{key!r} has shape {np.shape(value)}, allowed is (joints,)"
                raise ValueError(f"{text} = {kept[key].shape[1:]}")
            kept[key][row] = value
        if row == 0:
            try:
                self._copier = Reports(reports, [kept[key] for key in reports])
            except (TypeError, ValueError):
                self._copier = None

    def clear(self) -> None:
        """Removes all rows."""
        self.rows = 0
        for values in self._reports.values():
            values.fill(np.nan)

    def cut(self, first: int, error: LeglabError) -> str:
        """Returns why a loop failed, and removes the rows from the first diverged state on."""
        # The state may have diverged before `error`, since it is checked every 50 periods only.
        for row, values in enumerate(self._qvel[: self.rows]):
            try:
                self._simulation.check((first + row) * self._loop.period, values)
            except SimulationError as earlier:
                self.rows = row if first else max(row, 1)
                return str(earlier)
        return str(error)

    def given(self, first: int) -> Rows:
        """Returns the stored rows; the first row belongs to the control period number `first`."""
        rows, machine, qpos = self.rows, self._simulation, self._qpos[: self.rows]
        states = zip(self._columns, self._states[:rows].T, strict=True)
        keys = enumerate(self._schedule.others)
        return Rows(
            time=np.arange(first, first + rows) * self._loop.period,
            position=qpos[:, machine.qpos_index],
            velocity=self._qvel[:rows, machine.dof_index],
            passive={name: qpos[:, index] for name, index in machine.passive_joints.items()},
            command=machine.commands(self._command[:rows]),
            control=self._command[:rows],
            reference=ReferencePoint(*(part[:rows] for part in self._loop.wanted)),
            states={
                **{f"{joint}_effort": self._effort[:rows, i] for joint, i in self._native},
                **dict(states),
                **{"_".join(key): self._others[:rows, i] for i, key in keys},
            },
            encoder_shift=self._encoders.shift[:rows],
            encoder_lost=self._encoders.lost[:rows],
            diagnostics={key: values[:rows] for key, values in self._reports.items()},
        )


def _state_columns(simulation: Simulation, schedule: Schedule) -> tuple[list[str], np.ndarray]:
    """Returns the columns of recorded plugin states and their indices in `plugin_state`."""
    columns, slots = [], []
    for joint, actuator in zip(simulation.hydraulic_joints, simulation.cylinders, strict=True):
        for column, quantity in _RECORDED.items():
            columns.append(f"{joint}_{column}")
            slots.append(simulation.slot(actuator, quantity))
    if simulation.cylinders:
        columns.append("supply_pressure")
        slots.append(simulation.supply_slot)
    for element, parameter in schedule.parameters:
        columns.append(f"{element}_{parameter}")
        slots.append(simulation.slot(element, parameter))
    return columns, np.array(slots, dtype=np.int64)
