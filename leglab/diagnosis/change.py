"""Everything that a hypothesis changes in a simulation, recorded by the effects it consists of."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import mujoco
import numpy as np

from leglab.diagnosis.machine import Edit, Machine, Variant
from leglab.diagnosis.paths import CommandPath, Correction
from leglab.errors import LeglabError


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Measured series of one recording, smoothed, for the reconstruction of hidden states.

    Attributes:
        period: Sampling period [s].
        position: Joint positions by joint, each (n,).
        velocity: Joint velocities by joint, each (n,).
        piston_velocity: d(actuator length)/dt of the cylinders by actuator [m/s], each (n,).
        lever: d(actuator length)/d(joint position) of the cylinders by actuator, each (n,).
        command: What reaches each actuator (command path applied), each (n,).
        pressure: Pressures by "<joint>_pressure_a" and so on, each (n,), where measured.
        samples: Where windows start, shape (windows,).
    """

    period: float
    position: dict[str, np.ndarray]
    velocity: dict[str, np.ndarray]
    piston_velocity: dict[str, np.ndarray]
    lever: dict[str, np.ndarray]
    command: dict[str, np.ndarray]
    pressure: dict[str, np.ndarray]
    samples: np.ndarray


# Value of a plugin state at the start of every window, shape (windows,).
Start = Callable[[Measured, Variant, np.ndarray], np.ndarray]


class Change:
    """What effects do to a machine: a builder that they write to, in order.

    Args:
        machine: The unmodified machine.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.edits: list[Edit] = []
        self.parameters: dict[tuple[str, str], float] = {}
        # What the model file says of these paths comes first.
        self.commands: dict[str, list[CommandPath]] = {
            actuator: list(paths) for actuator, paths in machine.carried.commands.items()
        }
        self.corrections: dict[str, list[tuple[Correction, float]]] = {
            column: list(undone) for column, undone in machine.carried.corrections.items()
        }
        self.starts: dict[tuple[str, str], Start] = {}

    def parameter(self, element: str, name: str) -> float:
        """Present value of a plugin parameter: as set before, else as in the unmodified model."""
        if (element, name) in self.parameters:
            return self.parameters[element, name]
        return self.machine.parameter(element, name)

    def set_parameter(self, element: str, name: str, value: float) -> None:
        """Sets a plugin parameter through `plugin_state`: the fast path, nothing is compiled.

        The element may be one that an `edit` inserts.
        """
        self.parameters[element, name] = float(value)

    def scale_parameter(self, element: str, name: str, factor: float) -> None:
        """Multiplies a plugin parameter, so that effects on the same one compose."""
        self.set_parameter(element, name, factor * self.parameter(element, name))

    def add_parameter(self, element: str, name: str, difference: float) -> None:
        """Adds to a plugin parameter, so that effects on the same one compose."""
        self.set_parameter(element, name, self.parameter(element, name) + difference)

    def edit(self, key: Hashable, function: Callable[[mujoco.MjSpec], None]) -> None:
        """Edits the specification: inserts an element, or changes a native attribute.

        Models are compiled once per set of keys, so the key holds every value that `function`
        writes. An element that is inserted with its parameters at neutral values, which are then
        set by `set_parameter`, is compiled once for all.
        """
        if key not in [known for known, _ in self.edits]:
            self.edits.append((key, function))

    def command(self, actuator: str, function: CommandPath) -> None:
        """Puts a fault between the measured command and an actuator."""
        if actuator not in self.machine.actuators:
            raise LeglabError(f"actuator {actuator!r} does not exist")
        self.commands.setdefault(actuator, []).append(function)

    def correct(self, column: str, function: Correction, *, noise_gain: float = 1.0) -> None:
        """Undoes a sensor fault in a measured column, before states are reconstructed from it.

        Predictions are compared in corrected units.

        Args:
            column: Of the recording, for instance "knee_position".
            function: Measured to corrected samples.
            noise_gain: Factor by which it multiplies sensor noise (1/scale of a gain fault), so
                that a fit cannot gain by shrinking the noise.
        """
        self.corrections.setdefault(column, []).append((function, noise_gain))

    def start(self, element: str, state: str, function: Start) -> None:
        """Says how a hidden plugin state follows from the measured series at window starts.

        Needed only where the general rules of `leglab.diagnosis.states` do not know the plugin.
        """
        self.starts[element, state] = function
