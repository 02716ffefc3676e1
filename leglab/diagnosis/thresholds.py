"""All numbers of a diagnosis that were chosen rather than derived, each with its reason.

Costs are robust mean squares of whitened errors: in noise variances, so that noise alone gives 1.
`Thresholds` holds those that settings may change, and is handed down; likelihood, search and
verdict take the others, below it. Elsewhere stand what is an effect's physics (bounds, trial sizes,
tolerances), guards against rounding, steps of differences and line searches, and sizes of caches.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Limits of recordings, windows, noise and verdict, in the order in which they are met."""

    # Recordings, before anything is replayed.
    # A position may pass the joint's range by this share before its unit is doubted: a range that
    # was guessed is off by less, degrees by 57 times.
    beyond_range: float = 0.5
    # So many equal samples at a limit in a row look like a saturated sensor.
    saturated_samples: int = 20
    # Share of a single recording that is held out, at its end.
    held_out_share: float = 0.3

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
    # Of windows in which no command moves, and no channel by more than so many noise levels, one in
    # so many is kept: the others say the same.
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
    # Samples from one pose to the next of those in which pushes of native actuators are computed.
    pose_every: int = 1
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
    # A window whose cost exceeds this, or so many usual ones, counts by its logarithm only: one
    # window that starts in a bad moment must not outvote a hundred others.
    robust_limit: float = 3.0
    # Whitened errors are clipped here: beyond lies only a replay that blew up.
    clip: float = 1e5

    # Held-out recordings hardly show effects if the share of their windows in which these show is
    # below this share of that among all windows.
    shown_share: float = 0.3
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

# Equality, smallness, certainty and explanation: constants with one meaning in all parts.
# Shares below which periods, or sizes of turns and counts, are the same: clocks and converters
# that were meant to be differ by less, others by more. Up to this share of rows is lost, and
# of a period stamps jitter, without a word. A parameter within this share of a value has it.
SAME = 0.02
# Shares that do not matter: of a period by which stamps miss the grid, which is rounding of a
# time column and no jitter, of what a signal moves, and of any other whole.
NEGLIGIBLE = 1e-3
# What is below this share of another thing is small beside it: an effect that closes less of
# the gap, a difference of fits or of a drive's influence, data beside a prior, a channel that a
# drive hardly moves, forces left over beside the usual ones.
SMALL = 0.1
# What departs by more standard deviations is no chance, of whatever many thousand samples; an
# effect that does not move the errors by so many cannot be seen.
CERTAIN = 5.0
# Samples of the parabola through the neighbours of a value on the grid. Between samples half
# as many periods apart a value is measured; across a whole one, or a bin, it is where the
# parabola fits.
NEIGHBOURS = 7
# A joint that turns further than this without a limit [rad], twice around and back, is a wheel.
FAR = 4.0 * math.pi
# Forces are told in so many parts of a window, each of two bins at least.
FORCE_BLOCKS = 5
# Cost, or error in noise levels, below which nothing more is missing: windows that start in
# stick-slip or beside jumps of the command lift it on good models to at most this.
EXPLAINED = 2.0
# Effects that explain less than this share of the misfit are no explanation.
EXPLANATION = 0.5

# Recordings: sizes of parameters by what was recorded.
# Trials are these shares of what is recorded: good models leave 2 to 7 % of the forces of a good
# machine unexplained, so that less than 2 % is no fault that a user would notice. The others are
# each some four times as large: a secant holds to twice its jump and down to 0.4 of it.
TRIALS = (0.02, 0.08, 0.3)
# Drive, weight and inertia add up: a force that takes all of them is so many times the largest.
KINDS_OF_FORCE = 3.0
# Largest values are quantiles: one bad sample is no size.
TOP_QUANTILE = 0.99
# Delays and lags are shares of the time in which commands change by their own size, up to that in
# which they forget themselves; no fit follows one beyond this time [s]: windows hardly show it.
LONGEST_DELAY = 0.5

# Windows and their start states.
# A column that rests on one count in every recording shows no step: it is taken to have this one,
# coarse for sensors of pressures [Pa] and of positions [rad or m].
UNSEEN_STEP = (1e4, 1e-3)
# A piston certainly presses its pin with a force beyond this share of its dry friction.
PRESSED = 0.15
# At rest a flank is pressed with at least this force [N], which is little for any cylinder.
FLANK = 1.0
# Errors beyond this are those of a replay that blew up [SI units]: no sensor reads so much.
BLOWN = 1e11

# Priors: how machines are made, how large faults are, how many there are.
# Half of all faults are smaller than so many smallest trials.
FAULT_SIZE = 3.0
# A departure below about half a smallest trial is no fault: nobody would notice it.
NO_FAULT = 0.5
# Odds of one more are below even: of a fault somewhere in the library beside those that are there,
# and of a further parameter of an effect that is there.
FAULT_ODDS = 0.3
# Good machines depart from their model by such standard deviations, in smallest trials, each twice
# the one before: nobody knows which. Of the roughest one unknown in five departs by what would be
# noticed as a fault; wider ones take a fault for many small departures.
SPREADS = (0.05, 0.1, 0.2, 0.4)
# Beside a large fault of a machine with healthy recordings all else departs further, by this share
# of it at most: its law is off by as much as good models leave of the forces of a good machine, 2
# to 7 %. Up to a fault as large as all recorded forces.
BESIDE, WIDER = 0.05, (0.8, 1.6)
# The model's own error has such sizes beside what a set leaves: 0 is an exact model.
SIZES = (0.0, 0.03, 0.1, 0.2, 0.35, 0.6, 1.0, 1.5)
# Where a tolerance is known it holds at the least spread of all else, and grows with it from half
# of a wider one on, but not beyond it.
USUAL = 0.5
# What is there or is not departs by this standard deviation, in trials, where it is not there; so
# does a machine that is as its model but for tolerances.
ABSENT = 1e-3
# A shape has this standard deviation, as a share of its range: it lies anywhere in it.
SHAPE_SPREAD = 0.3
# A machine of another day departs from its healthy self as good machines do from their model, but
# by this share of known tolerances: it is the same machine.
DAY_TOLERANCES = 0.5
# Its own error is as large as in the healthy recordings but for a factor with this log deviation,
# and larger while something is missing.
DAY_SIZES, DAY_FACTOR = (0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 9.0, 16.0), 0.4

# Evidence.
# Tangents are differences over so many trials, and this share of a large departure: at first, for
# effects that are not smooth have none at a smaller step, and later.
COARSE, FINE = (0.3, 0.1), (0.05, 0.02)
# Commands that are louder by this factor show what they move.
LOUDER = 1.0 + FINE[1]
# Between these multiples of a jump its secant holds.
SECANT = (0.4, 2.0)
# This share of the log likelihood counts before anything is known: errors go together.
KAPPA = 0.1
# Recordings below this number are cut into parts, twice as many in all: fewer say little of how
# errors scatter.
FEW_RECORDINGS = 4

# Fits.
# A fit is broken off after so many turns: each takes replays, and what still gains then creeps.
TURNS = 16
# All tangents are taken anew so often at most: each time takes a replay of every unknown.
RENEWALS = 6
# In so many first turns machines are built almost as their model, by these shares of tolerances and
# of smallest trials: beside a gross fault the rest would move to where it does not belong.
STIFF_TURNS, STIFF = 3, (0.05, 0.02)
# Another turn that gains less is not worth its replays [nats].
ENOUGH = 2.0
# A step that does not lower the cost is damped by these shares of each unknown's own curvature:
# what stronger ones gain is not worth a replay.
DAMPINGS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
# So many steps meet the bend that the one before showed: each takes a replay, tangents of all
# unknowns take some fifty.
BENDS = 2
# A fit at so many times the level of the best set, or of noise, is given up: what it lacks is more
# than what it explains.
HOPELESS = 10.0
# Such multiples of the size of what is not smooth are looked at: they reach half
# way to the next trials.
LADDER = (0.3, 0.5, 0.75, 1.3, 1.8, 2.8)

# Search.
# So many windows are replayed, half more of healthy recordings, half as many of the starts of
# recordings: all take time, and neighbours err alike. Beyond so many unknowns, each of which takes
# a replay of them all, they are fewer, and half as many at least.
WINDOWS, MANY_UNKNOWNS = 32, 60
# An onset is looked for where the model explains this first share of every recording.
EARLY_SHARE = 0.25
# So many windows lie on either side of a change, at least: two tell no mean from chance.
FEWEST_WINDOWS = 3
# Errors after a change are larger by at least this factor in square, in the mean of logarithms:
# those of healthy windows hardly vary.
ONSET_RISE = 3.0
# A window tells that an effect is, or is not, at work in it from this chi-square on: three and a
# half standard deviations.
ONSET_TOLD = 12.0
# In so many turns at most the pattern of errors and what explains them are found from each other;
# one that changes neither ends them.
ANNEALINGS = 4
# So many of the best sets are grown by further members, and told as rivals: others lie far behind.
BEST_SETS = 6
# Sets grow to so many members by first order; further ones are added to what was fitted.
DEPTH = 5
# So many additions to a set are scored exactly, twice as many beside a fitted one, and five times
# as many of the first member: one that first order ranks lower hardly leads.
SCORED = 8
# So many sets are fitted from the first linearisation whatever they promise, and so many singles;
# those near the best one are, up to the second number in all. The first number of fits that leave
# least say how the model errs: with each pattern all sets are scored.
SURE_FITS, FIRST_FITS = 3, 5
# So many sets are fitted of what looks at the recordings in another way: beside an exact model, and
# by the balances of forces, of each number of effects.
EACH_WAY = 2
# A set by one joint's balance has so many effects at most; further ones are added to its fit.
JOINT_EFFECTS = 3
# No set has more members: a machine with so many causes at once is another one.
LARGEST_SET = 7
# A member of a set is idle that gains fewer nats, and this share of all that is to be gained: first
# order errs by as much.
IDLE = (3.0, 0.03)
# A set within so many nats of the best one is fitted, and a turn that gains as much goes on with
# the tangents that it has; of a set that is so many times further behind nothing is hoped for, and
# an onset must save as much.
NEAR, BEHIND = 10.0, 3.0
# So many further sets are fitted, for each takes seconds; fewer where so many in a row do not come
# near the best one.
FURTHER_FITS, FRUITLESS = 7, 2

# Verdict.
# A cause is so much more probable in the library than outside of it.
LIBRARY_ODDS = 2.0
# The share that the best impostor explains has this mean and standard deviation, as a logit, on a
# machine of which nothing is known; that counts for so many computed ones.
IMPOSTOR = (-0.85, 1.8, 5.0)
# The edge about one half, below which the right cause hardly explains less, has this width in
# logits.
EDGE = 0.5
# A jump can be seen whose chi-square, beside all that machines differ in, is beyond this.
VISIBLE = CERTAIN**2
# A name is surer than this: it is more probable than not.
NAMED = 0.5
# A member of a confusion set is surer than this, without some part of the recordings.
POSSIBLE = 0.3
# Sets that are less probable by a smaller factor are not told apart by the data. What resists a
# drive has so many numbers: inertia, dry and viscous friction.
TIE, RESISTING = 4.0, 3
# No law is quite the machine's: within this share of a departure two directions are alike, and
# sizes may be off.
LAW = 0.25
# Errors that differ by less, in noise levels, differ by nothing.
ROOM = 0.05
# An onset that is known to less than this [s] is told as a time: a window is hardly longer.
ONSET_WIDE = 0.2

# Remainder.
# Errors of neighbouring bins that correlate by more have a memory: a rest of tenths of a second is
# as alike in bins of hundredths.
ALIKE = 0.3
