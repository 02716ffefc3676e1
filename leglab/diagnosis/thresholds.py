"""All numbers of a diagnosis that were chosen rather than derived, each with its reason.

`Thresholds` holds the numbers that settings may change; likelihood, search and verdict import the
constants below it. The physics of effects, guards against rounding, steps of differences and sizes
of caches are defined elsewhere. A "set" is a set of effects that a fit adds to the model, with
their parameters. The "smallest trial" of a parameter is the least departure that a user would
notice. Costs are robust mean squares of whitened errors, so that noise alone costs 1.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Limits of recordings, windows, noise and verdict, in the order in which they are met."""

    # Recordings: checks before any replay.
    # Share of a joint's range by which a position may leave it before its unit is doubted: guessed
    # ranges err by less, whereas a position in degrees is off by a factor of 57.
    beyond_range: float = 0.5
    # Least number of successive samples at an extreme value that are reported as saturation.
    saturated_samples: int = 20
    # Share of a recording's duration that is held out, at its end, if there is no second recording.
    held_out_share: float = 0.3

    # Savitzky-Golay filters of positions and pressures as (length [s], fewest samples, order),
    # which pass the motion of a leg and, at 1 kHz, reduce the noise to a third.
    position_filter: tuple[float, int, int] = (0.021, 7, 4)
    pressure_filter: tuple[float, int, int] = (0.005, 5, 2)

    # Windows and their start states.
    # Length [s] of the windows that are replayed, and of the bins over which predictions and data
    # are averaged. At low sampling rates `window_length` lengthens both.
    window: float = 0.3
    bin: float = 0.01
    # Samples between a window and the ends of its recording, in addition to half of the longest
    # filter, because slopes of filtered signals are differences of neighbouring samples.
    margin_samples: int = 2
    # A window rests if no command changes and no channel moves by more than `still_noise` standard
    # deviations of its noise. One in `still_every` of these windows is kept: all look the same.
    still_noise: float = 6.0
    still_every: int = 5
    # A window hardly moves if it rests, or if no channel moves by more than this share of its root
    # mean square over all windows (a creeping servo), a ten-thousandth of the motion's squares. For
    # `still_every` windows that move, at most one that hardly moves is kept.
    still_motion: float = 0.01
    # Share of the window length, after a grid point, in which the calmest sample becomes the start.
    start_room: float = 0.35
    # Gauge pressure [Pa] below which a chamber may hold vapour, whose amount no sensor measures. No
    # window starts at such a pressure, and once a chamber has fallen so low in a window its errors
    # do not count. No machine stays below this pressure for a whole recording.
    vapour_pressure: float = 2e4
    # Step in samples between the poses at which native actuators' accelerations are computed.
    pose_every: int = 1
    # Duration [s] of the replay that computes the initial pressures of a window if no pressures are
    # measured; it ends where the window starts, and is long enough to forget its own initial state.
    warm_up: float = 0.15
    # Time [s] in which a friction bristle at rest slides by less than twice its full deflection.
    rest_time: float = 0.03

    # Noise model.
    # Number of windows that give the order of the replay's time-step error: a channel's factor lies
    # between 4/3 and 2, and the median over the windows is good to some per cent.
    order_windows: int = 20
    # Factor from the error that smoothing leaves in start states to the standard deviation that the
    # noise model assumes: a small error of a start state must not count for or against an effect.
    start_spread: float = 3.0
    # Standard deviation of the errors by sampling, hold and integrator, as a share of a channel's
    # change over a bin: for positions, then for pressures.
    timing_share: tuple[float, float] = (3e-4, 3e-3)
    # Standard deviation [Pa] of a window's initial pressures if the replay before it gives them.
    unseen_pressure: float = 3e5
    # Standard deviation of a bristle's initial deflection, as a share of its full deflection.
    bristle_share: float = 0.3
    # Limit on the cost of a window and on its ratio to the median cost. Beyond the limit a cost
    # counts by its logarithm only: one window with a bad start must not outvote a hundred others.
    robust_limit: float = 3.0
    # Limit at which whitened errors are clipped: only a replay that diverged exceeds it.
    clip: float = 1e5

    # A window shows the effects if they change its errors by more than this share of the median
    # change. Held-out recordings hardly show them if such windows are rarer, by this factor, than
    # among all.
    shown_share: float = 0.3
    # Least departure, in smallest trials, of a strength that the calibration of a specimen lists.
    calibration_share: float = 0.25
    # Least confidence of the effects that `leglab improve` writes into a model.
    sure: float = 0.8

    # Remainder: missing force or oil flow that is learned from balances of force and oil.
    # Share of a joint's RMS speed below which the joint rests: its friction is then indeterminate.
    resting_speed: float = 0.03
    # Share of the misfit that a change must remove to be worthwhile, and share of the gain that a
    # simpler form may lose and still be as good as another.
    worthwhile: float = 0.05
    # A gain must also exceed this multiple of its standard error over blocks or windows.
    beyond_chance: float = 2.5
    # Number of windows whose replays refine a remainder, and least number for a balance: several
    # for each of the `learned_directions`, combinations of coefficients that are open after the
    # balance.
    learned_windows: int = 60
    learned_directions: int = 24


DEFAULT = Thresholds()

# Relative difference below which two periods, sizes of turns or of counts, or parameter values are
# the same: clocks and converters of one kind differ by less, others by more. Lost rows up to this
# share, and jitter up to this share of a period, are not reported.
SAME = 0.02
# Share of any whole that does not matter, for example of a period by which stamps miss the grid
# (rounding of the time column, not jitter) or of a signal's motion.
NEGLIGIBLE = 1e-3
# Ratio below which one quantity is small compared with another: the share of the misfit that an
# effect explains, a difference of fits or of a drive's influence, the weight of data against a
# prior, the motion of a channel by a drive, residual forces against the usual ones.
SMALL = 0.1
# Number of standard deviations beyond which a departure is not chance, even among many thousand
# samples. An effect that moves the errors by less cannot be seen.
CERTAIN = 5.0
# Number of samples around a grid point to which a parabola is fitted. Between two samples up to
# NEIGHBOURS/2 periods apart the grid value counts as measured; up to NEIGHBOURS periods or a bin
# apart only if the parabola fits.
NEIGHBOURS = 7
# Angle [rad], two turns, beyond which a joint without a limit is a wheel.
FAR = 4.0 * math.pi
# Number of equal parts of a window over which forces are averaged; each has two bins at least.
FORCE_BLOCKS = 5
# Cost, or whitened RMS error, up to which nothing is missing: on good models, windows that start in
# stick-slip or next to jumps of the command raise it to at most this.
EXPLAINED = 2.0
# Share of the misfit that effects must explain to count as its explanation.
EXPLANATION = 0.5

# Scales of parameters by recorded magnitudes.
# Trial values as shares of recorded magnitudes. Good models leave 2 to 7 % of a good machine's
# forces unexplained, so a user would not notice a fault below 2 %. Each further trial is about four
# times as large, because a secant is valid from 0.4 to 2 times its jump.
TRIALS = (0.02, 0.08, 0.3)
# Upper bound of a force parameter relative to the largest of drive, weight, inertia: these add up.
KINDS_OF_FORCE = 3.0
# Quantile that is used as the largest value: a single bad sample must not set a scale.
TOP_QUANTILE = 0.99
# Upper bound [s] of delays and lags if the commands' correlation time is longer: windows hardly
# show longer delays. Trials are shares of the time in which commands change by their magnitude.
LONGEST_DELAY = 0.5

# Windows and their start states.
# Quantisation steps that are assumed for sensors whose values never change, of pressures [Pa] and
# of positions [rad or m]; they are coarse for such sensors.
UNSEEN_STEP = (1e4, 1e-3)
# Share of a piston's dry friction beyond which a force surely presses the piston against its pin.
PRESSED = 0.15
# Least force [N] on a flank of a play that is in contact; little for any cylinder.
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
# which one applies is unknown. On the roughest machine one parameter in five departs by what would
# be noticed as a fault. Wider ones would explain a fault by many small departures.
SPREADS = (0.05, 0.1, 0.2, 0.4)
# WIDER: further candidates with healthy recordings, allowed up to the share BESIDE of the largest
# fault of a set, because this fault's law errs by what good models leave of a good machine's
# forces, 2 to 7 %. The widest belongs to a fault as large as all recorded forces.
BESIDE, WIDER = 0.05, (0.8, 1.6)
# Candidate scales of the model error relative to the errors that a set leaves; 0: an exact model.
SIZES = (0.0, 0.03, 0.1, 0.2, 0.35, 0.6, 1.0, 1.5)
# The smallest of SPREADS leaves known tolerances unchanged. A wider spread multiplies them by this
# share of the ratio of the two spreads, at least by 1, but not beyond the wider spread.
USUAL = 0.5
# Standard deviation, in smallest trials, of the parameters of a moving part that is absent, and of
# all parameters without a tolerance in a fit that assumes that the machine equals its model.
ABSENT = 1e-3
# Standard deviation of a shape parameter, as a share of its range: all of the range is possible.
SHAPE_SPREAD = 0.3
# Factor on known tolerances for a machine that has left its healthy state on another day, below 1
# because it is the same machine; other deviations are as between good machines and their models.
DAY_TOLERANCES = 0.5
# Candidate scales of the model error on another day, relative to the healthy recordings, and prior
# standard deviation of their logarithm. The large scales apply while an effect is missing.
DAY_SIZES, DAY_FACTOR = (0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 9.0, 16.0), 0.4

# Evidence.
# Steps of the differences that give tangents, in smallest trials and as a share of a large
# departure. The first steps are coarse, since effects that are not smooth have no finer tangent.
COARSE, FINE = (0.3, 0.1), (0.05, 0.02)
# Factor by which commands are raised to compute their influence on the motion.
LOUDER = 1.0 + FINE[1]
# Smallest and largest multiple of a jump to a trial value for which its secant is valid.
SECANT = (0.4, 2.0)
# Initial weight of the log likelihood, below 1 because errors are correlated.
KAPPA = 0.1
# If there are fewer recordings than this, they are cut into at least twice this number of parts,
# because the scatter of errors cannot be estimated from fewer.
FEW_RECORDINGS = 4

# Fits.
# Upper limit on the iterations of a fit: each takes replays, and later ones gain little.
TURNS = 16
# Upper limit on the times that a fit renews all tangents: each takes one replay per parameter.
RENEWALS = 6
# Number of first iterations with a narrow prior, and its standard deviations as shares of tolerance
# and smallest trial. With a wider prior a gross fault would move all other parameters.
STIFF_TURNS, STIFF = 3, (0.05, 0.02)
# Gain [nats] below which an iteration is not worth its replays.
ENOUGH = 2.0
# Dampings to try in turn until a step lowers the cost, as shares of each parameter's curvature
# (Levenberg and Marquardt). Stronger damping gains too little to be worth a replay.
DAMPINGS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
# Number of second-order corrections of a step, each by the curvature that the previous attempt
# showed. A correction takes one replay; tangents of all parameters take about fifty.
BENDS = 2
# Ratio of a fit's median whitened RMS error to the best set's error, or to noise, beyond which the
# fit is given up: it lacks more than it explains.
HOPELESS = 10.0
# Factors on the magnitude of an effect that is not smooth. A fit tries these values, which reach
# half way to the next trials.
LADDER = (0.3, 0.5, 0.75, 1.3, 1.8, 2.8)

# Number of windows that are replayed (3/2 of it for healthy recordings, half of it for an onset):
# replays take time, and neighbouring windows have similar errors. It falls, at most to a half, with
# more than MANY_UNKNOWNS parameters, each of which takes a replay of all windows.
WINDOWS, MANY_UNKNOWNS = 32, 60
# First share of every recording that the model must explain if an onset is to be searched for.
EARLY_SHARE = 0.25
# Fewest windows on either side of a change: two do not distinguish a mean from chance.
FEWEST_WINDOWS = 3
# Least rise at a change, as the ratio of the geometric means of squared errors: the errors of
# healthy windows hardly vary.
ONSET_RISE = 3.0
# Chi-square from which a window shows that an effect is active or is not: 3.5 standard deviations.
ONSET_TOLD = 12.0
# Upper limit on alternating estimates of the error covariance and of the best set; they end when
# neither changes.
ANNEALINGS = 4
# Number of most probable sets that are extended by further parameters and reported as rivals:
# others are far less probable.
BEST_SETS = 6
# Largest number of parameters of a set before any fit, by the linearisation; fitted sets get more.
DEPTH = 5
# Number of additions to a set whose evidence is computed, by first-order gain: twice as many for a
# fitted set, five times as many for the first parameter. Others are hardly ever the best.
SCORED = 8
# SURE_FITS: number of best sets, and of best single parameters, that are fitted from the first
# linearisation, and number of fits with the least error whose error covariance serves to score all
# sets. FIRST_FITS: limit on the first fits if further sets are near the best one.
SURE_FITS, FIRST_FITS = 3, 5
# Number of sets to fit from each of two other sources: the scores under an exact model, and the
# balances of forces, for each number of effects.
EACH_WAY = 2
# Largest number of effects of a set from one joint's balance; more are added when it is fitted.
JOINT_EFFECTS = 3
# Largest number of parameters of a set: with more causes at once it is another machine.
LARGEST_SET = 7
# A parameter of a set is idle if it gains less than IDLE[0] nats plus the share IDLE[1] of the best
# set's gain: the linearisation errs by this amount.
IDLE = (3.0, 0.03)
# NEAR: distance [nats] in log evidence from the best set up to which a set is fitted, and gain from
# which an iteration keeps its tangents. BEHIND: multiple of NEAR; sets that are further behind the
# best one are not extended, and an onset must gain more.
NEAR, BEHIND = 10.0, 3.0
# FURTHER_FITS: upper limit on fits of further sets, each of which takes seconds. FRUITLESS: upper
# limit on successive fits that do not come near the best set; the next one ends the search.
FURTHER_FITS, FRUITLESS = 7, 2

# Verdict.
# Prior odds that a cause is in the library rather than outside of it.
LIBRARY_ODDS = 2.0
# Prior of the share of errors that the best impostor (an effect of another group) explains: mean
# and standard deviation of its logit, and number of computed shares that weigh as much as the
# prior.
IMPOSTOR = (-0.85, 1.8, 5.0)
# Width [logits] of the soft threshold at a share of one half: the right cause hardly explains less.
EDGE = 0.5
# Chi-square from which a trial can be seen, after allowing for all in which good machines differ.
VISIBLE = CERTAIN**2
# Probability above which an effect is named: it is more probable than not.
NAMED = 0.5
# Probability that an effect of a confusion set needs with some part of the recordings left out.
POSSIBLE = 0.3
# TIE: ratio of probabilities below which the data do not distinguish two sets. RESISTING: number of
# parameters that a rival set may have in place of a drive's gain: inertia, dry, viscous friction.
TIE, RESISTING = 4.0, 3
# Relative error of an effect's law, since no law is exactly the machine's: values for the two
# directions are equal if they differ by less, and intervals of magnitudes allow for it.
LAW = 0.25
# Difference below which two whitened RMS errors are equal.
ROOM = 0.05
# Uncertainty [s] below which an onset is reported as a time: a window is hardly longer.
ONSET_WIDE = 0.2

# Remainder.
# Correlation of the errors of neighbouring bins above which the errors have a memory: a residual
# that lasts tenths of a second is as correlated in bins of hundredths.
ALIKE = 0.3
