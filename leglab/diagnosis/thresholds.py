"""All numbers of a diagnosis that were chosen rather than derived, each with its reason.

Costs are robust mean squares of whitened errors, in noise variances: noise alone gives 1.
`Thresholds` holds the numbers that settings may change; the constants below it are imported by
likelihood, search and verdict. Defined elsewhere: the physics of effects (bounds, trial values,
tolerances), guards against rounding, steps of differences and line searches, sizes of caches.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Limits of recordings, windows, noise and verdict, in the order in which they are met."""

    # Recordings, before anything is replayed.
    # A position may leave the joint's range by this share of the range before its unit is doubted:
    # guessed ranges err by less, a position in degrees is off by a factor of 57.
    beyond_range: float = 0.5
    # Run of equal extreme samples from which a sensor is taken to be saturated.
    saturated_samples: int = 20
    # Share of a single recording that is held out, at its end.
    held_out_share: float = 0.3

    # Savitzky-Golay filters as (length [s], fewest samples, order): they pass the motion of a leg
    # and, at 1 kHz, reduce the noise to a third.
    position_filter: tuple[float, int, int] = (0.021, 7, 4)
    pressure_filter: tuple[float, int, int] = (0.005, 5, 2)

    # Windows and their start states.
    # Length of a window, and of the bins over which predictions and data are averaged [s];
    # `window_length` lengthens both for slow logs.
    window: float = 0.3
    bin: float = 0.01
    # Samples between a window and the ends of a recording, in addition to half of the longest
    # filter: slopes of filtered signals are differences of neighbouring samples.
    margin_samples: int = 2
    # A window rests if no command moves and no channel moves by more than `still_noise` standard
    # deviations of its noise. One in `still_every` of these is kept: they are all alike.
    still_noise: float = 6.0
    still_every: int = 5
    # At most one window for `still_every` moving ones is kept of those that rest, or in which no
    # channel moves by more than this share of its root mean square over all windows (a creeping
    # servo): a ten-thousandth of the motion's squares, on any machine.
    still_motion: float = 0.01
    # A window starts at the calmest sample within this share of its length after a grid point.
    start_room: float = 0.35
    # A chamber below this gauge pressure [Pa] may hold vapour, whose amount no sensor measures: no
    # window starts at such a pressure, and the errors of this chamber after it has fallen so low do
    # not count. No machine stays below it for a whole recording.
    vapour_pressure: float = 2e4
    # Samples between the poses at which accelerations by native actuators' commands are computed.
    pose_every: int = 1
    # Where no pressures are measured, those at the start of a window come from a replay of this
    # time [s] before it, long enough to forget its initial state.
    warm_up: float = 0.15
    # A friction bristle rests if its joint moved less than twice its deflection in this time [s].
    rest_time: float = 0.03

    # Noise model.
    # Number of windows by which the order of the time-step error of replays is estimated: each
    # channel's factor lies between 4/3 and 2, and the median over them is good to some per cent.
    order_windows: int = 20
    # Standard deviation of start states, in standard deviations of the error that smoothing leaves:
    # a small error of a start state must not count for or against an effect.
    start_spread: float = 3.0
    # Standard deviation of the errors by sampling, hold and integrator, as a share of a channel's
    # change over a bin: of positions and of pressures.
    timing_share: tuple[float, float] = (3e-4, 3e-3)
    # Standard deviation [Pa] of unmeasured pressures at window starts, from the replay before it.
    unseen_pressure: float = 3e5
    # Standard deviation of a bristle at a window's start, as a share of its full deflection.
    bristle_share: float = 0.3
    # A window whose cost exceeds this limit, or this multiple of the median cost, counts by its
    # logarithm only: one window with a bad start must not outvote a hundred others.
    robust_limit: float = 3.0
    # Whitened errors are clipped to this: only a replay that diverged exceeds it.
    clip: float = 1e5

    # Held-out recordings hardly show the effects if the fraction of their windows that show them is
    # below this share of the fraction among all windows.
    shown_share: float = 0.3
    # Strengths of a calibrated specimen are listed from this departure on, in smallest trials.
    calibration_share: float = 0.25
    # `leglab improve` writes effects into a model from this confidence on.
    sure: float = 0.8

    # Remainder that is learned from balances of force and oil.
    # A joint slower than this share of its RMS speed rests: its friction is indeterminate.
    resting_speed: float = 0.03
    # A change is worthwhile if it removes more than this share of the misfit; a simpler form is as
    # good as another if it loses no more than this share of the gain.
    worthwhile: float = 0.05
    # A gain must also exceed this multiple of its standard error over blocks or windows.
    beyond_chance: float = 2.5
    # Windows to which replays are fitted, and fewest windows of a balance: several for each of the
    # `learned_directions`, which the balance leaves uncertain and replays refine.
    learned_windows: int = 60
    learned_directions: int = 24


DEFAULT = Thresholds()

# Equality, smallness, certainty and explanation: constants with one meaning in all parts.
# Relative difference below which periods, sizes of turns and of counts, or values of a parameter
# are the same: clocks and converters of one kind differ by less, others by more. Lost rows up to
# this share, and jitter up to this share of a period, are not reported.
SAME = 0.02
# Share that does not matter: of a period by which stamps miss the grid (rounding of a time column,
# not jitter), of a signal's motion, and of any other whole.
NEGLIGIBLE = 1e-3
# Share below which one quantity is small compared with another: the part of the gap that an effect
# closes, a difference of fits or of a drive's influence, the weight of data against a prior, the
# motion of a channel by a drive, residual forces against the usual ones.
SMALL = 0.1
# Number of standard deviations beyond which a departure is not chance, even among many thousand
# samples; an effect that moves the errors by less cannot be seen.
CERTAIN = 5.0
# Samples of the parabola through the neighbours of a value on the grid. The value counts as
# measured in a gap of NEIGHBOURS/2 periods; in one of NEIGHBOURS periods, or of a bin, only where
# the parabola fits.
NEIGHBOURS = 7
# A joint without a limit that turns further than this [rad], two turns, is a wheel.
FAR = 4.0 * math.pi
# Number of parts of a window over which forces are averaged, each of two bins at least.
FORCE_BLOCKS = 5
# Cost, or whitened RMS error, below which nothing more is missing: on good models, windows that
# start in stick-slip or next to jumps of the command raise it to at most this.
EXPLAINED = 2.0
# Effects that explain less than this share of the misfit do not explain it.
EXPLANATION = 0.5

# Recordings: scales of parameters by recorded magnitudes.
# Trial values as shares of recorded magnitudes: good models leave 2 to 7 % of the forces of a good
# machine unexplained, so that a user would not notice a fault below 2 %. Each further trial is
# about four times as large: a secant is valid from 0.4 to 2 times its jump.
TRIALS = (0.02, 0.08, 0.3)
# Drive, weight and inertia add up: a force parameter may reach this multiple of the largest one.
KINDS_OF_FORCE = 3.0
# Largest values are this quantile: a single bad sample must not set a scale.
TOP_QUANTILE = 0.99
# Trials of delays and lags are shares of the time in which commands change by their own magnitude;
# the upper bound is their correlation time, at most this [s]: windows hardly show longer delays.
LONGEST_DELAY = 0.5

# Windows and their start states.
# Assumed quantisation step of columns that rest on one count in every recording, coarse for sensors
# of pressures [Pa] and of positions [rad or m].
UNSEEN_STEP = (1e4, 1e-3)
# A piston certainly presses on its pin with a force beyond this share of its dry friction.
PRESSED = 0.15
# A flank in contact carries at least this force [N], which is little for any cylinder.
FLANK = 1.0
# Errors beyond this [SI units] are those of a replay that diverged: no sensor reads as much.
BLOWN = 1e11

# Priors: how machines are made, how large faults are, how many there are.
# Scale of the Cauchy prior of faults: half of them are below this number of smallest trials.
FAULT_SIZE = 3.0
# A departure below this number of smallest trials is no fault: nobody would notice it.
NO_FAULT = 0.5
# Prior odds, below even, of one more fault anywhere in the library, and of one more parameter of an
# effect that is already in the set.
FAULT_ODDS = 0.3
# Candidate standard deviations of the parameters of good machines about their model, in smallest
# trials; which applies is unknown. On the roughest machine one parameter in five departs by what
# would be noticed as a fault; wider ones would explain a fault by many small departures.
SPREADS = (0.05, 0.1, 0.2, 0.4)
# With healthy recordings, all other parameters may depart further in the presence of a large fault,
# by at most the share BESIDE of it: its law errs by what good models leave of a good machine's
# forces, 2 to 7 %. WIDER are the added deviations, up to a fault as large as all recorded forces.
BESIDE, WIDER = 0.05, (0.8, 1.6)
# Candidate scales of the model error relative to the errors that a set leaves; 0: an exact model.
SIZES = (0.0, 0.03, 0.1, 0.2, 0.35, 0.6, 1.0, 1.5)
# A known tolerance applies unchanged at the smallest of SPREADS. At a wider one it is multiplied by
# this share of their ratio, at least 1, but does not exceed the wider one.
USUAL = 0.5
# Standard deviation, in smallest trials, of the parameters of an absent moving part, and of all
# parameters without a tolerance on a machine that equals its model.
ABSENT = 1e-3
# Standard deviation of a shape as a share of its range: it may lie anywhere in the range.
SHAPE_SPREAD = 0.3
# On another day a machine departs from its healthy state as good machines do from their model, but
# by this share of known tolerances: it is the same machine.
DAY_TOLERANCES = 0.5
# Scales of the model error on another day, relative to the healthy recordings, and standard
# deviation of their logarithm; the larger ones apply while something is missing.
DAY_SIZES, DAY_FACTOR = (0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 9.0, 16.0), 0.4

# Evidence.
# Step of the differences that give tangents, in smallest trials, and as a share of a large
# departure. The first steps are coarse, since effects that are not smooth have no finer tangent.
COARSE, FINE = (0.3, 0.1), (0.05, 0.02)
# Factor on commands by which their influence on the motion is computed.
LOUDER = 1.0 + FINE[1]
# A secant is valid between these multiples of its jump.
SECANT = (0.4, 2.0)
# Initial weight of the log likelihood: errors are correlated.
KAPPA = 0.1
# If there are fewer recordings than this, they are cut into parts, at least twice this number in
# all: from fewer the scatter of errors cannot be estimated.
FEW_RECORDINGS = 4

# Fits.
# Upper limit on the iterations (turns) of a fit: each takes replays, and later gains are small.
TURNS = 16
# Upper limit on renewals of all tangents: each takes one replay per parameter.
RENEWALS = 6
# In the first STIFF_TURNS iterations the prior deviations are these shares of tolerances and of
# smallest trials: otherwise a gross fault would move all other parameters to wrong values.
STIFF_TURNS, STIFF = 3, (0.05, 0.02)
# An iteration that gains less than this [nats] is not worth its replays.
ENOUGH = 2.0
# Damping of steps that do not lower the cost, as shares of each parameter's curvature (Levenberg
# and Marquardt): the gain of stronger damping is not worth a replay.
DAMPINGS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
# Number of second-order corrections of a step, by the curvature that the step before it showed.
# Each takes one replay; tangents of all parameters take about fifty.
BENDS = 2
# A fit whose level (median whitened RMS error) is this multiple of that of the best set, or of
# noise, is given up: it lacks more than it explains.
HOPELESS = 10.0
# Multiples of the magnitude of an effect that is not smooth which are tried: they reach half way to
# the next trials.
LADDER = (0.3, 0.5, 0.75, 1.3, 1.8, 2.8)

# Search.
# Number of windows that are replayed; 3/2 of it of healthy recordings, half of it of the starts of
# recordings: replays take time, and neighbouring windows have similar errors. Beyond MANY_UNKNOWNS
# parameters, each of which takes a replay of all windows, fewer, but at least half of it.
WINDOWS, MANY_UNKNOWNS = 32, 60
# An onset is searched for if the model explains this first share of every recording.
EARLY_SHARE = 0.25
# Fewest windows on either side of a change: two do not distinguish a mean from chance.
FEWEST_WINDOWS = 3
# Least factor by which squared errors grow at a change, in the mean of logarithms: the errors of
# healthy windows hardly vary.
ONSET_RISE = 3.0
# Chi-square from which a window shows that an effect is active, or is not: three and a half
# standard deviations.
ONSET_TOLD = 12.0
# Upper limit on alternating estimates of the error covariance and of the best set; they end when
# neither changes.
ANNEALINGS = 4
# Number of best sets that are extended by further parameters and reported as rivals: others are far
# less probable.
BEST_SETS = 6
# Largest number of parameters of a set before any fit, by the linearisation; further ones are added
# to fitted sets.
DEPTH = 5
# Number of additions to a set that are scored exactly; twice as many to a fitted set, five times as
# many for the first parameter: one with a lower first-order rank is hardly ever the best.
SCORED = 8
# The SURE_FITS best sets and as many single parameters are fitted from the first linearisation, and
# sets near the best one up to FIRST_FITS in all. Each of the SURE_FITS fits with the least error
# gives an error covariance, and all sets are scored with each of these.
SURE_FITS, FIRST_FITS = 3, 5
# Number of sets that are fitted from each other source: the scores under an exact model, and the
# balances of forces, for each number of effects.
EACH_WAY = 2
# Largest number of effects of a set by one joint's balance; further ones are added to its fit.
JOINT_EFFECTS = 3
# Largest number of parameters of a set: a machine with more causes at once is another machine.
LARGEST_SET = 7
# A parameter of a set is idle if it gains less than IDLE[0] nats plus the share IDLE[1] of the best
# set's gain: the linearisation errs by as much.
IDLE = (3.0, 0.03)
# A set within NEAR nats of the best one is fitted, and an iteration that gains as much keeps its
# tangents. A set BEHIND times as far below the best one is not extended, and an onset must gain
# that much.
NEAR, BEHIND = 10.0, 3.0
# Upper limit on further sets that are fitted, each of which takes seconds; the search ends earlier
# when more than FRUITLESS in a row do not come near the best one.
FURTHER_FITS, FRUITLESS = 7, 2

# Verdict.
# Prior odds that a cause is in the library rather than outside of it.
LIBRARY_ODDS = 2.0
# Prior of the share that the best impostor (an effect of another group) explains: mean and standard
# deviation of its logit, and the number of computed shares that this prior counts for.
IMPOSTOR = (-0.85, 1.8, 5.0)
# Width, in logits, of the soft threshold at one half: the right cause hardly explains less.
EDGE = 0.5
# Chi-square, after allowing for all in which good machines differ, from which a jump can be seen.
VISIBLE = CERTAIN**2
# An effect is named if its probability exceeds this: it is more probable than not.
NAMED = 0.5
# Least probability of an effect of a confusion set, with some part of the recordings left out.
POSSIBLE = 0.3
# The data do not distinguish sets whose probabilities differ by less than the factor TIE. RESISTING
# counts the parameters that resist a drive: inertia, dry and viscous friction.
TIE, RESISTING = 4.0, 3
# No law is exactly the machine's: two directions are alike if they differ by less than this share
# of their departure, and magnitudes may err by it.
LAW = 0.25
# Whitened RMS errors that differ by less than this are equal.
ROOM = 0.05
# An onset known to better than this [s] is reported as a time: a window is hardly longer.
ONSET_WIDE = 0.2

# Remainder.
# Correlation of the errors of neighbouring bins above which they have a memory: a residual that
# lasts tenths of a second is as correlated in bins of hundredths.
ALIKE = 0.3
