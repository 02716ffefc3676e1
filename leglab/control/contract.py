"""What a controller sees and gives, and how one is made by name.

A controller sees measurements, references and time, never the simulation, so the same object could
run on a robot. A closed loop has some tens of microseconds of wall time for each control period,
all joints and everything else included: what passes through here at every period is a plain tuple
of small arrays, and what can be computed once belongs into a controller's constructor.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np

from leglab.base.errors import LeglabError
from leglab.base.registry import Registry
from leglab.base.settings import Configuration, validate_configuration


class Measurement(NamedTuple):
    """What the sensors say at one instant, with their noise, resolution and latency.

    The arrays belong to the runner and change with the next period: copy what is kept.

    Attributes:
        time: Time since the start of the run [s].
        position: Joint positions [rad]. Shape (joints,).
        velocity: Joint velocities [rad/s]. Shape (joints,).
        pressure_a: Pressures on the cap side [Pa], or None where none is measured. Shape (joints,).
        pressure_b: Pressures on the rod side [Pa], or None where none is measured. Shape (joints,).
        supply_pressure: Supply pressure [Pa], or None where it is not measured.
    """

    time: float
    position: np.ndarray
    velocity: np.ndarray
    pressure_a: np.ndarray | None = None
    pressure_b: np.ndarray | None = None
    supply_pressure: float | None = None


class ReferencePoint(NamedTuple):
    """Where the joints should be at the time of the measurement.

    Attributes:
        position: Joint positions [rad]. Shape (joints,).
        velocity: Joint velocities [rad/s]. Shape (joints,).
        acceleration: Joint accelerations [rad/s^2]. Shape (joints,).
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


class Controller(Protocol):
    """Turns measurements and references into valve commands."""

    def reset(self, measurement: Measurement) -> None:
        """Starts a run: forgets everything, adapted parameters included.

        Args:
            measurement: The first measurement of the run.
        """

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Computes the valve commands of one control period.

        Args:
            measurement: The measurement of now.
            reference: Where the joints should be now.

        Returns:
            Valve commands in [-1, 1], held until the next period. Shape (joints,).
        """

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Returns what is worth recording of the last period, by name. Each of shape (joints,).

        The runner copies the arrays: they may change with the next period, as may those that
        `command` returns.
        """


@dataclass(frozen=True, kw_only=True)
class ControllerSetup:
    """The machine as its controller knows it: the nominal one, whatever happens to it in a run.

    Attributes:
        joints: Names of the joints; all arrays follow this order.
        control_period: Time from one command to the next [s].
        machine: Nominal data by name: calibrations, limits, piston areas, ... in SI units. A value
            that takes long to find may be a function without arguments; `require` calls it.
    """

    joints: tuple[str, ...]
    control_period: float
    machine: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.joints or len(set(self.joints)) != len(self.joints):
            raise LeglabError(f"joints {self.joints!r} of a controller must be distinct names")
        if not (self.control_period > 0 and math.isfinite(self.control_period)):
            raise LeglabError(f"control_period {self.control_period!r} s must be positive")
        object.__setattr__(self, "joints", tuple(self.joints))
        object.__setattr__(self, "machine", MappingProxyType(dict(self.machine)))

    def require(self, name: str, controller: str) -> Any:
        """Returns an item of the machine's data.

        Args:
            name: The item.
            controller: Who needs it, for the message.

        Raises:
            LeglabError: The machine's data has no such item.
        """
        if name not in self.machine:
            known = ", ".join(sorted(self.machine)) or "nothing"
            raise LeglabError(
                f"controller {controller!r} needs {name!r} of the machine, which gives {known}"
            )
        value = self.machine[name]
        return value() if callable(value) else value

    def wrong_length(self, name: str, values: Sequence, controller: str) -> LeglabError:
        """Builds the error for a setting that needs one value a joint and has another number."""
        return LeglabError(
            f"controller {controller!r}: setting {name!r} has {len(values)} values, needed is one "
            f"for each of {', '.join(self.joints)}"
        )


# Makes a controller: usually its class, called with the setup and its validated configuration.
Factory = Callable[[ControllerSetup, Any], Controller]


@dataclass(frozen=True, kw_only=True)
class _Entry:
    factory: Factory
    summary: str
    configuration: type[Configuration]


CONTROLLERS: Registry[_Entry] = Registry("controller")


def register_controller(
    name: str, *, summary: str, configuration: type[Configuration]
) -> Callable[[Factory], Factory]:
    """Registers the decorated controller class under a name.

    Args:
        name: Name that users give.
        summary: One line for listings.
        configuration: Its settings, with units in their docs.
    """

    def register(factory: Factory) -> Factory:
        entry = _Entry(factory=factory, summary=summary, configuration=configuration)
        CONTROLLERS.add(name, entry, factory)
        return factory

    return register


def make_controller(
    name: str, setup: ControllerSetup, config: Mapping[str, Any] | None = None
) -> Controller:
    """Makes a controller.

    Args:
        name: One of `controller_names()`.
        setup: The machine it is for.
        config: Its settings; what is left out has its default.

    Raises:
        LeglabError: The name or a setting is not known, or a value is not allowed.
    """
    entry = CONTROLLERS.get(name)
    settings = validate_configuration(entry.configuration, config, f"controller {name!r}")
    return entry.factory(setup, settings)


def controller_names() -> tuple[str, ...]:
    """Returns the names of all controllers."""
    return CONTROLLERS.names()


def controller_summary(name: str) -> str:
    """Returns the line that describes a controller."""
    return CONTROLLERS.get(name).summary


def check_command(command: Any, setup: ControllerSetup, controller: str, time: float) -> np.ndarray:
    """Returns what a controller gave, if it can be sent to the valves.

    Args:
        command: What `Controller.command` returned.
        setup: The setup it was made with.
        controller: Its name, for the message.
        time: Time of the measurement [s].

    Raises:
        LeglabError: It is no array of shape (joints,), or has a NaN or an infinity; names the
            controller, the time and the joint.
    """
    joints = setup.joints
    shape = getattr(command, "shape", None)
    if shape != (len(joints),):
        got = f"shape {shape}" if shape is not None else f"{type(command).__name__}"
        raise LeglabError(
            f"controller {controller!r} gave {got} at {time:.6g} s, allowed is an array of shape "
            f"({len(joints)},)"
        )
    # One dot product instead of isfinite and all: NaN and infinity survive it.
    if not math.isfinite(command.dot(command)):
        finite = np.isfinite(command)
        if not finite.all():
            joint = int(np.argmin(finite))
            raise LeglabError(
                f"controller {controller!r} gave {command[joint]} for joint {joints[joint]!r} at "
                f"{time:.6g} s, allowed are numbers in [-1, 1]"
            )
    return command
