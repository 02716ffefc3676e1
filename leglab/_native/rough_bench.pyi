"""Types of the simulator of the rough self-test.

Parameters are given by name, those left out are nominal; SI units, pressures gauge.
"""

from numpy import float64
from numpy.typing import NDArray

Array = NDArray[float64]

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
