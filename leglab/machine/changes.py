"""Changes of a machine: scenarios over time, loads on bodies, and tolerances of specimens."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from glob import escape
from types import MappingProxyType
from typing import Protocol

import mujoco
import numpy as np

from leglab.base.errors import SettingsError
from leglab.base.scenario import (
    ParameterChange,
    Scenario,
    get_scenario,
    joint_pattern,
    scenario_names,
)
from leglab.machine.parameters import Parameter, plugin_tables
from leglab.machine.sensors import FAULTS
from leglab.machine.simulation import Simulation


class Target(Protocol):
    """Elements with parameters that a scenario can change: a machine, its bodies or sensors."""

    @property
    def elements(self) -> Iterable[str]:
        """Names of the elements."""

    def has(self, element: str, name: str) -> bool:
        """Tests whether a change of this parameter of the element has an effect."""

    def parameter(self, element: str, name: str) -> float:
        """Returns the current value in the parameter's unit."""

    def set_parameter(self, element: str, name: str, value: float) -> None:
        """Sets the value from now on."""


class Schedule:
    """Schedule that applies a scenario's parameter changes to a simulation and other targets.

    Args:
        scenario: The changes.
        simulation: The machine, with nominal parameters.
        others: Other targets of changes, with nominal parameters.

    Attributes:
        parameters: Elements and names of the parameters of the simulation that change.
        others: Elements and names of the parameters of the other targets that change.
        values: Present values of `others`, (len(others),).

    Raises:
        LeglabError: If a change matches no element.
    """

    def __init__(self, scenario: Scenario, simulation: Simulation, *others: Target) -> None:
        self._simulation, self._targets = simulation, (simulation, *others)
        self._nominal: dict[tuple[str, str], float] = {}
        self._target: dict[tuple[str, str], Target] = {}
        self._begin(scenario)

    @property
    def next(self) -> float:
        """Next time at which `apply` changes a parameter [s]; infinite if never."""
        return self._next

    def follow(self, scenario: Scenario, now: float) -> None:
        """Switches to another scenario; changes that only the previous one made are undone.

        Args:
            scenario: Scenario that replaces the present one.
            now: Time [s].

        Raises:
            LeglabError: If a change matches no element.
        """
        self.apply(now)
        last = self._scenario
        self._begin(scenario)
        for (element, parameter), nominal in self._nominal.items():
            # Unchanged values are not written: they would reset oil that has warmed up meanwhile.
            wanted = scenario.value_at(now, parameter, element, nominal)
            if wanted != last.value_at(now, parameter, element, nominal):
                self._target[element, parameter].set_parameter(element, parameter, wanted)
        self._done(now)

    def _begin(self, scenario: Scenario) -> None:
        self._scenario = scenario
        for change in scenario.changes:
            having = [
                (element, target)
                for target in self._targets
                for element in target.elements
                if target.has(element, change.parameter)
            ]
            matched = [pair for pair in having if change.applies_to(pair[0])]
            if not matched:
                able = [element for element, _ in having]
                raise SettingsError(
                    f"scenario {scenario.name!r} changes {change.parameter!r} of "
                    f"{change.element!r}, which no element of the model has"
                    + (f"; it is a parameter of {', '.join(able)}" if able else ""),
                    given=change.element,
                    allowed=able,
                )
            for element, target in matched:
                key = (element, change.parameter)
                if key not in self._target:
                    self._target[key] = target
                    self._nominal[key] = target.parameter(*key)
        machine = self._simulation
        self.parameters = tuple(k for k, t in self._target.items() if t is machine)
        self.others = tuple(k for k, t in self._target.items() if t is not machine)
        self._done(-np.inf)
        self._next = 0.0 if scenario.changes else np.inf

    def _done(self, now: float) -> None:
        """Records that the parameters have been set for this time [s]."""
        self.values = np.array([self._target[key].parameter(*key) for key in self.others])
        self._previous = now

    def apply(self, now: float) -> None:
        """Sets the parameters for this time [s]; cheap while nothing changes."""
        if now < self._next:
            return
        scenario = self._scenario
        for change in scenario.moving(self._previous, now):
            for (element, parameter), nominal in self._nominal.items():
                if parameter == change.parameter and change.applies_to(element):
                    value = scenario.value_at(now, parameter, element, nominal)
                    self._target[element, parameter].set_parameter(element, parameter, value)
        self._done(now)
        ramping = any(c.start <= now < c.end for c in scenario.changes)
        later = [c.start for c in scenario.changes if c.start > now]
        self._next = now if ramping else min(later, default=np.inf)


def fitted(scenario: Scenario, simulation: Simulation) -> Scenario:
    """Adapts a scenario to a machine.

    A change with `fallback` whose element the machine lacks goes to the last element with that
    parameter; a change with `optional` that matches no element is dropped. Other changes that match
    no element stay, for `Schedule` to reject.

    Raises:
        LeglabError: The machine has none of the parameters that the scenario changes; lists the
            scenarios that it can carry out.
    """
    changes, missing = _fit(scenario, simulation)
    if missing is None:
        return replace(scenario, changes=changes)
    possible = [
        name for name in scenario_names() if _fit(get_scenario(name), simulation)[1] is None
    ]
    raise SettingsError(
        f"scenario {scenario.name!r} changes {missing.parameter!r} of {missing.element!r}, which "
        "no element of the model has; scenarios for this machine: ",
        given=scenario.name,
        allowed=possible,
    )


def _fit(
    scenario: Scenario, simulation: Simulation
) -> tuple[tuple[ParameterChange, ...], ParameterChange | None]:
    """Returns the changes that a machine can carry out, and the first required change it cannot."""
    kept = []
    for asked in scenario.changes:
        change = replace(asked, element=_own(asked.element, simulation.joints))
        able = _able(simulation, change.parameter)
        if any(change.applies_to(element) for element in able):
            kept.append(change)
        elif able and change.fallback:
            kept.append(replace(change, element=escape(able[-1])))
        elif not change.optional:
            if not able:
                return (), change
            kept.append(change)
    if scenario.changes and not kept:
        first = scenario.changes[0]
        able = _able(simulation, first.parameter)
        return (scenario.changes, None) if able else ((), first)
    return tuple(kept), None


def _own(pattern: str, joints: Sequence[str]) -> str:
    """Returns a pattern of elements; "JOINT,JOINT_*" then excludes joints named "JOINT_..."."""
    for joint in joints:
        if pattern == joint_pattern(joint):
            others = [escape(o) for o in joints if o.startswith(f"{joint}_")]
            excluded = "".join(f",!{other},!{other}_*" for other in others)
            return pattern + excluded
    return pattern


def healthy_values(
    simulation: Simulation,
    parameter: str,
    joint: str | None = None,
    placed: Mapping[tuple[str, str], float] = MappingProxyType({}),
) -> tuple[float, ...]:
    """Returns the values of a parameter over the elements of a machine.

    Args:
        simulation: The machine, with nominal parameters.
        parameter: Name of the parameter.
        joint: Joint whose elements are read; None for all elements with the parameter.
        placed: Values by element and name that replace the machine's.
    """
    pattern = _own("*" if joint is None else joint_pattern(joint), simulation.joints)
    where = ParameterChange(parameter=parameter, element=pattern, value=1.0, start=0.0)
    having = (e for e in simulation.elements if simulation.has(e, parameter))
    return tuple(
        placed.get((e, parameter), simulation.parameter(e, parameter))
        for e in having
        if where.applies_to(e)
    )


def _able(simulation: Simulation, parameter: str) -> list[str]:
    """Returns the names of all plugin elements, joints and bodies that have a parameter."""
    found = [e for e in simulation.elements if simulation.has(e, parameter)]
    native = NativeJoints(simulation)
    found += [e for e in native.elements if native.has(e, parameter)]
    found += simulation.joints if parameter in FAULTS else ()
    if parameter == ADDED_MASS.name:
        found += Bodies(simulation.model).elements
    return found


ADDED_MASS = Parameter(
    "added_mass", "kg", 0.0, 0.0, 1000.0, True, "point mass fixed at the body's centre of mass"
)


def parameter_units() -> dict[str, str]:
    """Returns the units of all parameters that a scenario can change, by name; "1" for none."""
    own = (ADDED_MASS, ACTUATOR_GAIN, *FAULTS.values())
    units = {entry.name: entry.unit for entry in own}
    for table in plugin_tables().values():
        for name, entry in table.parameters.items():
            units.setdefault(name, entry.unit)
    return units


class Bodies:
    """Point masses at the centres of mass of the moving bodies of a model.

    A mass at the centre of mass changes neither this centre nor the inertia about it. Therefore the
    compiled frame of principal axes stays valid. `restore` undoes the modification of the model.

    Args:
        model: The model to modify; it must not be used elsewhere meanwhile.

    Attributes:
        elements: Names of the bodies that move.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._ids = {
            model.body(i).name: i
            for i in range(1, model.nbody)
            if model.body_weldid[i] != 0 and model.body(i).name
        }
        self._nominal = model.body_mass.copy()
        self._added = dict.fromkeys(self._ids, 0.0)
        self._scratch: mujoco.MjData | None = None
        self.elements = tuple(self._ids)

    def has(self, element: str, name: str) -> bool:
        """Tests whether a body has a parameter of this name."""
        return element in self._ids and name == ADDED_MASS.name

    def parameter(self, element: str, name: str) -> float:
        """Returns the mass that a body carries [kg]."""
        self._check(element, name)
        return self._added[element]

    def set_parameter(self, element: str, name: str, value: float) -> None:
        """Sets the mass that a body carries from now on [kg].

        Raises:
            LeglabError: If body or name do not exist or the mass is out of bounds.
        """
        self._check(element, name)
        value = ADDED_MASS.check(value, f"body {element!r}")
        if value == self._added[element]:
            return
        self._added[element] = value
        body = self._ids[element]
        self._model.body_mass[body] = self._nominal[body] + value
        # mj_setConst computes inverse weights, subtree masses etc. anew (MuJoCo, "Modeling",
        # "Changing inertial properties"). It overwrites the state, so it gets separate data.
        if self._scratch is None:
            self._scratch = mujoco.MjData(self._model)
        mujoco.mj_setConst(self._model, self._scratch)

    def restore(self) -> None:
        """Removes the masses from all bodies."""
        for element in self.elements:
            self.set_parameter(element, ADDED_MASS.name, 0.0)

    def _check(self, element: str, name: str) -> None:
        if element not in self._ids:
            raise SettingsError.unknown("body", element, self._ids)
        if name != ADDED_MASS.name:
            raise SettingsError.unknown("body parameter", name, [ADDED_MASS.name])


ACTUATOR_GAIN = Parameter(
    "actuator_gain", "1", 1.0, 0.0, 10.0, True, "factor on the force of a native actuator"
)
# Fields of MjModel with a quantity of a joint, by the plugins' name of the quantity. A second field
# holds the coefficients of higher orders of a polynomial.
_JOINT_FIELDS = {
    "viscous": ("dof_damping", "dof_dampingpoly"),
    "coulomb": ("dof_frictionloss",),
    "k1": ("jnt_stiffness", "jnt_stiffnesspoly"),
}
_ACTUATOR_FIELDS = ("actuator_gainprm", "actuator_biasprm")
NATIVE_FIELDS = tuple(f for fields in _JOINT_FIELDS.values() for f in fields) + _ACTUATOR_FIELDS


class NativeJoints:
    """Damping, dry friction, stiffness and drive of the joints that native actuators drive.

    MuJoCo's fields are set by the plugins' names: `viscous` [N m s/rad], `coulomb` [N m], `k1`
    [N m/rad]. `actuator_gain` is a factor on the actuator's force, including its internal control
    loop. The model itself is modified; `restore` undoes the changes.

    Args:
        simulation: The machine, with nominal parameters.

    Attributes:
        elements: Names of the joints.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._model = model = simulation.model
        drives = simulation.native.values()
        self._drives = {model.joint(drive.joint).name: drive for drive in drives}
        self.elements = tuple(self._drives)
        self._nominal = (
            {name: getattr(model, name).copy() for name in _present(model)} if drives else {}
        )
        self._gain = dict.fromkeys(self.elements, 1.0)

    def has(self, element: str, name: str) -> bool:
        """Tests whether a parameter of a joint can be changed; a parameter of value 0 cannot."""
        if element not in self.elements:
            return False
        if name == ACTUATOR_GAIN.name:
            return True
        return name in _JOINT_FIELDS and self.parameter(element, name) != 0.0

    def parameter(self, element: str, name: str) -> float:
        """Returns the present value, in SI units."""
        if name == ACTUATOR_GAIN.name:
            return self._gain[element]
        return float(getattr(self._model, _JOINT_FIELDS[name][0])[self._place(element, name)])

    def set_parameter(self, element: str, name: str, value: float) -> None:
        """Sets a parameter from now on.

        Raises:
            LeglabError: The value is negative or not finite.
        """
        drive = self._drives[element]
        if name == ACTUATOR_GAIN.name:
            self._gain[element] = value = ACTUATOR_GAIN.check(value, f"actuator {drive.name!r}")
            for field in _ACTUATOR_FIELDS:
                getattr(self._model, field)[drive.id] = value * self._nominal[field][drive.id]
            return
        if not 0 <= value < np.inf:
            text = f"joint {element!r}: {name} = {value:g}; allowed: "
            raise SettingsError(text, given=value, allowed="0 or more")
        place = self._place(element, name)
        first, *higher = (f for f in _JOINT_FIELDS[name] if f in self._nominal)
        for field in higher:  # the factor of the first order scales all other orders
            factor = value / self._nominal[first][place] if self._nominal[first][place] else 1.0
            getattr(self._model, field)[place] = factor * self._nominal[field][place]
        getattr(self._model, first)[place] = value

    def restore(self) -> None:
        """Restores the nominal parameters of joints and drives."""
        for name, values in self._nominal.items():
            getattr(self._model, name)[:] = values
        self._gain = dict.fromkeys(self.elements, 1.0)

    def _place(self, element: str, name: str) -> int:
        drive = self._drives[element]
        return drive.joint if name == "k1" else drive.dof


def _present(model: mujoco.MjModel) -> tuple[str, ...]:
    """Returns the fields of `NATIVE_FIELDS` that this version of MuJoCo has."""
    return tuple(name for name in NATIVE_FIELDS if hasattr(model, name))


# Parameters that vary between specimens, each by an independent factor per element. Geometry,
# pressures and the oil's grade are known well and do not vary.
_VARIED = (
    "rated_flow",
    "lap",
    "bandwidth_hz",
    "bulk_modulus",
    "entrained_air",
    "internal_leakage",
    "viscous",
    "coulomb",
    "k1",
    "k2",
    "d1",
)

# Largest relative tolerance: a third or more would describe a different machine.
LARGEST = 0.3


def check_tolerance(tolerance: float) -> None:
    """Raises a `LeglabError` for a tolerance outside [0, 0.3]."""
    if not 0 <= tolerance <= LARGEST:
        text = f"tolerance {tolerance!r} is outside "
        raise SettingsError(text, given=tolerance, allowed=f"[0, {LARGEST:g}]")


def vary_bodies(model: mujoco.MjModel, tolerance: float, seed: int) -> None:
    """Scales mass and inertia of every body by a factor exp(tolerance N(0, 1)), in place.

    Args:
        model: Modified in place; make its `MjData` afterwards.
        tolerance: Relative standard deviation [1].
        seed: Seed of the specimen.
    """
    factor = np.exp(tolerance * np.random.default_rng([seed, 11]).standard_normal(model.nbody))
    model.body_mass[:] *= factor
    model.body_inertia[:] *= factor[:, None]
    mujoco.mj_setConst(model, mujoco.MjData(model))


def vary_parameters(simulation: Simulation, tolerance: float, seed: int) -> None:
    """Scales hydraulic, friction and spring parameters of all elements by independent factors.

    The breakaway friction keeps its ratio to the Coulomb friction. For joints with native
    actuators, damping, friction, stiffness and actuator force are scaled in the model itself.

    Args:
        simulation: Modified in place.
        tolerance: Relative standard deviation [1].
        seed: Seed of the specimen.
    """
    rng = np.random.default_rng([seed, 12])
    for element in simulation.elements:
        for name in _VARIED:
            factor = float(np.exp(tolerance * rng.standard_normal()))
            names = (name, "static") if name == "coulomb" else (name,)
            # When scaling up, static first: static friction must never be below Coulomb friction.
            for each in reversed(names) if factor > 1 else names:
                if simulation.has(element, each):
                    value = simulation.parameter(element, each)
                    simulation.set_parameter(element, each, factor * value)
    joints = NativeJoints(simulation)
    for element in joints.elements:
        for name in (*_JOINT_FIELDS, ACTUATOR_GAIN.name):
            factor = float(np.exp(tolerance * rng.standard_normal()))
            if joints.has(element, name):
                joints.set_parameter(element, name, factor * joints.parameter(element, name))
