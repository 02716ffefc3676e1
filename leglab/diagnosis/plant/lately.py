"""Series that were followed along a recording lately: most trials of a search leave them alike."""

from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")


def alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether arrays are the same or equal."""
    return one is other or np.array_equal(one, other)


class Lately:
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
        """What `follow` gives; it is called only where the inputs, or the model, are new.

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
