"""Smooth transitions, with exact derivatives."""

from collections.abc import Sequence

import numpy as np

from leglab.references.base import Joint, Motion, Samples, rest_pose


def smooth_step(times: np.ndarray, start: float, duration: float) -> Samples:
    """Rises from 0 to 1 with zero velocity and acceleration at both ends.

    The quintic 10 s^3 - 15 s^4 + 6 s^5 with s = (t - start)/duration is the minimum-jerk
    transition (Flash and Hogan 1985, J. Neurosci. 5(7), appendix) and twice continuously
    differentiable.

    Args:
        times: Times [s]. Shape (n,).
        start: When the rise starts [s].
        duration: How long it takes [s]; 0 gives a jump with zero derivatives.

    Returns:
        Value, rate [1/s] and second derivative [1/s^2]. Each of shape (n, 1).
    """
    if duration == 0:
        jump = (times >= start).astype(np.float64)[:, None]
        return Samples(jump, np.zeros_like(jump), np.zeros_like(jump))
    s = np.clip((times - start) / duration, 0.0, 1.0)[:, None]
    return Samples(
        s**3 * (10 + s * (-15 + s * 6)),
        30 * (s * (1 - s)) ** 2 / duration,
        60 * s * (1 - s) * (1 - 2 * s) / duration**2,
    )


def product(weight: Samples, motion: Samples) -> Samples:
    """Multiplies two trajectories and applies the product rule to their derivatives."""
    return Samples(
        weight.position * motion.position,
        weight.position * motion.velocity + weight.velocity * motion.position,
        weight.position * motion.acceleration
        + 2 * weight.velocity * motion.velocity
        + weight.acceleration * motion.position,
    )


def scaled(middle: np.ndarray, factor: np.ndarray, wave: Samples) -> Samples:
    """Stretches a trajectory by a factor a joint, and moves it to a middle position."""
    return Samples(
        middle + factor * wave.position, factor * wave.velocity, factor * wave.acceleration
    )


def fade_in(motion: Motion, joints: Sequence[Joint], duration: float) -> Motion:
    """Starts a motion from rest.

    Args:
        motion: The motion, as a displacement from the rest pose.
        joints: Give the rest pose.
        duration: Time from 0 until the motion is complete [s].

    Returns:
        The rest pose plus the displacement, which grows in from time 0.
    """
    rest = rest_pose(joints)

    def faded(times: np.ndarray) -> Samples:
        displacement = product(smooth_step(times, 0.0, duration), motion(times))
        return displacement._replace(position=rest + displacement.position)

    return faded
