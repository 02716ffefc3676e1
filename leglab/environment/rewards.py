"""Rewards of an environment, by name; users may pass their own function instead."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from leglab.control import ReferencePoint

# `GOOD_ERROR`: joint error with full reward [rad]. `POOR_ERROR`: excess with reward 0.1 [rad].
GOOD_ERROR, POOR_ERROR = 1e-3, 5e-2


class Transition(NamedTuple):
    """One step of the environment; rewards are functions of it.

    In a batch the arrays have one row per machine: `time` has the shape (machines,), all others
    (machines, joints), and a reward returns an array of shape (machines,).

    Attributes:
        time: Time at the end of the step [s].
        position: True joint positions at the end of the step [rad]. Shape (joints,).
        velocity: True joint velocities at the end of the step [rad/s]. Shape (joints,).
        reference: Reference of the joints at the end of the step.
        command: Valve commands held during the step, in [-1, 1]. Shape (joints,).
        previous_command: Valve commands of the step before. Shape (joints,).
        action: The agent's action, in [-1, 1]. Shape (joints,).
    """

    time: Any
    position: np.ndarray
    velocity: np.ndarray
    reference: ReferencePoint
    command: np.ndarray
    previous_command: np.ndarray
    action: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """True tracking error, position less reference [rad]. Shape (joints,)."""
        return self.position - self.reference.position


Reward = Callable[[Transition], Any]


def tracking(transition: Transition) -> Any:
    """Computes the joints' mean of `dm_control.utils.rewards.tolerance` of the error, in [0, 1].

    It is 1 up to 1 mrad, 0.1 at 51 mrad and 0.001 at half a radian, so that even with large errors
    a smaller error has a higher reward. Bit-identical to dm_control's function, with fewer passes.
    """
    beyond = np.maximum(np.abs(transition.error) - GOOD_ERROR, 0.0) / POOR_ERROR
    return (1.0 / ((3.0 * beyond) ** 2 + 1.0)).mean(axis=-1)


def smooth_tracking(transition: Transition) -> Any:
    """Computes `tracking` times a factor in [0.8, 1] for small changes of the valve commands.

    The factor weights effort as dm_control's suite does: 0.8 + 0.2 times a quadratic function, 1
    without a change, 0 from a change of 0.1 of full opening per step on. The product is in [0, 1].
    """
    from dm_control.utils import rewards

    change = transition.command - transition.previous_command
    calm = rewards.tolerance(change, margin=0.1, value_at_margin=0, sigmoid="quadratic")
    return tracking(transition) * (0.8 + 0.2 * calm.mean(axis=-1))


REWARDS: dict[str, Reward] = {"tracking": tracking, "smooth_tracking": smooth_tracking}
