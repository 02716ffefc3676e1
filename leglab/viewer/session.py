"""A live run without a window: the closed loop in single periods, changed by hand."""

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from leglab.base.errors import LeglabError, unknown_name
from leglab.base.scenario import ParameterChange, Scenario
from leglab.control import ReferencePoint, check_command, make_controller
from leglab.machine.changes import Bodies
from leglab.machine.plugin import without_warnings
from leglab.machine.simulation import SimulationError
from leglab.runs.loop import SampledMachine
from leglab.runs.run import Preparation, RunSettings, run_setup, scenario_of
from leglab.viewer.sliders import sliders

# A live run has no end; a scenario needs one [s].
_NEVER = 1e9
# Reference is sampled ahead in pieces [s].
_PIECE = 1.0
# Shown history [s].
HISTORY = 10.0


class Moment(NamedTuple):
    """One control period, as the figures show it.

    Attributes:
        time: [s].
        error: True tracking error [rad]. Shape (joints,).
        command: Valve commands in [-1, 1]. Shape (joints,).
        feedforward: Feed-forward part of them, NaN where the controller has none. Shape (joints,).
    """

    time: float
    error: np.ndarray
    command: np.ndarray
    feedforward: np.ndarray


class Session:
    """A controller on a machine, stepped by whoever shows it.

    Until something is changed by hand it is the run of `leglab.runs.run.run_scenario`, bit for bit.
    It goes on after the scenario's duration; the sensor noise repeats then.

    Args:
        settings: Of the run.

    Attributes:
        simulation: The machine.
        scenario: The scenario asked for.
        joints: Names of the driven joints.
        period: Control period [s].
        sliders: What can be changed by hand, by name.
        values: Present values of the sliders, by name.
        fault: Whether a change of the scenario is in force.
        moments: The last `HISTORY` seconds.
        point: Where the joints should be now.
        failure: Why the run cannot go on; empty if it can.

    Raises:
        LeglabError: If a name, a setting or the machine does not fit.
    """

    def __init__(self, settings: RunSettings) -> None:
        self._settings = settings
        self.scenario = scenario_of(settings)
        self._preparation = preparation = Preparation(settings)
        setup = run_setup(preparation, settings, self.scenario)
        self._setup = setup
        self._controller = make_controller(settings.controller, setup, settings.controller_config)
        self._reference = preparation.reference(settings, self.scenario)
        self.simulation = preparation.machine()
        self.joints = self.simulation.joints
        self.sliders = {s.name: s for s in sliders(self.simulation, Bodies(self.simulation.model))}
        self.values = {name: slider.initial for name, slider in self.sliders.items()}
        self.period = preparation.sensors.control_period
        self.moments: deque[Moment] = deque(maxlen=round(HISTORY / self.period))
        self._machine: SampledMachine | None = None
        self.restart()

    @property
    def time(self) -> float:
        """Time of the next period [s]."""
        return self._count * self.period

    @property
    def window(self) -> float:
        """Period of the reference [s]."""
        return self._reference.period

    def restart(self) -> None:
        """Starts the run anew, sliders as they are at the beginning."""
        if self._machine is not None:
            self._machine.close()
        self._preparation.start(self.simulation, self._settings.seed)
        self._machine = SampledMachine(
            self.simulation,
            self.scenario,
            self._preparation.sensors,
            count=round(self.scenario.duration / self.period) + 1,
            seed=self._settings.seed,
            pressures=bool(getattr(self._controller, "uses_pressures", False)),
        )
        self._count, self.failure = 0, ""
        self.moments.clear()
        self._fault = self.scenario.changes
        self._moved: dict[str, ParameterChange] = {}
        self.values = {name: slider.initial for name, slider in self.sliders.items()}
        self._sample_reference()

    def step(self) -> None:
        """Runs one control period, unless the run has failed."""
        if self.failure:
            return
        assert self._machine is not None
        try:
            self._step(self._machine)
            self.simulation.check()
        except (LeglabError, SimulationError) as error:
            self.failure = str(error)

    def move(self, name: str, value: float) -> None:
        """Moves a slider.

        Raises:
            LeglabError: If there is none of this name.
        """
        if name not in self.sliders:
            raise unknown_name("slider", name, self.sliders)
        slider = self.sliders[name]
        value = slider.clip(value)
        if value == self.values[name]:
            return
        self.values[name] = value
        self._moved[name] = slider.change(value, self.time)
        self._follow()

    @property
    def fault(self) -> bool:
        """Whether a change of the scenario has begun."""
        return any(change.start <= self.time for change in self._fault)

    def switch_fault(self) -> None:
        """Undoes the scenario's changes, or has them begin now."""
        if self.fault:
            self._fault = ()
        elif self.scenario.changes:
            changes = self.scenario.changes
            first = min(change.start for change in changes)
            self._fault = tuple(replace(c, start=self.time + (c.start - first)) for c in changes)
        self._follow()

    def close(self) -> None:
        """Takes the loads off the model's bodies."""
        if self._machine is not None:
            self._machine.close()

    def _step(self, machine: SampledMachine) -> None:
        row = self._count - self._first
        if row == len(self._wanted.position):
            self._sample_reference()
            row = 0
        point = ReferencePoint(*(part[row] for part in self._wanted))
        measurement = machine.measure()._replace(time=self.time)
        if self._count == 0:
            self._controller.reset(measurement)
        wish = self._controller.command(measurement, point)
        name = self._settings.controller
        command = check_command(wish, self._setup, name, self.time).clip(-1.0, 1.0)
        error = self.simulation.position() - point.position
        feedforward = self._controller.diagnostics().get("feedforward", np.full_like(error, np.nan))
        self.moments.append(Moment(self.time, error, command, feedforward.copy()))
        self.simulation.data.ctrl[:] = command
        self.point = point
        with without_warnings():
            machine.advance()
        self._count += 1

    def _sample_reference(self) -> None:
        self._first = self._count
        times = (self._first + np.arange(round(_PIECE / self.period))) * self.period
        self._wanted = self._reference.sample(times)
        self.point = ReferencePoint(*(part[0] for part in self._wanted))

    def _follow(self) -> None:
        assert self._machine is not None
        changes = sorted((*self._fault, *self._moved.values()), key=lambda change: change.start)
        live = Scenario(name=self.scenario.name, duration=_NEVER, changes=tuple(changes))
        self._machine.schedule.follow(live, self.time)
