"""Cache of unmeasured states along a recording (friction, spool), reused if inputs are equal."""

from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")


class HiddenStates:
    """Cache `found` of the last three results per name with their inputs, least recent first.

    It returns the same array objects again, so that the inputs of dependent results compare fast.
    """

    def __init__(self) -> None:
        self.found: defaultdict[str, deque[tuple[tuple[np.ndarray, ...], object, Any]]]
        self.found = defaultdict(lambda: deque(maxlen=3))

    def get(
        self, name: str, inputs: Sequence[np.ndarray], follow: Callable[[], T], *, by: object = None
    ) -> T:
        """Returns the result of `follow`, which is called only for new inputs or a new model.

        The result must depend only on the inputs and the model `by`, which is compared by identity.
        Neither inputs nor result may be written to later.
        """
        known = self.found[name]
        for place, one in enumerate(known):
            pairs = zip(one[0], inputs, strict=True)
            if one[1] is by and all(a is b or np.array_equal(a, b) for a, b in pairs):
                del known[place]
                known.append(one)
                return one[2]
        known.append((tuple(inputs), by, follow()))
        return known[-1][2]
