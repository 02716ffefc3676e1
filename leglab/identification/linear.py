"""Transfer functions and poles of an identifier's linear part, from its coefficients of lags."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import control


def transfer_function(
    output: ArrayLike, inputs: ArrayLike, timestep: float | bool = True
) -> "control.TransferFunction":
    """Returns the transfer function of y(t) = sum_k output_k y(t-k) + sum_k inputs_k u(t-k).

    Args:
        output: Coefficients of y(t - 1), y(t - 2), ...
        inputs: Coefficients of u(t), u(t - 1), ...
        timestep: Sampling time [s]; True leaves it unspecified.
    """
    import control  # takes a second

    a, b = np.asarray(output, dtype=float), np.asarray(inputs, dtype=float)
    order = max(len(a), len(b) - 1)
    denominator = np.concatenate(([1.0], -a, np.zeros(order - len(a))))
    numerator = np.concatenate((b, np.zeros(order + 1 - len(b))))
    return control.TransferFunction(numerator, denominator, timestep)


def poles(output: ArrayLike) -> NDArray[np.complex128]:
    """Returns the poles of y(t) = sum_k output_k y(t-k), complex, one per coefficient."""
    roots = np.roots(np.concatenate(([1.0], -np.asarray(output, dtype=float))))
    return roots.astype(np.complex128)
