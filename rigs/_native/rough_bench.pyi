"""Types of the simulator of the rough self-test.

Parameters are given by name, those left out are nominal; SI units, pressures gauge.
"""

from numpy import float64
from numpy.typing import NDArray

Array = NDArray[float64]

class Plant:
    """A bench between samples; steps of the integrator [s]."""

    def __init__(self, parameters: dict[str, float], step: float) -> None: ...
    def start(self, angle: float) -> None:
        """Rests where the encoder shows this angle."""

    def change(self, parameters: dict[str, float]) -> None:
        """Is another bench from now on."""

    def advance(self, command: float, steps: int) -> float:
        """Holds a command; returns what the encoder shows, without noise."""

def nominal() -> dict[str, float]: ...
def follow(
    parameters: dict[str, float],
    reference: Array,
    position_noise: Array,
    noise_a: Array,
    noise_b: Array,
    period: float,
    steps: int,
) -> tuple[Array, Array, Array, Array]:
    """Follows a reference from rest: measured position, command, measured pressures."""

def play(
    parameters: dict[str, float], angle: float, command: Array, period: float, steps: int
) -> tuple[Array, Array, Array, Array]:
    """Plays commands, starting at rest at an angle."""

def derivative(
    parameters: dict[str, float], time: float, state: Array, command: float
) -> Array: ...
def integrate(
    parameters: dict[str, float], state: Array, command: float, step: float, count: int
) -> Array:
    """States after each step of a held command, one after the other."""

def rest(parameters: dict[str, float], angle: float) -> Array: ...
