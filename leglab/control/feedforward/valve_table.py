"""Calibrated valve maps of all joints as one table that can be inverted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Calibrated commands of at least this magnitude mean that the valve is at its limit.
_SATURATED = 0.999

# Lower bound of the slope of a map [command per share of full speed]; real slopes are larger.
_LEAST_SLOPE = 1e-3


@dataclass(frozen=True, kw_only=True)
class ValveTable:
    """Commands of all joints by position (rows) and share of full speed; rows are monotone."""

    start: np.ndarray  #: First positions [rad], (joints,)
    end: np.ndarray  #: Last positions [rad], (joints,)
    spacing: np.ndarray  #: Differences between neighbouring positions [rad], (joints,)
    full_speed: np.ndarray  #: Full speeds, at which the share is 1 [rad/s], (joints,)
    share: np.ndarray  #: Shares of full speed of the columns, increasing, (columns,)
    #: Valve commands, (joints, rows, columns); beyond [-1, 1] where the row reached the valve's
    #: limit in the calibration and was extrapolated linearly.
    command: np.ndarray

    @classmethod
    def of(cls, maps: Sequence, directions: np.ndarray | None = None) -> "ValveTable":
        """Makes the table.

        Args:
            maps: One per joint, with `position` (p,) [rad], `velocity` (v,) [rad/s] and `command`
                (p, v); positions equally spaced, velocities equal up to a factor per joint.
            directions: Sign of the velocity that a positive command gives, (joints,); rows are made
                monotone with this sign. None leaves the commands as calibrated.
        """
        share = maps[0].velocity / maps[0].velocity[-1]
        rows = [np.asarray(m.command, dtype=float) for m in maps]
        if directions is not None:
            rows = [_repaired(row, share, sign) for row, sign in zip(rows, directions, strict=True)]
        return cls(
            start=np.array([m.position[0] for m in maps]),
            end=np.array([m.position[-1] for m in maps]),
            spacing=np.array([m.position[1] - m.position[0] for m in maps]),
            full_speed=np.array([m.velocity[-1] for m in maps]),
            share=share,
            command=np.stack(rows),
        )

    def command_per_share(self) -> np.ndarray:
        """Computes commands per share of full speed: mean slope up to half speed, mid-position."""
        low, high = np.searchsorted(self.share, [-0.5, 0.5])
        middle = self.command[:, self.command.shape[1] // 2]
        rise = np.abs(middle[:, high] - middle[:, low])
        return rise / (self.share[high] - self.share[low])


def _repaired(command: np.ndarray, share: np.ndarray, sign: float) -> np.ndarray:
    """Makes rows monotone; extrapolates saturated ends; replaces mostly saturated rows."""
    rows: dict[int, np.ndarray] = {}
    for place, row in enumerate(command):
        good = np.abs(row) < _SATURATED
        if good.sum() < len(row) // 2:
            continue
        x, y = share[good], sign * row[good]
        slopes = np.maximum((y[[1, -1]] - y[[0, -2]]) / (x[[1, -1]] - x[[0, -2]]), _LEAST_SLOPE)
        y = np.interp(share, x, y)
        y += slopes[0] * np.minimum(share - x[0], 0) + slopes[1] * np.maximum(share - x[-1], 0)
        steps = np.maximum(np.diff(y), _LEAST_SLOPE * np.diff(share))
        middle = len(share) // 2
        after = y[middle] + np.concatenate([[0.0], np.cumsum(steps[middle:])])
        before = y[middle] - np.cumsum(steps[:middle][::-1])[::-1]
        rows[place] = sign * np.concatenate([before, after])
    if not rows:  # all commands are saturated, so that a straight line is as good as any map
        return np.tile(sign * share, (len(command), 1))

    def nearest(place: int) -> np.ndarray:
        return rows[min(rows, key=lambda known: abs(known - place))]

    return np.stack([nearest(place) for place in range(len(command))])
