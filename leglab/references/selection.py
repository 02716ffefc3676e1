"""Which joints an excitation moves."""

from collections.abc import Sequence

import numpy as np

from leglab.base.errors import unknown_name
from leglab.references.base import Joint


def selected(joints: Sequence[Joint], names: Sequence[str] | None, reference: str) -> np.ndarray:
    """Returns 1 for joints that move and 0 for the others.

    Args:
        joints: All joints.
        names: Those that move; None stands for all.
        reference: The trajectory's name, for the message.

    Returns:
        Shape (joints,).

    Raises:
        LeglabError: A name is not among the joints.
    """
    known = [joint.name for joint in joints]
    if names is None:
        return np.ones(len(known))
    for name in names:
        if name not in known:
            raise unknown_name(f"joint of reference {reference!r}", name, known)
    return np.array([float(name in names) for name in known])
