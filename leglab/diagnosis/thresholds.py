"""All numbers of a diagnosis that were chosen rather than derived, each with its reason.

`Thresholds` holds the numbers that settings may change; likelihood, search and verdict import the
constants below it. Physical constants, guards against rounding and cache sizes are defined where
they are used. Terms: A "set" is a set of effects that a fit adds to the model. The "trials" of a
parameter are values that are tried; the smallest is the least departure that a user would notice.
"Costs" are robust mean squares of whitened errors, so that sensor noise alone costs 1. A "replay"
simulates a short piece of a recording (a "window") under its measured commands.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Thresholds for recordings, windows, noise and verdict, in the order of their use."""

    # Recordings: checks before any replay.
    # Share of a joint's range by which a recorded position may lie outside of the range before its
    # unit is questioned: guessed ranges err by less, degrees instead of radians by a factor of 57.
    beyond_range: float = 0.5
    # Least number of successive samples at an extreme value that are reported as saturation.
    saturated_samples: int = 20
    # Share of a recording's duration that is held out, at its end, if there is no second recording.
    held_out_share: float = 0.3

    # Savitzky-Golay filters as (length [s], fewest samples, order). They pass the motion of a leg.
    # At 1 kHz they multiply the noise by 0.41 for positions and by 0.70 for pressures.
    position_filter: tuple[float, int, int] = (0.021, 7, 4)
    pressure_filter: tuple[float, int, int] = (0.005, 5, 2)

    # Windows, and the states at which their replays start.
    # At low sampling rates `window_length` increases the lengths [s] of windows and bins.
    window: float = 0.3  # length of a window, a piece of a recording that is replayed by itself
    bin: float = 0.01  # length of a bin, over which predictions and data are averaged
    # Number of samples between a window and either end of its recording, in addition to half of the
    # longest filter, because slopes of filtered signals need neighbouring samples.
    margin_samples: int = 2
    # A window rests if no command changes and no channel moves by more than this number of standard
    # deviations of the channel's noise.
    still_noise: float = 6.0
    still_every: int = 5  # one in this number of resting windows is kept, as all are similar
    # A window hardly moves if no command changes and each channel rests or moves by at most this
    # share of its RMS motion over all windows (a creeping servo). At most one window that hardly
    # moves is kept for each `still_every` windows that move.
    still_motion: float = 0.01
    # Each window starts at the calmest sample of an interval of this share of the window length.
    start_room: float = 0.35
    # Gauge pressure [Pa] below which a chamber may hold vapour, whose amount no sensor measures. No
    # window starts below this pressure. After a chamber's pressure has fallen below it in a window,
    # this chamber's errors do not count. No machine stays below it for a whole recording.
    vapour_pressure: float = 2e4
    # Number of samples from one pose to the next at which the accelerations that native actuators
    # cause are computed.
    pose_every: int = 1
    # If no pressures are measured, a replay of this duration [s] that ends at the start of a window
    # computes the window's initial pressures; it is long enough to forget its own initial state.
    warm_up: float = 0.15
    # A friction element rests if it slid by less than twice its full deflection in this time [s].
    rest_time: float = 0.03

    # Noise model.
    # Number of windows by which `extrapolation` predicts errors at time step zero: the median of
    # its factor over this number of windows is accurate to some per cent.
    order_windows: int = 20
    # Factor from the estimated error of start states (noise and bias of smoothing) to its assumed
    # standard deviation: a small error of a start state must not count for or against an effect.
    start_spread: float = 3.0
    # Standard deviation of the errors by sampling, hold and integrator, as a share of a channel's
    # change from bin to bin: for positions, then for pressures.
    timing_share: tuple[float, float] = (3e-4, 3e-3)
    # Standard deviation [Pa] of a window's initial pressures if they are computed, see `warm_up`.
    unseen_pressure: float = 3e5
    # Standard deviation of a friction element's initial deflection, as a share of the full one.
    bristle_share: float = 0.3
    # Limit up to which a window's cost (or its ratio to the median cost) counts in full. Beyond it
    # only the logarithm counts: one window with a bad start must not outvote a hundred others.
    robust_limit: float = 3.0
    # Limit at which whitened errors are clipped: only a replay that diverged exceeds it.
    clip: float = 1e5

    # An effect shows in a window if it changes the errors by more than this share of the median
    # change. Held-out recordings hardly show an effect if the share of windows in which it shows is
    # smaller than this multiple of the share among all windows.
    shown_share: float = 0.3
    # Least departure, in smallest trials, of a strength that the calibration of a specimen lists.
    calibration_share: float = 0.25
    # Least confidence of the effects that `leglab improve` writes into a model.
    sure: float = 0.8

    # Remainder: missing force or oil flow that is learned from balances of force and oil.
    # Share of a joint's RMS speed below which the joint rests: its friction is then indeterminate.
    resting_speed: float = 0.03
    # Least share of the misfit that a worthwhile term removes. A simpler form is preferred if it
    # loses at most this share of the gain.
    worthwhile: float = 0.05
    # A gain must also exceed this multiple of its standard error over blocks of time or windows.
    beyond_chance: float = 2.5
    # Number of windows whose replays refine a remainder, and least number of windows of a balance.
    learned_windows: int = 60
    # Number of principal directions of coefficients that replays refine, shared by all remainders.
    learned_directions: int = 24


DEFAULT = Thresholds()

# Relative difference below which two periods, numbers of turns, counts or parameter values are
# equal: clocks and converters of one kind differ by less, others by more. Lost samples up to this
# share of a recording, and jitter up to this share of a period, are not reported.
SAME = 0.02
# Share of any whole that does not matter, for example of a period by which stamps miss the grid
# (rounding of the time column, not jitter) or of a signal's motion.
NEGLIGIBLE = 1e-3
# Ratio below which one quantity is small compared with another of its kind: misfits, gains in log
# evidence, motions of channels by a drive, residual forces, or the information of the data against
# the information of a prior.
SMALL = 0.1
# Number of standard deviations beyond which a departure is not chance, even among many thousand
# samples. An effect that changes the errors by less is invisible.
CERTAIN = 5.0
# Number of samples around a grid point to which a parabola is fitted. If the two samples next to
# the grid point are at most NEIGHBOURS/2 periods apart, the value counts as measured; if at most
# NEIGHBOURS periods or a bin apart, only if the parabola fits.
NEIGHBOURS = 7
# Angle [rad], two turns, beyond which a joint without a limit is a wheel.
FAR = 4.0 * math.pi
# Number of equal blocks of a window over which forces are averaged; a block has two bins or more.
FORCE_BLOCKS = 5
# Largest cost, or whitened RMS error, of a model that lacks nothing: windows that start in
# stick-slip or next to jumps of the command raise it above 1.
EXPLAINED = 2.0
# Share of the misfit that effects must explain to count as its explanation.
EXPLANATION = 0.5

# Scales of parameters by recorded magnitudes.
# Trial values as shares of recorded magnitudes. Good models leave 2 to 7 % of a good machine's
# forces unexplained, so a user would not notice a fault below 2 %. Each further trial is about four
# times as large, because a secant is valid from 0.4 to 2 times the step over which it is computed.
TRIALS = (0.02, 0.08, 0.3)
# Upper bound of a force parameter as a multiple of the largest single force (of the drive, of
# weight or of inertia), because the three kinds of force add up.
KINDS_OF_FORCE = 3.0
TOP_QUANTILE = 0.99  # quantile used as the largest value: one bad sample must not set a scale
# Longest delay or lag [s] that is tried, since windows hardly show longer ones, or the commands'
# correlation time if that is shorter. Trials are shares of the time in which commands change.
LONGEST_DELAY = 0.5

# Windows and their start states.
# Quantisation steps that are assumed for sensors whose values never change, of pressures [Pa] and
# of positions [rad or m]; they are coarse for such sensors.
UNSEEN_STEP = (1e4, 1e-3)
# Share of a piston's dry friction beyond which a force surely presses the piston against its pin.
PRESSED = 0.15
# Least force [N] between a pin and the flank of its play that it touches; small for any cylinder.
FLANK = 1.0
# Error [SI units] beyond which a replay has diverged: no sensor reads as much.
BLOWN = 1e11

# Priors of good machines' parameters, of the magnitude of faults and of their number.
# Scale of the Cauchy prior of fault magnitudes, in smallest trials: half of the faults are smaller.
FAULT_SIZE = 3.0
# Departure, in smallest trials, below which an effect is no fault: nobody would notice it.
NO_FAULT = 0.5
# Prior odds, less than even, of one more fault anywhere in the library, and of one more parameter
# of an effect that is already in the set.
FAULT_ODDS = 0.3
# Candidate standard deviations of good machines' parameters about their model, in smallest trials;
# all are equally probable. The largest is that of the roughest machine, where one parameter in five
# departs noticeably. Still larger ones would explain a fault by many small departures.
SPREADS = (0.05, 0.1, 0.2, 0.4)
# WIDER: further candidates, only with healthy recordings. BESIDE: largest of these that is allowed,
# as a share of a set's largest fault: good models leave 2 to 7 % of a machine's force unexplained.
BESIDE, WIDER = 0.05, (0.8, 1.6)
# Candidate scales of the model error relative to the errors that a set leaves; 0: an exact model.
SIZES = (0.0, 0.03, 0.1, 0.2, 0.35, 0.6, 1.0, 1.5)
# Tolerances are known for the smallest of SPREADS. A wider spread multiplies them by the ratio of
# the two spreads times this factor, at least by 1; the product does not exceed the wider spread.
USUAL = 0.5
# Standard deviation, in smallest trials, of the parameters of effects that a machine either has or
# lacks, and of parameters without a tolerance if the machine is assumed to equal its model.
ABSENT = 1e-3
# Standard deviation of a shape parameter, as a share of its range: all of the range is possible.
SHAPE_SPREAD = 0.3
# Factor on known tolerances between the healthy recordings of a machine and those of another day,
# below 1 because the machine is the same. Deviations without a tolerance have no such factor.
DAY_TOLERANCES = 0.5
# DAY_SIZES: candidate scales of the model error on another day, relative to its scale in the
# healthy recordings; the large ones apply while an effect is missing. DAY_FACTOR: prior standard
# deviation of the logarithm of this scale.
DAY_SIZES, DAY_FACTOR = (0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 9.0, 16.0), 0.4

# Evidence.
# A tangent is a difference over a step: a number of smallest trials or, if larger, a share of the
# departure. COARSE steps come first, since effects that are not smooth have no FINE tangent.
COARSE, FINE = (0.3, 0.1), (0.05, 0.02)
# Factor by which commands or gains are raised to compute the influence of commands on the motion.
LOUDER = 1.0 + FINE[1]
# Smallest and largest multiple of a step to a trial value for which the step's secant is valid.
SECANT = (0.4, 2.0)
# Initial weight of the log likelihood, below 1 because errors are correlated.
KAPPA = 0.1
# If there are fewer recordings than this, they are cut into at least twice this number of parts,
# because the scatter of errors cannot be estimated from fewer.
FEW_RECORDINGS = 4

# Fits.
# Upper limit on the iterations of a fit: each takes replays, and later ones gain little.
ITERATIONS = 16
# Upper limit on the times that a fit renews all tangents: each takes one replay per parameter.
RENEWALS = 6
# STIFF_FIRST: number of first iterations with narrow priors: under wider ones, a gross fault would
# move all other parameters. STIFF: factor on tolerances, and standard deviation in smallest trials.
STIFF_FIRST, STIFF = 3, (0.05, 0.02)
# Gain [nats] below which an iteration is not worth its replays.
ENOUGH = 2.0
# Dampings to try in turn until a step lowers the cost, as shares of each parameter's curvature
# (Levenberg and Marquardt). Stronger damping gains too little to be worth a replay.
DAMPINGS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
# Number of second-order corrections of a step, each by the curvature that the previous attempt
# showed. A correction takes one replay; tangents of all parameters take about fifty.
BENDS = 2
# A fit is given up if its median whitened RMS error exceeds the least error of all fits, or the
# error of a fit that leaves only noise, by this factor: it lacks more than it explains.
HOPELESS = 10.0
# Factors by which a fit multiplies the magnitude of an effect that is not smooth, to find the best
# magnitude between two trials.
LADDER = (0.3, 0.5, 0.75, 1.3, 1.8, 2.8)

# WINDOWS: number of windows to replay, 3/2 of it for healthy recordings, half of it for an onset. A
# replay takes time, and neighbouring windows have similar errors. MANY_UNKNOWNS: number of
# parameters above which fewer windows, at least half, are replayed, since each takes a replay.
WINDOWS, MANY_UNKNOWNS = 32, 60
# First share of every recording that the model must explain if an onset is to be searched for.
EARLY_SHARE = 0.25
# Fewest windows before or after a change: two do not distinguish a mean from chance.
FEWEST_WINDOWS = 3
# Least rise at a change, as the ratio of the geometric means of squared errors: the errors of
# healthy windows hardly vary.
ONSET_RISE = 3.0
# Chi-square (3.5 standard deviations) from which a window shows that an effect is active or absent.
ONSET_TOLD = 12.0
# Upper limit on the number of times that error covariance and best set are estimated in turn; it
# ends earlier if neither changes.
ANNEALINGS = 4
# Number of most probable sets that are extended by further parameters and reported as rivals,
# because others are far less probable.
BEST_SETS = 6
# Largest number of parameters of a set that is proposed before any fit; fitted sets may get more.
DEPTH = 5
# Number of additions to a set whose evidence is computed, those with the largest first-order gain:
# twice this number for a fitted set, five times for the first parameter.
SCORED = 8
# SURE_FITS: number of most probable sets, and of most probable single parameters, that are fitted
# in any case; the covariances of this number of fits (those with the least errors) score all sets.
# FIRST_FITS: limit on the number of sets that are fitted first if more are near the best one.
SURE_FITS, FIRST_FITS = 3, 5
# Number of sets that each of two other sources proposes: the scores under an exact model, and the
# balance of forces on each joint (this number of sets for each number of effects).
EACH_WAY = 2
# Largest number of effects of a set from one joint's balance; later moves may add more.
JOINT_EFFECTS = 3
# Largest number of parameters of a set: with more causes at once it is another machine.
LARGEST_SET = 7
# A parameter of a set is idle if it gains less than IDLE[0] nats plus the share IDLE[1] of the best
# set's gain over no effect: the linearisation errs by this amount.
IDLE = (3.0, 0.03)
# NEAR: a set is fitted if its log evidence is at most this far [nats] below the best set's. A fit
# keeps its tangents after an iteration that gains this much. BEHIND: sets more than BEHIND * NEAR
# below the best set are not extended, and an onset must gain more than BEHIND * NEAR.
NEAR, BEHIND = 10.0, 3.0
# FURTHER_FITS: limit on fits of sets derived from fitted sets; a fit takes seconds. FRUITLESS: the
# search ends after more than this number of successive fits that do not come near the best set.
FURTHER_FITS, FRUITLESS = 7, 2

# Verdict.
# Prior odds that a cause is in the library rather than outside of it.
LIBRARY_ODDS = 2.0
# Prior of the share of errors that the best impostor (an effect of another group than the cause's)
# explains: mean and standard deviation of the share's logit, and the prior's weight as a number of
# computed shares.
IMPOSTOR = (-0.85, 1.8, 5.0)
# Width of a soft threshold at one half, because the right cause rarely explains less of the errors.
EDGE = 0.5  # [logits]
# Chi-square of a trial value, with all parameters of good machines free, from which it is visible.
VISIBLE = CERTAIN**2
# Probability above which an effect is named: it is more probable than not.
NAMED = 0.5
# Least probability, with some part of the recordings left out, of each effect of a confusion set
# and, without healthy recordings, of the empty set if nothing is missing.
POSSIBLE = 0.3
# TIE: ratio of probabilities below which the data do not distinguish two sets. RESISTING: number of
# parameters that a rival set may have in place of a drive's gain: inertia, dry, viscous friction.
TIE, RESISTING = 4.0, 3
# Relative error of an effect's law, since no law is exactly the machine's: values for the two
# directions are equal if they differ by less, and intervals of magnitudes are widened by it.
LAW = 0.25
# Difference below which two whitened RMS errors are equal.
ROOM = 0.05
# Uncertainty [s] of an onset from which an interval is reported, not a time; less than a window.
ONSET_WIDE = 0.2

# Remainder.
# Correlation of the errors of neighbouring bins above which the errors have a memory. Bins last
# hundredths of a second, so a residual that lasts tenths of a second is correlated.
ALIKE = 0.3
