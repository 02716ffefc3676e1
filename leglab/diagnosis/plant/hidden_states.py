"""Cache of hidden states along a recording (bristles, spool), reused while a trial leaves them."""

from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")


def alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether arrays are the same or equal."""
    return one is other or np.array_equal(one, other)


class HiddenStates:
    """The last few results of each name, by all that they follow from: `found`, in order of use.

    Arrays that are returned again are the same objects, so that what follows from them is soon
    known as well.
    """

    def __init__(self) -> None:
        self.found: defaultdict[str, deque[tuple[tuple[np.ndarray, ...], object, Any]]]
        self.found = defaultdict(lambda: deque(maxlen=3))

    def get(
        self, name: str, inputs: Sequence[np.ndarray], follow: Callable[[], T], *, by: object = None
    ) -> T:
        """Result of `follow`, which is called only for new inputs or a new model.

        The result may depend on nothing but the inputs and the model `by` which it was found, the
        same object for the same model. Neither inputs nor result may be written to later.
        """
        known = self.found[name]
        for place, one in enumerate(known):
            if one[1] is by and all(map(alike, one[0], inputs)):
                del known[place]
                known.append(one)
                return one[2]
        known.append((tuple(inputs), by, follow()))
        return known[-1][2]
