"""Live run without a window: the closed loop, one control period at a time, changed by hand."""

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from leglab.base.errors import LeglabError, SettingsError
from leglab.base.scenario import ParameterChange, Scenario
from leglab.base.units import error_unit
from leglab.machine.plugin import without_warnings
from leglab.runs.loop import Loop
from leglab.runs.preparation import RunSettings
from leglab.viewer.sliders import sliders

# Duration of the scenario of a live run [s], so long that a run never ends.
_NEVER = 1e9
# Duration of the history that figures show [s].
HISTORY = 10.0


class Moment(NamedTuple):
    """Values of one control period that the figures show; arrays have shape (joints,)."""

    time: float  # s
    error: np.ndarray  # true tracking error [rad or m]
    command: np.ndarray  # in [-1, 1]
    feedforward: np.ndarray  # part of the command; NaN if the controller has no feed-forward


class Session:
    """A live run of a controller on a machine, stepped by the caller.

    Until the user changes something, the run equals that of `leglab.runs.run.run_scenario`, bit
    for bit. It continues beyond the scenario's duration, with repeated sensor noise.

    Args:
        settings: Settings of the run.

    Attributes:
        simulation: The machine.
        scenario: The requested scenario.
        joints: Names of the driven joints.
        unit: Unit of the joints' errors, "mrad", "mm" or "mrad or mm".
        period: Control period [s].
        sliders: Sliders that the user can move, by name.
        values: Present values of the sliders, by name.
        fault: Whether a change of the scenario is in force.
        moments: Control periods of the last `HISTORY` seconds.
        point: Present reference of the joints.
        failure: Why the run cannot go on; empty if it can.

    Raises:
        LeglabError: If a name, a setting or the machine does not fit.
    """

    def __init__(self, settings: RunSettings) -> None:
        self._loop = loop = Loop(settings)
        loop.watch = self._show
        self.simulation, self.scenario, self.period = loop.simulation, loop.scenario, loop.period
        self.joints = self.simulation.joints
        self.unit = error_unit(self.simulation.slides[joint] for joint in self.joints)
        self.sliders = {slider.name: slider for slider in sliders(self.simulation)}
        self.moments: deque[Moment] = deque(maxlen=round(HISTORY / self.period))
        self._begin()

    @property
    def time(self) -> float:
        """Time of the next period [s]."""
        return self._count * self.period

    @property
    def window(self) -> float:
        """Period of the reference [s]."""
        return self._loop.reference.period

    def restart(self) -> None:
        """Restarts the run, with the sliders at their initial values."""
        self._loop.reset()
        self._begin()

    def _begin(self) -> None:
        self._count, self.failure = 0, ""
        self.moments.clear()
        self._faults = self.scenario.changes
        self._moved: dict[str, ParameterChange] = {}
        self.values = {name: slider.change.value for name, slider in self.sliders.items()}
        self.point = self._loop.reference_now()

    def step(self) -> None:
        """Runs one control period, unless the run has failed."""
        if self.failure:
            return
        try:
            with without_warnings():
                self._loop.step()
            self._count += 1
            self.simulation.check()
        except LeglabError as error:
            self.failure = str(error)

    def move(self, name: str, value: float) -> None:
        """Moves a slider to the value in its range that is nearest to `value`.

        Raises:
            LeglabError: If no slider has this name.
        """
        if name not in self.sliders:
            raise SettingsError.unknown("slider", name, self.sliders)
        slider = self.sliders[name]
        value = min(max(value, slider.lowest), slider.highest)
        if value == self.values[name]:
            return
        self.values[name] = value
        self._moved[name] = replace(slider.change, value=value, start=self.time)
        self._follow()

    @property
    def fault(self) -> bool:
        """True if a change of the scenario has begun."""
        return any(change.start <= self.time for change in self._faults)

    def switch_fault(self) -> None:
        """Undoes the scenario's changes if one has begun, else starts them at the present time."""
        if self.fault:
            self._faults = ()
        elif self.scenario.changes:
            changes = self.scenario.changes
            first = min(change.start for change in changes)
            self._faults = tuple(replace(c, start=self.time + (c.start - first)) for c in changes)
        self._follow()

    def named(self) -> dict[str, str]:
        """Returns the controller's latest fault ("named") and slow wear ("wear"), if any."""
        controller = self._loop.controller
        events = [event for event in getattr(controller, "events", []) if not event.withdrawn]
        trends = getattr(controller, "trends", [])
        rows = {"named": events[-1].short()} if events else {}
        return rows | ({"wear": trends[-1].short()} if trends else {})

    def close(self) -> None:
        """Restores the model: removes added loads and undoes other changes of the machine."""
        self._loop.close()

    def _show(self, number: int) -> None:
        """Stores the present period for the figures."""
        self.point = self._loop.present.reference
        error = self.simulation.position() - self.point.position
        feedforward = self._loop.diagnostics().get("feedforward", np.full_like(error, np.nan))
        command = self.simulation.commands(self.simulation.data.ctrl)
        self.moments.append(Moment(self.time, error, command, feedforward.copy()))

    def _follow(self) -> None:
        assert self._loop.machine is not None
        changes = sorted((*self._faults, *self._moved.values()), key=lambda change: change.start)
        live = Scenario(name=self.scenario.name, duration=_NEVER, changes=tuple(changes))
        self._loop.machine.schedule.follow(live, self.time)
