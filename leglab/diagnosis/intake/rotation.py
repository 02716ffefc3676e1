"""Unwrapping of encoders that restart after a turn."""

import numpy as np

from leglab.diagnosis.thresholds import NEIGHBOURS, SAME

_TURN = 2.0 * np.pi


def unwrapped(
    time: np.ndarray, samples: np.ndarray, *, hinge: bool
) -> tuple[np.ndarray, float, int] | None:
    """Removes the jumps of an encoder that restarts after a full turn.

    A jump is a step of more than half of the encoder's range, after which the motion continues. On
    a `hinge` its size is 2 pi, or a multiple or fraction of 2 pi. Any other size is accepted if all
    jumps have this size and all angles of a turn occur (an encoder before a gear, a counter that
    overflows). Between two samples, the joint must move by less than half a turn. `time` [s] and
    `samples` have the shape (n,); missing samples are NaN.

    Returns:
        The samples without jumps, (n,), the size of a turn in their unit, and the number of jumps;
        None if there are no jumps.
    """
    good = np.flatnonzero(np.isfinite(samples))
    if good.size < 10:
        return None
    steps, intervals = np.diff(samples[good]), np.diff(time[good])
    unit, spare = np.median(intervals), int(np.ceil(1e-3 * (good.size - 1)))
    shown = np.sort(samples[good])[spare : good.size - spare]
    # Steps over longer intervals may be motion; further below, the speed around them decides.
    jumps = (intervals <= NEIGHBOURS * unit) & (np.abs(steps) > 0.5 * np.ptp(shown))
    usual = intervals <= 1.5 * unit
    still = np.flatnonzero(~jumps & usual)
    if not jumps.any() or still.size < 0.2 * steps.size:
        return None
    places = np.flatnonzero(jumps)
    beside = np.interp(places, still, steps[still] / intervals[still]) * intervals[places]
    turn = _turn(shown, np.abs(steps[places] - beside), hinge=hinge)
    if turn is None:
        return None
    rate = (steps - turn * np.rint(steps / turn)) / intervals
    speed = np.interp(np.arange(steps.size), np.flatnonzero(usual), rate[usual])
    expected = np.where(usual, 0.0, speed * intervals)
    turns = np.rint((expected - steps) / turn)
    out = samples.copy()
    out[good[1:]] += turn * np.cumsum(turns)
    return out, turn, int((turns != 0.0).sum())


def _turn(shown: np.ndarray, sizes: np.ndarray, *, hinge: bool) -> float | None:
    """Returns the size of a turn by sorted values and jump sizes; None if jumps are not turns."""
    turn, span = float(np.median(sizes)), float(np.ptp(shown))
    same, part = SAME, 0.25
    if (np.abs(sizes - turn) < part * turn).mean() < 0.9 or span > (1.0 + same) * turn:
        return None
    if hinge:
        if abs(turn - _TURN) < same * _TURN:
            return _TURN
        known = np.concatenate([_TURN * np.arange(1, 65), _TURN / np.arange(2, 65)])
        nearest = float(known[np.argmin(np.abs(known - turn))])
        if abs(turn - nearest) < part * same * nearest:  # narrow, as known sizes are close
            turn = nearest
    agree = np.median(np.abs(sizes - turn)) < same * turn
    # A turning encoder passes every angle, so no large part of a turn may be missing.
    unseen = max(np.diff(shown).max(initial=0.0), turn - span)
    return turn if agree and unseen < part * turn else None
