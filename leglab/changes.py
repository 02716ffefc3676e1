"""Carries out a scenario's changes on a machine and its sensors."""

from collections.abc import Iterable
from typing import Protocol

import numpy as np

from leglab.errors import LeglabError
from leglab.scenario import Scenario
from leglab.simulation import Simulation


class Target(Protocol):
    """Something with elements whose parameters can change: a machine, its bodies, its sensors."""

    @property
    def elements(self) -> Iterable[str]:
        """Names of the elements."""

    def has(self, element: str, name: str) -> bool:
        """Says whether a change of this parameter of the element has an effect."""

    def parameter(self, element: str, name: str) -> float:
        """Current value in the parameter's own unit."""

    def set_parameter(self, element: str, name: str, value: float) -> None:
        """Sets the value from now on."""


class Schedule:
    """Writes a scenario's parameter changes into a simulation and what belongs to it.

    Args:
        scenario: Says what changes.
        simulation: The machine, unchanged.
        others: What else can change, unchanged.

    Attributes:
        parameters: Element and parameter of everything in the simulation that changes.
        others: The same of everything else that changes.
        values: Present values of `others`, (len(others),).

    Raises:
        LeglabError: If a change matches no element.
    """

    def __init__(self, scenario: Scenario, simulation: Simulation, *others: Target) -> None:
        self._simulation, self._targets = simulation, (simulation, *others)
        self._nominal: dict[tuple[str, str], float] = {}
        self._target: dict[tuple[str, str], Target] = {}
        self._begin(scenario)

    def follow(self, scenario: Scenario, now: float) -> None:
        """Carries out another scenario from now on; what only the last one changed is undone.

        Args:
            scenario: Takes the place of the present one.
            now: Time [s].

        Raises:
            LeglabError: If a change matches no element.
        """
        self.apply(now)
        last = self._scenario
        self._begin(scenario)
        for (element, parameter), nominal in self._nominal.items():
            # What stays as it was is not written: oil that has warmed up stays warm.
            wanted = scenario.value_at(now, parameter, element, nominal)
            if wanted != last.value_at(now, parameter, element, nominal):
                self._target[element, parameter].set_parameter(element, parameter, wanted)
        self.values = np.array([self._target[key].parameter(*key) for key in self.others])
        self._previous = now

    def _begin(self, scenario: Scenario) -> None:
        self._scenario = scenario
        for change in scenario.changes:
            matched = [
                (element, target)
                for target in self._targets
                for element in target.elements
                if change.applies_to(element) and target.has(element, change.parameter)
            ]
            if not matched:
                raise LeglabError(
                    f"scenario {scenario.name!r} changes {change.parameter!r} of "
                    f"{change.element!r}, which no element of the model has"
                )
            for element, target in matched:
                key = (element, change.parameter)
                if key not in self._target:
                    self._target[key] = target
                    self._nominal[key] = target.parameter(*key)
        machine = self._simulation
        self.parameters = tuple(k for k, t in self._target.items() if t is machine)
        self.others = tuple(k for k, t in self._target.items() if t is not machine)
        self.values = np.array([self._target[key].parameter(*key) for key in self.others])
        self._previous = -np.inf
        self._next = 0.0 if scenario.changes else np.inf

    def apply(self, now: float) -> None:
        """Sets the parameters of this time [s]; cheap while nothing changes."""
        if now < self._next:
            return
        scenario = self._scenario
        for change in scenario.moving(self._previous, now):
            for (element, parameter), nominal in self._nominal.items():
                if parameter == change.parameter and change.applies_to(element):
                    value = scenario.value_at(now, parameter, element, nominal)
                    self._target[element, parameter].set_parameter(element, parameter, value)
        self.values = np.array([self._target[key].parameter(*key) for key in self.others])
        self._previous = now
        ramping = any(c.start <= now < c.end for c in scenario.changes)
        later = [c.start for c in scenario.changes if c.start > now]
        self._next = now if ramping else min(later, default=np.inf)
