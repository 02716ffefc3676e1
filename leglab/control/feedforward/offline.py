"""Offline identification from a recording, as on a test bench."""

from dataclasses import dataclass

import numpy as np

from leglab.control import Measurement, ReferencePoint
from leglab.control.feedforward.adaptive import AdaptiveFeedforward


@dataclass(frozen=True, kw_only=True)
class BenchRun:
    """Recording of a moving machine; arrays have a row per control period."""

    time: np.ndarray  #: [s], (n,)
    position: np.ndarray  #: Measured positions [rad], (n, joints)
    command: np.ndarray  #: Valve commands sent, (n, joints)
    reference: ReferencePoint  #: Reference at `time`, arrays of shape (n, joints)

    def identify(self, learning: AdaptiveFeedforward) -> np.ndarray:
        """Resets a feed-forward and replays the recording to it; returns the learned parameters.

        Shape (joints, parameters), or (parameters,) for one joint. With plain recursive least
        squares they equal the batch least-squares solution.
        """
        learning.reset()
        still = np.zeros_like(self.position[0])  # learning does not use measured velocities
        arrays = map(np.ascontiguousarray, (self.position, self.command, *self.reference))
        for time, position, command, *reference in zip(self.time.tolist(), *arrays, strict=True):
            learning.step(Measurement(time, position, still), ReferencePoint(*reference))
            learning.sent(command)
        return learning.learner.parameters
