"""Thresholds of the diagnosis: every number that was chosen rather than derived.

Costs are robust mean squares of whitened errors: in noise variances, so that noise alone gives 1.
Constants of an effect's physics (bounds, trial sizes, tolerances) stand with the effect.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Limits, sizes and counts of all steps, in the order in which a diagnosis meets them."""

    # Recordings, before anything is replayed.
    # A position may pass the joint's range by this share before its unit is doubted.
    beyond_range: float = 0.5
    # No hydraulic machine runs its whole recording below this pressure [Pa]: 0.1 bar.
    no_pressure: float = 1e4
    # So many equal samples at a limit in a row look like a saturated sensor.
    saturated_samples: int = 20
    # A recording is too slow for the others if its period is longer than this [s], and this many
    # times theirs.
    slowest_period: float = 0.02
    slowest_factor: float = 5.0
    # Share of a period by which stamps may jitter before it is worth a note.
    even_clock: float = 0.02
    # Share of a single recording that is held out, at its end.
    held_out_share: float = 0.3

    # Series on a uniform grid.
    # Clocks that differ by less than this share were meant to be the same.
    same_period: float = 0.02
    # A log that has lost more than this share of its rows is averaged, not bridged.
    lost_share: float = 0.02
    # Between samples at most so many periods apart a value on the grid is measured ...
    gap_periods: float = 3.5
    # ... and between samples up to so many periods or this time [s] (a bin's) apart, where their
    # neighbours lie on one parabola to so many standard deviations of noise.
    bridged_periods: float = 6.5
    bridged_time: float = 0.01
    bridged_misfit: float = 5.0
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
    # window starts there, and what a window says after such a moment does not count.
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

    # A rough machine is judged by the forces that its measured motion leaves over as well, averaged
    # over so many parts of a window.
    force_blocks: int = 5

    # Fits.
    # Rounds of iteratively reweighted least squares in a step.
    reweightings: int = 3
    # A nuisance parameter stays within this many tolerances: beyond, it is an effect.
    nuisance_box: float = 4.0
    # Median over windows of the mean square of errors whose mean is 1 and that go together.
    usual_cost: float = 0.7
    # A machine that differs from its model everywhere: its command paths and sensors are off by
    # this share of what is barely noticeable, or by this one where the model is perfect (no delay,
    # no hysteresis) and no machine is; parameters with a tolerance by so many tolerances. Wider,
    # that would hide faults; healthy recordings, which have none, allow all that is barely
    # noticeable for all strengths, and so many tolerances.
    rough_share: float = 0.3
    rough_imperfect: float = 0.7
    rough_tolerance: float = 2.0
    healthy_tolerance: float = 3.0
    # The same machine on another day stays within this share of them. Its errors have a known size,
    # and those of replays, and of forces, are worth so many numbers beside that.
    drift_share: float = 0.5
    calibrated_numbers: float = 100.0
    # So many windows of healthy recordings calibrate a specimen.
    calibration_windows: int = 80
    # Discrepancy of the model and fit are made anew, so often at most, until the error's level in
    # noise levels squared stays above this share of the last.
    annealings: int = 4
    annealed: float = 0.9
    # On healthy recordings, and with all that was found, so often again with fine differences; the
    # latter until the cost stays above this share of the last.
    sharpenings: int = 4
    converged: float = 0.998
    # Finite differences of the last fits, as a share of those of the first.
    fine_differences: float = 0.1

    # A search of a rough machine ends where so many effects are found and none of them is a cause.
    fruitless: int = 3

    # Of the variance of a rough machine's errors the right effect is taken to leave this share:
    # under such a discrepancy the first effects are screened and fitted. The second share holds
    # with healthy recordings, whose own errors bound it from below.
    rough_left: float = 0.3
    calibrated_left: float = 0.1

    # Screening and rounds of the search.
    # So many windows are screened and fitted at first; a verdict uses twice as many.
    screened_windows: int = 40
    # First-order steps go this many times as far as a trial; of two effects at once.
    furthest: float = 20.0
    pair_furthest: float = 3.0
    # So many of the screened effects are refitted; on a rough machine more, for there the right one
    # is not always among the first four. So many of those are sharpened, on a rough machine again
    # more: many parameters follow, and a first fit is far from its end.
    refitted: int = 4
    rough_refitted: int = 6
    sharpened: int = 3
    rough_sharpened: int = 8
    # A round whose best screened effect saves less than this cost a window ends there.
    hopeful_gain: float = 0.04
    # A rough fit that costs more than this share of the baseline is started again from there.
    stuck_share: float = 0.95
    # A rival whose excess over noise is this many times the leader's stays behind.
    hopeless_factor: float = 8.0
    # On a rough machine a round ends where no first fit is this many times as probable as no
    # effect at all; else those are sharpened that are so many times as probable as the best, if
    # all fits still lose this share of what they began with.
    rough_chance: float = 0.5
    rough_hopeless: float = 1e-3
    rough_unfinished: float = 0.05
    # A rival below this cost may still catch up, in so many more fits.
    close_cost: float = 4.0
    patience: int = 3
    # So many of all pairs to first order are fitted: of an exact machine, whose effects are far
    # larger than what first order holds for, and of a rough one.
    pairs: int = 6
    rough_pairs: int = 3
    # Two effects at once must cost less than this share of the best single one.
    pair_share: float = 0.6
    # Above this cost more is certainly missing, and finishing the present fit can wait.
    much_missing: float = 8.0
    # Above this cost, some fifty noise levels squared, no effects will explain it down to noise.
    hardly_explained: float = 12.0
    # The search for a rough machine must leave this many times less of the mean square error where
    # held out: else the machine differs from its model in one cause, which no effect is.
    no_rougher: float = 2.0
    # The noise model is taken about the fit and the fit made anew, this often at most.
    settling: int = 3
    # An early effect may be swapped for a rival that cost at most this factor more.
    near_factor: float = 1.2
    # A set of effects is challenged anew after it changed, so often at most.
    challenges: int = 4

    # When an effect is named.
    # Cost below which nothing more is missing: windows that start in stick-slip or beside jumps of
    # the command lift it on good models to at most this.
    explained: float = 2.0
    # Cost, with the discrepancy of its healthy recordings, below which a specimen errs as it did.
    as_healthy: float = 1.1
    # Cost below which not even a further round is worthwhile.
    clean: float = 1.25
    # A strength must depart from nominal by this share of its smallest trial ...
    noticeable: float = 0.15
    # ... save this cost, or this share of what was in excess of noise ...
    worthwhile: float = 0.08
    # ... and reach this t value of paired differences of held-out windows.
    significant: float = 2.5
    # An effect that shows at times only: windows whose cost changes by more than this ...
    changed_cost: float = 1.0
    # ... are at least so many, and this share of them changes for the better.
    changed_windows: int = 2
    changed_for_better: float = 0.9

    # Onsets.
    # This first share of every recording is taken for healthy, if the refitted model explains it
    # to this cost.
    early_share: float = 0.25
    healthy_cost: float = 2.0
    # So many windows lie on either side of a change, at least.
    onset_windows: int = 3
    # Windows after a change cost at least this factor more, in the mean of their logarithms.
    onset_factor: float = 3.0
    # Chi-square that an onset must save over the same effect throughout.
    onset_gain: float = 60.0
    # Chi-square by which a window tells that an effect is, or is not, at work in it.
    onset_evidence: float = 12.0
    # Errors have left the noise where they exceed those of healthy windows by this factor.
    departed_factor: float = 6.0

    # Verdict and confidence.
    # Independent numbers that the errors of a rough machine are worth, in replays, and again in
    # forces: calibrated by the self-test on rough specimens, docs/diagnosis.md.
    rough_numbers: float = 30.0
    # Odds that the cause of a gap is among the effects that are looked for, where they explain half
    # of what is beyond the model's own error; and half of an error whose own part is unknown.
    library_odds: float = 3.0
    uncalibrated_odds: float = 50.0
    # Standard deviation of the size of a change that is found on one, as a share of it.
    rough_size: float = 0.25
    # A rival this many times less probable is not told apart.
    rough_tie: float = 4.0
    # Held-out recordings hardly show effects if the share of their windows in which these show is
    # below this share of that among all windows.
    shown_share: float = 0.3
    # Strengths of healthy specimens scatter by this share of what is barely noticeable about their
    # model, by this one about what they were on another day; those of faults lie within so many
    # times what is barely noticeable.
    specimen_spread: float = 0.7
    day_spread: float = 0.15
    fault_range: float = 5.0
    # What is less probably a fault than this is a smaller difference.
    fault: float = 0.5
    # An effect of a rough machine that closes less of the gap, or does less of what all that were
    # found do, is a smaller difference.
    smaller_share: float = 0.1
    # What is named without healthy recordings and leaves more than noise, of a rough machine more
    # than half of the gap, is told as a part of what is missing from this confidence on.
    partly: float = 0.5
    # Strengths of a calibrated specimen that are listed depart by this share of barely noticeable.
    calibration_share: float = 0.25
    # Resamples of the bootstrap of windows.
    resamples: int = 1000
    # A rival is told apart if resampling prefers the named effect at least this often and it
    # costs this much more.
    preference: float = 0.975
    distance: float = 0.01
    # Effects that explain less than this share of the misfit are no explanation.
    explanation_share: float = 0.5
    # An effect whose smallest trial moves whitened errors less than this was not excited.
    detectable: float = 8.0

    # From this share of the gap on, what is named is the model's improvement; below, a remainder is
    # learned as well.
    well_explained: float = 0.8
    # An improved model errs by less than this share of the model as it was, where held out.
    improvement: float = 0.97

    # Balances of torque and oil.
    # Time between samples [s], knots of the splines, and their relative ridge.
    balance_stride: float = 0.01
    balance_knots: int = 7
    balance_ridge: float = 1e-3

    # Proposed experiment.
    # Duration [s], amplitudes as shares of the present range, tones of the multisine [Hz].
    experiment_duration: float = 1.0
    experiment_amplitudes: tuple[float, ...] = (0.3, 1.0)
    experiment_tones: tuple[float, ...] = (0.7, 1.9, 4.3, 8.9)


DEFAULT = Thresholds()
