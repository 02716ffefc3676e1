"""Iterative inversion of the simulated machine: commands that give zero tracking error.

Iterative learning control with an identified plant inverse (Bristow, Tharayil and Alleyne 2006,
IEEE Control Systems Magazine 26(3), 96): after each trial (simulated run) an inverse model computes
the command correction from the error, low-pass filtered without phase shift. The inverse model maps
a small change of the motion to a change of the command: the slope of the nominal valve map times a
linear function of position, velocity, acceleration and jerk of all joints. Its coefficients are
fitted to the difference of two trials, one of them with small additional random commands.
"""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from leglab.base.scale import rms
from leglab.commissioning.calibration import ValveMap
from leglab.controllers.static_feedforward import ValveMapTable

# Low-pass cutoffs [Hz] of errors (`_CUTOFF`) and of random commands (`_EXCITATION`); RMS of these.
_CUTOFF, _EXCITATION, _AMPLITUDE = 20.0, 8.0, 0.02
# `_GAIN`: learning gain. The iteration ends after `_TRIALS` trials, or after `_PATIENCE` successive
# trials that do not reduce the RMS error by at least the share `_LEAST_GAIN`.
_GAIN, _TRIALS, _PATIENCE, _LEAST_GAIN = 0.8, 30, 5, 0.03
_DERIVATIVES = 3
# Minimum duration of a part between two changes to which an inverse model is fitted [s].
_SHORTEST = 1.0
# Half width of the difference quotient for the slope of the valve maps, as a share of full speed.
_SLOPE = 0.05

# Runs the machine with commands (n, joints) added to the feedback's; returns the error, reference
# less true position [rad], and the feedback's commands, (n, joints) each.
Trial = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def exact_commands(
    try_out: Trial, slope: np.ndarray, start: np.ndarray, period: float, changes: Sequence[int] = ()
) -> np.ndarray:
    """Iterates on the commands until the machine follows its reference.

    Args:
        try_out: Function that runs the machine with exact sensors.
        slope: Nominal valve command per joint speed along the reference [s/rad], (n, joints).
        start: First commands, (n, joints).
        period: Sampling period [s].
        changes: Indices of the periods at which the machine changes. Each part of the run between
            two changes has its own inverse model; in a part below 1 s only the feedback corrects.

    Returns:
        The commands of the trial with the least RMS error, in [-1, 1], (n, joints).
    """
    low_pass = _filter(4, _CUTOFF, period)
    error, feedback = try_out(start)
    noise = np.random.default_rng(0).standard_normal(start.shape)
    noise = _filter(1, _EXCITATION, period)(noise)
    excited = np.clip(start + _AMPLITUDE * noise / noise.std(), -1.0, 1.0)
    other, answer = try_out(excited)
    more = low_pass(excited + answer - start - feedback)
    edges = [0, *changes, len(start)]
    parts = [slice(a, b) for a, b in pairwise(edges) if (b - a) * period >= _SHORTEST]
    motion = _derivatives(low_pass(error - other), period)
    inverses = [_fit(motion[:, part], slope[part], more[part]) for part in parts]

    commands = best = start
    least, waited = np.inf, 0
    for _ in range(_TRIALS):
        found = float(rms(error))
        waited = 0 if found < (1 - _LEAST_GAIN) * least else waited + 1
        if found < least:
            best, least = commands, found
        if waited == _PATIENCE:
            break
        missing = _derivatives(low_pass(error), period)
        step = low_pass(feedback)
        for part, inverse in zip(parts, inverses, strict=True):
            step[part] += slope[part] * np.einsum("dnj,dji->ni", missing[:, part], inverse)
        commands = np.clip(commands + _GAIN * step, -1.0, 1.0)
        error, feedback = try_out(commands)
    return commands if rms(error) < least else best


def valve_slopes(
    maps: Sequence[ValveMap], position: np.ndarray, velocity: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Computes commands of calibrated valve maps along a motion, and their slope over speed.

    Args:
        maps: Valve maps of the joints.
        position: Joint positions [rad], (n, joints).
        velocity: Joint velocities [rad/s], (n, joints).

    Returns:
        Commands, and their derivative with respect to speed [s/rad], each (n, joints).
    """
    command = ValveMapTable(maps)
    width = _SLOPE * np.array([valve_map.velocity[-1] for valve_map in maps])

    def along(shift: np.ndarray) -> np.ndarray:
        shifted = np.ascontiguousarray(velocity + shift)
        return np.array([command(q, v) for q, v in zip(position, shifted, strict=True)])

    return along(0.0 * width), (along(width) - along(-width)) / (2 * width)


def _filter(order: int, cutoff: float, period: float) -> Callable[[np.ndarray], np.ndarray]:
    from scipy.signal import butter, sosfiltfilt  # imported late: takes 0.5 s, few runs need it

    return partial(sosfiltfilt, butter(order, 2 * cutoff * period, output="sos"), axis=0)


def _derivatives(signal: np.ndarray, period: float) -> np.ndarray:
    """Returns the signal (n, joints) and its derivatives, (1 + derivatives, n, joints)."""
    found = [signal]
    for _ in range(_DERIVATIVES):
        found.append(np.gradient(found[-1], period, axis=0))
    return np.stack(found)


def _fit(motion: np.ndarray, slope: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Fits the inverse model's coefficients by least squares, (1 + derivatives, joints, joints)."""
    orders, _, joints = motion.shape
    inverse = np.empty((orders, joints, joints))
    features = np.moveaxis(motion, 1, 0).reshape(len(command), -1)
    for i in range(joints):
        weighted = features * slope[:, [i]]
        scale = rms(weighted, axis=0)
        scale[scale == 0] = 1.0
        solved = np.linalg.lstsq(weighted / scale, command[:, i], rcond=1e-6)[0] / scale
        inverse[:, :, i] = solved.reshape(orders, joints)
    return inverse
