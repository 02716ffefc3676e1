"""Noise model of replay errors: sensors, start states, and what no simulation gets right."""

from collections.abc import Sequence

import numpy as np
from scipy.signal import savgol_coeffs

from leglab.diagnosis.change import Change
from leglab.diagnosis.machine import CYLINDER
from leglab.diagnosis.replay import Replay
from leglab.diagnosis.series import Series, filter_difference, noise_level
from leglab.diagnosis.starts import Nudge

# Start states are free within this many standard deviations of what smoothing leaves: a start
# that is a little off must not speak for or against an effect.
_LOOSE = 3.0
# Timing of sampling, hold and integrator: this share of a channel's change over a bin is not
# held against a model; of positions and of pressures.
_TIMING = (3e-4, 3e-3)
# Pressures that a replay before the window had to find are that uncertain.
_UNSEEN = 3e5  # Pa
# Bristles start within this share of their full deflection.
_BRISTLE = 0.3
# A chamber below this pressure holds vapour; from then on a window says nothing.
_VAPOUR = 2e4  # Pa gauge


class Whitening:
    """Turns replay errors into numbers of unit variance.

    The covariance of a window's errors is N + S P S': sensor noise of the bins, and start-state
    errors of covariance P carried on by the sensitivity S of the predictions, from replays with
    nudged starts.

    Args:
        replay: Gives windows and sensitivities.
        series: The recordings.
        change: About which sensitivities are taken.
        reference: Errors under `change`, shape (windows, channels, bins).

    Attributes:
        noise: Standard deviation of each channel's samples, by recording and channel.
    """

    def __init__(
        self, replay: Replay, series: Sequence[Series], change: Change, reference: np.ndarray
    ) -> None:
        channels, period = replay.channels, series[0].period
        self.noise = np.array(
            [[noise_level(s.columns[c.column], c.filter) for c in channels] for s in series]
        )
        floor = np.array([_resolution(series, c.column) for c in channels])
        self.noise = np.maximum(self.noise, floor)
        per_bin = replay.samples // replay.bins
        sigma = self.noise[replay.recording]  # (windows, channels)
        measured = replay.measured()
        binned = measured[:, :, 1:].reshape(*measured.shape[:2], replay.bins, per_bin).mean(axis=3)
        change_over_bin = np.abs(np.gradient(binned, axis=2)) if replay.bins > 1 else 0.0 * binned
        timing = np.array([_TIMING[bool(c.chamber)] for c in channels])[:, None]
        variance = (sigma**2 / per_bin)[:, :, None] + (timing * change_over_bin) ** 2
        for chamber in [k for k, c in enumerate(channels) if c.chamber]:
            vapour = np.minimum.accumulate(binned[:, chamber], axis=1) < _VAPOUR
            variance[np.broadcast_to(vapour[:, None], variance.shape)] *= 1e8
        size = len(channels) * replay.bins
        covariance = np.zeros((replay.windows, size, size))
        diagonal = np.arange(size)
        covariance[:, diagonal, diagonal] = variance.reshape(replay.windows, size)
        for nudge, spread in _nudges(replay, series, self.noise, period):
            moved = replay.error(change, nudge=nudge) - reference
            direction = moved.reshape(replay.windows, size) * (spread / nudge.size)[:, None]
            covariance += direction[:, :, None] * direction[:, None, :]
        # Applied hundreds of times: a product of all windows at once beats triangular solves.
        self._whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        self.shape = (len(channels), replay.bins)

    def __call__(self, errors: np.ndarray, chosen: np.ndarray | None = None) -> np.ndarray:
        """Whitened errors, shape (chosen windows, channels x bins)."""
        whiten = self._whiten if chosen is None else self._whiten[chosen]
        return (whiten @ errors.reshape(len(errors), -1, 1))[:, :, 0]


def _resolution(series: Sequence[Series], column: str) -> float:
    """Rounding error of a quantised column: its smallest step over sqrt(12)."""
    steps = [np.abs(np.diff(s.columns[column])) for s in series]
    steps = [s[s > 0].min() for s in steps if (s > 0).any()]
    return float(min(steps)) / np.sqrt(12.0) if steps else 0.0


def _nudges(
    replay: Replay, series: Sequence[Series], noise: np.ndarray, period: float
) -> list[tuple[Nudge, np.ndarray]]:
    """Nudges and the spread of each start state, shape (windows,)."""
    found = []
    machine = replay.machine
    for k, channel in enumerate(replay.channels):
        sigma = noise[replay.recording, k]
        length, order = channel.filter
        kernel = float(np.sqrt((savgol_coeffs(length, order) ** 2).sum()))
        # What another filter makes of the same samples tells where smoothing is biased.
        rough = replay.at_starts(
            [filter_difference(s.columns[channel.column], channel.filter) for s in series]
        )
        spread = _LOOSE * np.hypot(kernel * sigma, rough)
        if channel.chamber and channel.cylinder:
            nudge = Nudge(cylinder=channel.cylinder, quantity=channel.chamber, size=2e4)
            found.append((nudge, spread))
            continue
        size = float(np.median(spread))
        found.append((Nudge(joint=channel.joint, quantity="position", size=size), spread))
        rate = savgol_coeffs(*channel.filter, deriv=1, delta=period)
        rough = replay.at_starts(
            [filter_difference(s.columns[channel.column], channel.filter, period) for s in series]
        )
        spread = _LOOSE * np.hypot(float(np.sqrt((rate**2).sum())) * sigma, rough)
        size = float(np.median(spread))
        found.append((Nudge(joint=channel.joint, quantity="velocity", size=size), spread))
    for cylinder in machine.instances(CYLINDER):
        for chamber in ("pressure_a", "pressure_b") if replay.blind else ():
            nudge = Nudge(cylinder=cylinder, quantity=chamber, size=1e5)
            found.append((nudge, np.full(replay.windows, _UNSEEN)))
        stiffness = machine.parameter(cylinder, "sigma_0")
        if stiffness > 0.0:
            size = _BRISTLE * machine.parameter(cylinder, "static") / stiffness
            spread = np.full(replay.windows, size)
            found.append((Nudge(cylinder=cylinder, quantity="bristle", size=size), spread))
    return found
