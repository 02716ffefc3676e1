"""Thresholds of recordings, replays and verdict: numbers that were chosen rather than derived.

Costs are robust mean squares of whitened errors: in noise variances, so that noise alone gives 1.
Constants of an effect's physics (bounds, trial sizes, tolerances) stand with the effect; those of
likelihood, search and confidence with the code that they belong to.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Limits, sizes and counts of all steps, in the order in which a diagnosis meets them."""

    # Recordings, before anything is replayed.
    # A position may pass the joint's range by this share before its unit is doubted: a range that
    # was guessed is off by less, degrees by 57 times.
    beyond_range: float = 0.5
    # A joint that turns further than this without a limit [rad], twice around and back, is a wheel.
    far: float = 4.0 * math.pi
    # So many equal samples at a limit in a row look like a saturated sensor.
    saturated_samples: int = 20
    # Share of a single recording that is held out, at its end.
    held_out_share: float = 0.3

    # Series on a uniform grid.
    # Shares below which periods, or sizes of turns and counts, are the same: clocks and converters
    # that were meant to be differ by less, others by more. Up to this share of rows is lost, and
    # of a period stamps jitter, without a word.
    same: float = 0.02
    # Shares that do not matter: of a period by which stamps miss the grid, which is rounding of a
    # time column and no jitter, and of what a signal moves.
    negligible: float = 1e-3
    # Samples of the parabola through the neighbours of a value on the grid. Between samples half
    # as many periods apart a value is measured; across a whole one, or a bin, it is where the
    # parabola fits.
    neighbours: int = 7
    # What departs by more standard deviations is no chance, of whatever many thousand samples.
    certain: float = 5.0
    # Savitzky-Golay filters as (length [s], fewest samples, order): they pass the motion of a leg
    # and, at 1 kHz, take noise to a third.
    position_filter: tuple[float, int, int] = (0.021, 7, 4)
    pressure_filter: tuple[float, int, int] = (0.005, 5, 2)

    # Windows and their start states.
    # Length of a window, and of the bins over which predictions and data are averaged [s]; of a
    # slow log what `window_length` makes of them.
    window: float = 0.3
    bin: float = 0.01
    # Samples that a window keeps from the ends of a recording beyond the reach of the longest
    # filter: slopes of what was filtered are differences of neighbours.
    margin_samples: int = 2
    # Of windows in which no command moves by more than this share of its range, and no channel by
    # more than so many noise levels, one in so many is kept: the others say the same.
    still_command: float = 0.02
    still_noise: float = 6.0
    still_every: int = 5
    # Of these, and of windows in which no channel moves by more than this share of its root mean
    # square over all windows (a servo that creeps), one is kept for so many others at most. They
    # have a ten-thousandth of the motion's squares together, on any machine.
    still_motion: float = 0.01
    # Windows start at the calmest sample within this share of their length from a regular grid.
    start_room: float = 0.35
    # A chamber below this gauge pressure [Pa] may hold vapour, whose amount no sensor tells: no
    # window starts there, and what a window says after such a moment does not count. No machine
    # runs its whole recording there.
    vapour_pressure: float = 2e4
    # Where no pressures are measured, a replay of this time [s] before a window, which forgets
    # where it began, says what they are at its start.
    warm_up: float = 0.15
    # A bristle that slid less than twice its deflection in this time [s] rests.
    rest_time: float = 0.03

    # Noise model.
    # So many windows tell of which order the error of the replays' time step is: each channel's
    # factor lies between 4/3 and 2, and the median of so many is good to some per cent.
    order_windows: int = 20
    # Start states are free within this many standard deviations of what smoothing leaves: a start
    # that is a little off must not speak for or against an effect.
    start_spread: float = 3.0
    # Sampling, hold and integrator: this share of a channel's change over a bin is not held
    # against a model; of positions and of pressures.
    timing_share: tuple[float, float] = (3e-4, 3e-3)
    # Standard deviation [Pa] of pressures that a replay before the window had to find.
    unseen_pressure: float = 3e5
    # Standard deviation of a bristle at a window's start, as a share of its full deflection.
    bristle_share: float = 0.3
    # A window whose cost exceeds this counts by its logarithm only: one window that starts in a
    # bad moment must not outvote a hundred others.
    robust_limit: float = 3.0
    # Whitened errors are clipped here: beyond lies only a replay that blew up.
    clip: float = 1e5

    # Forces are told in so many parts of a window, each of two bins at least.
    force_blocks: int = 5
    # Verdict.
    # Cost, or error in noise levels, below which nothing more is missing: windows that start in
    # stick-slip or beside jumps of the command lift it on good models to at most this.
    explained: float = 2.0
    # Held-out recordings hardly show effects if the share of their windows in which these show is
    # below this share of that among all windows.
    shown_share: float = 0.3
    # Effects that explain less than this share of the misfit are no explanation.
    explanation_share: float = 0.5
    # An effect beside others that closes less of the gap is a smaller difference.
    smaller_share: float = 0.1
    # Strengths of a calibrated specimen that are listed depart by this share of barely noticeable.
    calibration_share: float = 0.25
    # `leglab improve` writes effects into a model from this confidence on.
    sure: float = 0.8

    # What is learned from balances of force and oil.
    # A joint slower than this share of its usual speed rests: its friction is anything up to a
    # limit.
    resting_speed: float = 0.03
    # A change is worthwhile if it saves this share of the misfit, what is simpler as good if it
    # costs no more of what was gained ...
    worthwhile: float = 0.05
    # ... by more than so many standard errors over blocks or windows.
    beyond_chance: float = 2.5
    # Windows to which replays are fitted, as many as a balance needs at least: several for each of
    # these directions, which replays refine of what its estimate leaves open.
    learned_windows: int = 60
    learned_directions: int = 24


DEFAULT = Thresholds()
