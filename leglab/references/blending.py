"""Smooth transitions, with exact derivatives."""

from collections.abc import Sequence

import numpy as np

from leglab.references.base import Joint, Motion, Samples, rest_pose


def smooth_step(times: np.ndarray, start: float, duration: float) -> Samples:
    """Evaluates a rise from 0 to 1 with zero velocity and acceleration at both ends.

    The quintic 10 s^3 - 15 s^4 + 6 s^5 with s = (t - start)/duration is the minimum-jerk
    transition (Flash and Hogan 1985, J. Neurosci. 5(7), appendix) and twice continuously
    differentiable.

    Args:
        times: Times [s]. Shape (n,).
        start: Start time of the rise [s].
        duration: Duration of the rise [s]; 0 gives a jump with zero derivatives.

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
    """Multiplies a trajectory by a factor per joint, and adds a middle position."""
    return Samples(
        middle + factor * wave.position, factor * wave.velocity, factor * wave.acceleration
    )


def fade_in(motion: Motion, joints: Sequence[Joint], duration: float) -> Motion:
    """Builds a motion that starts smoothly from the rest pose.

    Args:
        motion: The motion, as a displacement from the rest pose.
        joints: Joints, for their rest positions.
        duration: Time from 0 until the displacement has its full amplitude [s].

    Returns:
        The rest pose plus the displacement, multiplied by a smooth step from time 0 on.
    """
    rest = rest_pose(joints)

    def faded(times: np.ndarray) -> Samples:
        displacement = product(smooth_step(times, 0.0, duration), motion(times))
        return displacement._replace(position=rest + displacement.position)

    return faded
