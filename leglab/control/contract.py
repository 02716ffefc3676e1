"""Interface and registry of controllers: measurements and references in, commands out.

A controller sees measurements, references and time, never the simulation, so that the same object
could run on a robot. A simulated control period with all joints takes some tens of microseconds. To
keep the controller's share of this time small, measurements and references are plain tuples of
small arrays, and a controller's constructor should compute whatever needs computing only once.
"""

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from leglab.base.errors import ModelError, SettingsError, SimulationError, plugged_in
from leglab.base.registry import FactoryRegistry
from leglab.base.settings import Configuration


class Measurement(NamedTuple):
    """Sensor readings at one instant, with their noise, resolution and latency.

    The runner reuses the arrays in the next period: copy values that are needed later.

    Attributes:
        time: Time since the start of the run [s].
        position: Joint positions [rad]. Shape (joints,).
        velocity: Joint velocities [rad/s]. Shape (joints,).
        pressure_a: Pressures on the cap side [Pa], or None if not measured. Shape (joints,).
        pressure_b: Pressures on the rod side [Pa], or None if not measured. Shape (joints,).
        supply_pressure: Supply pressure [Pa], or None if not measured.
    """

    time: float
    position: np.ndarray
    velocity: np.ndarray
    pressure_a: np.ndarray | None = None
    pressure_b: np.ndarray | None = None
    supply_pressure: float | None = None


class ReferencePoint(NamedTuple):
    """Reference motion of the joints at the time of the measurement.

    Attributes:
        position: Joint positions [rad]. Shape (joints,).
        velocity: Joint velocities [rad/s]. Shape (joints,).
        acceleration: Joint accelerations [rad/s^2]. Shape (joints,).
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


class Controller(Protocol):
    """Interface of an object that turns measurements and references into valve commands.

    `reset` and `command` are required, `diagnostics` is optional.

    A controller that adapts has a further method, `freeze()`: it stops adapting until the next
    `reset`, and its last parameters stay in use. The runner repeats the run as a "frozen twin": it
    freezes the controller just before the machine changes, to show the gain by adaptation.

    A controller that learns from its commands may have `sent(command)`, which receives the commands
    sent to the machine if they differ from those that `command` returned.

    A controller that needs pressures sets `uses_pressures = True`. A controller with `joint_wise =
    True` has no memory and commands each joint from the joint's own measurement and reference only,
    so that one object can command the joints of many machines in one call.
    """

    def reset(self, measurement: Measurement) -> None:
        """Starts a run: forgets everything, including adapted parameters.

        Args:
            measurement: The first measurement of the run.
        """

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Computes the valve commands of one control period.

        Args:
            measurement: The present measurement.
            reference: The present reference.

        Returns:
            Valve commands in [-1, 1], held until the next period. Shape (joints,).
        """

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Returns signals of the last period, to be recorded, by name. Each of shape (joints,).

        The runner copies the arrays that `diagnostics` and `command` return, so the controller may
        overwrite them in the next period.
        """


class NominalMachine:
    """Nominal properties of the machine, unaffected by the changes of a run.

    Each property is computed once, at its first use, by `find`. A subclass overrides `find`, as
    `leglab.commissioning.setup.CommissionedMachine` does, and raises for an unknown property.

    Args:
        known: Values by attribute name, for a machine that is described by numbers alone.

    Attributes:
        direction: Sign of the joint velocity that a positive command gives, (joints,).
        position_gain: PD gains: valve command per position error [1/rad], (joints,).
        velocity_gain: PD gains: valve command per velocity error [s/rad], (joints,).
        setpoint: Command with which drives with an internal position or velocity loop follow a
            reference, (3, joints): the command at rest, its slopes over position [1/rad] and over
            velocity [s/rad]; zeros for other drives. None if no drive has an internal loop.
        valve_maps: Steady command over position and velocity, one `ValveMap` per joint.
        cylinders: Data sheets and levers, a `leglab.control.backstepping.data.NominalCylinders`.
        inverse_dynamics: Function of position, velocity, acceleration to joint torques [N m],
            (joints,) each.
        tuned: Tuned gains by name of the controller; their type depends on the controller.
        latency: Age of a measurement when its command takes effect [s].
        velocity_delay: Delay of the measured velocity's filter [s].
        position_noise: Standard deviation of a measured position, resolution included [rad].
        pressure_noise: Standard deviation of a measured pressure [Pa].

    Raises:
        SettingsError: A name in `known` is not an attribute.
    """

    direction: np.ndarray
    position_gain: Sequence[float]
    velocity_gain: Sequence[float]
    setpoint: np.ndarray | None
    valve_maps: Sequence[Any]
    cylinders: Any
    inverse_dynamics: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    tuned: Mapping[str, Any]
    latency: float
    velocity_delay: float
    position_noise: float
    pressure_noise: float

    def __init__(self, **known: Any) -> None:
        names = NominalMachine.__annotations__
        for name, value in known.items():
            if name not in names:
                raise SettingsError.unknown("property of a nominal machine", name, names)
            self.__dict__[name] = value

    def __getattr__(self, name: str) -> Any:
        if name not in NominalMachine.__annotations__:
            raise AttributeError(f"a nominal machine has no {name!r}")
        self.__dict__[name] = value = self.find(name)
        return value

    def find(self, name: str) -> Any:
        """Computes the value of an attribute that was not passed to the constructor.

        Raises:
            ModelError: The machine does not provide it.
        """
        if name == "setpoint":
            return None
        known = sorted(n for n in self.__dict__ if not n.startswith("_"))
        text = f"the controller needs {name!r} of the machine, which gives "
        raise ModelError(text + (", ".join(known) or "nothing"), given=name, allowed=known)


@dataclass(frozen=True, kw_only=True)
class Foreknowledge:
    """Knowledge that no real controller has, for controllers that serve as bounds only."""

    #: Time at which the machine begins to change [s]; infinite if it never does.
    first_change: float = math.inf
    last_change: float = math.inf  #: Time at which the machine's last change begins [s]
    #: Function that records the machine before and after its changes; None if no machine can be
    #: recorded.
    bench_runs: Callable[[], Any] | None = None
    #: Function that computes the valve commands with which the run's machine follows its reference,
    #: (periods, joints); None without a machine.
    exact_commands: Callable[[], np.ndarray] | None = None


@dataclass(frozen=True, kw_only=True)
class ControllerSetup:
    """Inputs from which a controller is made.

    Attributes:
        joints: Names of the joints; all arrays follow this order.
        control_period: Time from one command to the next [s].
        machine: The nominal machine.
        reference_period: Time after which the planned motion repeats [s]; for a motion that does
            not repeat, its slowest period. None without a planned motion.
        foreknowledge: Knowledge of the run's changes, for controllers that serve as bounds.
        fault_bank: Makes a `leglab.control.feedforward.fault_bank.FaultBank` by simulation of the
            nominal machine; None if there is no machine to simulate.
    """

    joints: tuple[str, ...]
    control_period: float
    machine: NominalMachine = field(default_factory=NominalMachine)
    reference_period: float | None = None
    foreknowledge: Foreknowledge = field(default_factory=Foreknowledge)
    fault_bank: Callable[[], Any] | None = None

    def __post_init__(self) -> None:
        if not self.joints or len(set(self.joints)) != len(self.joints):
            text = f"joints {self.joints!r} of a controller must be "
            raise SettingsError(text, given=self.joints, allowed="distinct names")
        if not (self.control_period > 0 and math.isfinite(self.control_period)):
            text = f"control_period {self.control_period!r} s must be "
            raise SettingsError(text, given=self.control_period, allowed="positive")
        object.__setattr__(self, "joints", tuple(self.joints))

    def wrong_length(self, name: str, values: Sequence, controller: str) -> SettingsError:
        """Builds the error for a setting whose number of values is not the number of joints."""
        return SettingsError(
            f"controller {controller!r}: setting {name!r} has {len(values)} values, needed is ",
            given=values,
            allowed=f"one for each of {', '.join(self.joints)}",
        )


# Makes a controller: usually its class, called with the setup and its validated configuration.
Factory = Callable[[ControllerSetup, Any], Controller]


CONTROLLERS: FactoryRegistry[Factory] = FactoryRegistry("controller")


def register_controller(
    name: str, *, summary: str, configuration: type[Configuration] = Configuration
) -> Callable[[Factory], Factory]:
    """Registers the decorated controller class under a name.

    Args:
        name: Name that users give.
        summary: One line for listings.
        configuration: Settings of the controller, a subclass of `leglab.Configuration` with units
            in its docs. By default there are no settings: the class is called with the setup alone.

    Raises:
        SettingsError: The class lacks a method, a method takes other arguments, or `configuration`
            is not a subclass of `leglab.Configuration`.
    """
    add = CONTROLLERS.register(name, summary=summary, configuration=configuration)

    def register(factory: Factory) -> Factory:
        _check_contract(name, factory)
        return add(factory)

    return register


# Methods that every controller has, with their arguments.
_METHODS = {"reset": ("measurement",), "command": ("measurement", "reference")}


def _check_contract(name: str, factory: Any) -> None:
    """Raises `SettingsError` for a class without the methods of a controller; skips functions."""
    if not inspect.isclass(factory):
        return
    where = f"controller {name!r}: {factory.__qualname__}"
    for method, wanted in _METHODS.items():
        own = getattr(factory, method, None)
        if not callable(own):
            text = f"{where} has no method {method!r}; needed are "
            needed = "reset(measurement) and command(measurement, reference)"
            raise SettingsError(text, given=factory.__qualname__, allowed=needed)
        taken = inspect.signature(own)
        try:
            taken.bind(None, *wanted)
        except TypeError:
            text = f"{where}.{method} takes {taken}; needed is "
            raise SettingsError(
                text, given=str(taken), allowed=f"{method}({', '.join(wanted)})"
            ) from None


def controller_names() -> tuple[str, ...]:
    """Returns the names of all controllers."""
    return CONTROLLERS.names()


def controller_summary(name: str) -> str:
    """Returns the line that describes a controller."""
    return CONTROLLERS.get(name).summary


def make_controller(
    name: str, setup: ControllerSetup, config: Mapping[str, Any] | None = None
) -> Controller:
    """Makes a controller.

    Args:
        name: One of `controller_names()`.
        setup: Inputs from which it is made.
        config: Settings of the controller; omitted settings have their defaults.

    Raises:
        SettingsError: The name or a setting is not known, or a value is not allowed.
    """
    factory, settings = CONTROLLERS.configured(name, config)
    bare = CONTROLLERS.get(name).configuration is Configuration
    with plugged_in(f"controller {name!r}", factory):
        made: Controller = factory(setup) if bare else factory(setup, settings)  # type: ignore[call-arg]
    return made


def diagnostics_of(controller: Controller) -> dict[str, np.ndarray]:
    """Returns the diagnostics of the last period; empty for a controller without diagnostics."""
    report = getattr(controller, "diagnostics", None)
    return {} if report is None else report()


def check_command(command: Any, setup: ControllerSetup, controller: str, time: float) -> np.ndarray:
    """Returns a controller's command after checking that it can be sent to the valves.

    Args:
        command: Result of `Controller.command`.
        setup: The setup that the controller was made with.
        controller: Name of the controller, for the message.
        time: Time of the measurement [s].

    Raises:
        SimulationError: The command is not an array of shape (joints,), or contains NaN or
            infinity; the message names the controller, the time and the joint.
    """
    joints = setup.joints
    shape = getattr(command, "shape", None)
    if shape != (len(joints),):
        got = f"shape {shape}" if shape is not None else f"{type(command).__name__}"
        text = f"controller {controller!r} gave {got} at {time:.6g} s, allowed is "
        raise SimulationError(text, given=got, allowed=f"an array of shape ({len(joints)},)")
    if command.dtype.kind not in "fiu":
        got = f"an array of {command.dtype}"
        text = f"controller {controller!r} gave {got} at {time:.6g} s, allowed are "
        raise SimulationError(text, given=got, allowed="numbers")
    # One dot product is cheaper than isfinite and all: NaN and infinity propagate into it.
    if not math.isfinite(command.dot(command)):
        finite = np.isfinite(command)
        if not finite.all():
            joint = int(np.argmin(finite))
            raise SimulationError(
                f"controller {controller!r} gave {command[joint]} for joint {joints[joint]!r} at "
                f"{time:.6g} s, allowed are ",
                given=float(command[joint]),
                allowed="numbers in [-1, 1]",
            )
    return command
