"""Types of the forces of a MuJoCo model at moments of a motion."""

from collections.abc import Mapping

from numpy import float64
from numpy.typing import NDArray

Array = NDArray[float64]

def at_moments(
    model: int, states: Array, commands: Array, accelerations: Array, out: Mapping[str, Array]
) -> None:
    """Writes the forces at moments into the arrays of `out`, see `diagnosis.plant.moments`.

    Args:
        model: Address of the model.
        states: Full physics states, (moments, nstate).
        commands: Controls, (moments, nu).
        accelerations: (moments, nv), NaN where a joint moves as the model has it.
        out: "lacking", "load" and "bias", (moments, nv); "length", "speed" and "pull", (moments,
            nu); "inertia", (moments, nv, nv), as far as they are wanted.

    Raises:
        ValueError: An array has another size.
    """
