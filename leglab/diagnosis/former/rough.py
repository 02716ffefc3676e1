"""The search on machines that differ from their model everywhere a little.

Sensor noise alone would call every explanation of such a machine wrong. So the discrepancy of the
model is estimated about the best explanation so far, and estimated anew when that gets better,
until both stay (Kennedy and O'Hagan 2001, with the variance annealed). All other strengths follow
each fit a little; where healthy recordings said what this specimen is like, by what changes from
one day to the next.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.former.directions import differing
from leglab.diagnosis.former.discrepancy import Discrepancy
from leglab.diagnosis.former.fitting import Fit, refit
from leglab.diagnosis.former.judging import (
    accepted,
    fault_probability,
    may_be_fault,
    no_worse,
    probabilities,
    simplest_first,
)
from leglab.diagnosis.former.nuisances import rough_nuisances, within_tolerance
from leglab.diagnosis.former.screening import pairs
from leglab.diagnosis.former.search import (
    Contender,
    Progress,
    Round,
    as_contender,
    as_pair,
    fitted_pairs,
    search_round,
    sharpen,
    thinned,
    total_cost,
)
from leglab.diagnosis.replay.residual import Problem, whitened


def settled_baseline(
    problem: Problem,
    chosen: np.ndarray,
    floor: Discrepancy | None = None,
    *,
    sharpenings: int = 0,
) -> tuple[Problem, Fit]:
    """Nuisances and discrepancy of the model, fitted in turn until they stay.

    Args:
        problem: Recordings and machine.
        chosen: Windows to fit, (windows,).
        floor: Least discrepancy.
        sharpenings: Further rounds, at most, with differences so fine that bent dependencies (the
            shape of metering edges, of friction) are followed to their minimum.

    Returns:
        The problem under that discrepancy, and the fit.
    """
    limits = problem.thresholds
    hypothesis, level = Hypothesis(), np.inf
    sharp = limits.fine_differences
    for share, fine, rounds in ((0.5, 1.0, limits.annealings), (sharp, sharp, sharpenings)):
        for _ in range(rounds):
            problem = problem.trusting(problem.discrepancy(hypothesis).at_least(floor))
            at = problem.linearise(hypothesis, chosen, share=share)
            fit = refit(problem, at, frozenset(), iterations=3, fine=fine)
            hypothesis = fit.hypothesis
            now = float(np.median(problem.noise_levels(hypothesis)))
            settled = now > limits.annealed * level
            level = now
            if settled:
                break
    return problem, fit


def rough_search(
    problem: Problem,
    rounds: int,
    rng: np.random.Generator,
    progress: Progress,
    *,
    floor: Discrepancy | None = None,
    calibrated: bool = False,
) -> tuple[Problem, Fit, Fit, list[Key], list[Round]]:
    """Finds the effects that a rough machine shows, one a round.

    Args:
        problem: Recordings and machine.
        rounds: How many effects may be named.
        rng: For the null.
        progress: Called with what is being done.
        floor: Discrepancy that healthy recordings of this specimen show.
        calibrated: Whether `problem` is about the values of this specimen.

    Returns:
        The problem under the last discrepancy, the fit without any effect, that with all, the
        effects in the order of discovery, and all rounds.
    """
    limits = problem.thresholds
    every = max(1, round(problem.fitted.sum() / limits.screened_windows))
    chosen = thinned(problem.fitted, every)
    progress("how far the model is to be trusted")
    if calibrated:
        # What healthy recordings leave open is little, and takes no fault away.
        nuisances = within_tolerance(problem.library, limits.drift_share)
        problem = problem.with_nuisances(nuisances, worth=limits.calibrated_numbers)
    else:
        nuisances = rough_nuisances(
            problem.library, limits.rough_share, limits.rough_imperfect, limits.rough_tolerance
        )
        problem = problem.with_nuisances(nuisances, worth=limits.rough_numbers)
    problem, current = settled_baseline(problem, chosen, floor)
    settled, baseline = problem, current
    named: list[Key] = []
    found: list[Round] = []
    while len(named) < rounds:
        if floor is not None and cost_under(problem, current, floor) <= limits.as_healthy:
            break
        trusted = problem.discrepancy(current.hypothesis).at_least(floor)
        # What a fault opens is no error of the model, and would hide the fault if it were taken for
        # one. With nothing found, most of what is open is the fault's.
        first, left = not named, limits.calibrated_left if calibrated else limits.rough_left
        hoped = trusted.scaled(left, forces=True).at_least(floor)
        problem = problem.trusting(hoped if first else trusted)
        # Strengths that a missing effect has pulled along would mislead the screening: drift of a
        # calibrated machine can take a size past the trials of the effect that is missing. Where
        # much follows, it must be off for the others to be seen: screened both ways.
        start, beside = current.hypothesis.only(named), None
        if not calibrated:
            start, beside = current.hypothesis, start
        screened = problem
        problem, tried = search_round(problem, start, current, rng, progress, beside=beside)
        winner = None
        if tried.contenders:
            progress("how far the model with the effect is to be trusted")
            problem, tried = annealed(problem, current, tried, floor)
            winner = next((c for c in tried.contenders if accepted(problem, tried, c)), None)
        elif first:
            problem = problem.trusting(trusted)
            tried = replace(tried, base=total_cost(problem, current))
        found.append(tried)
        if not named:
            together = paired(problem, settled, screened, current, tried, progress)
            if together:
                found.append(replace(tried, contenders=together))
                winner = together[0]
                named = sorted(winner.fit.free - {winner.key})
        if winner is None:
            break
        named.append(winner.key)
        current = winner.fit
        if _only_made_so(problem, tried, named, current, calibrated=calibrated):
            break
    return problem, baseline, current, named, found


def _only_made_so(
    problem: Problem, tried: Round, named: Sequence[Key], fit: Fit, *, calibrated: bool
) -> bool:
    """Whether a round found only how this machine is made, and no cause is near.

    Such a machine has a little of everything. Each of it takes a round, and then must be challenged
    with all the others. While no cause is named, what explains too little for a name may be one;
    but not what explains less than several of these.
    """
    known = any(_is_fault(problem, key, fit, calibrated=calibrated) for key in named)
    if not known and len(named) >= problem.thresholds.fruitless:
        return True
    near = [c for c in tried.contenders if _is_fault(problem, c.key, c.fit, calibrated=calibrated)]
    return not any(accepted(problem, tried, c) for c in near) if known else not near


def _is_fault(problem: Problem, key: Key, fit: Fit, *, calibrated: bool) -> bool:
    """Whether an effect is more probably a fault, as it is fitted, than how the machine is made."""
    share = fault_probability(problem, key, fit.hypothesis, calibrated=calibrated)
    return share >= problem.thresholds.fault


def paired(
    problem: Problem,
    settled: Problem,
    screened: Problem,
    base: Fit,
    tried: Round,
    progress: Progress,
) -> tuple[Contender, ...]:
    """Two effects at once, where they are more probable than any single one.

    A single effect may be an impostor that stands in for both. That a second one of all effects
    is there as well is as much less probable as there are effects.

    Args:
        problem: As the round left it.
        settled: As `base` was fitted.
        screened: As the round began.
        base: The fit without any effect.
        tried: The round.
        progress: Called with what is being done.

    Returns:
        The pair, by the one that matters less and by the other; then pairs with a rival of either,
        by that rival. Empty where no pair is the more probable.
    """
    chosen = base.at.chosen
    at = problem.rewhitened(base.at, settled)
    at = replace(at, residual=problem.residual(at.base, chosen))
    turn = problem.turn_from(screened, chosen)
    candidates = [
        replace(c, step=whitened(turn, c.step)) for c in tried.candidates if c.detectable > 0.0
    ]
    ranked = pairs(problem, at, candidates)
    fits = fitted_pairs(problem, at, ranked, progress)
    if not fits:
        return ()
    pair = as_pair(problem, sharpen(problem, min(fits, key=lambda f: f.cost)))
    nothing = as_contender(problem, pair.key, base)
    share = probabilities(problem, (pair, nothing, *tried.contenders))
    if share[0] <= len(tried.candidates) * (1.0 - share[0]):
        return ()
    found = [pair, *(replace(pair, key=key) for key in pair.fit.free - {pair.key})]
    for kept in sorted(pair.fit.free):
        rivals = [entry for entry in ranked if entry[1] & pair.fit.free == {kept}]
        for fit in fitted_pairs(problem, at, rivals, progress):
            (key,) = fit.free - {kept}
            found.append(as_contender(problem, key, fit))
    return tuple(found)


def suspected(
    problem: Problem,
    fit: Fit,
    named: Sequence[Key],
    tried: Round,
    progress: Progress,
    *,
    calibrated: bool,
) -> tuple[Round, Contender | None]:
    """The effect that comes nearest to a cause, where nothing that was found is one.

    Too little speaks for it to be named. But of a machine that errs, a user wants to know where to
    look first.

    Args:
        problem: As the search left it.
        fit: Its last fit.
        named: What that has.
        tried: The last round, which found nothing more.
        progress: Called with what is being done.
        calibrated: Whether `problem` is about the values of this specimen.

    Returns:
        The round with those fitted that may be a fault, most probable first; and of them the first
        that loses nothing where held out. None where something found is a cause, or nothing is
        near.
    """
    if any(_is_fault(problem, key, fit, calibrated=calibrated) for key in named):
        return tried, None
    chosen, free = fit.at.chosen, frozenset(named)
    start = fit.hypothesis
    known = {*free, *(c.key for c in tried.contenders)}
    near = [
        c
        for c in tried.candidates
        if c.key not in known
        and c.gain > 0.0
        and may_be_fault(problem, c.key, start.with_values(c.key, c.values))
    ]
    at = problem.linearise(start, chosen, free)
    contenders = list(tried.contenders)
    for candidate in near[: problem.thresholds.refitted]:
        progress(f"how near {candidate.key[0]} comes")
        begun = start.with_values(candidate.key, candidate.values)
        with_it = refit(problem, at, free | {candidate.key}, start=begun, iterations=4)
        contenders.append(as_contender(problem, candidate.key, sharpen(problem, with_it)))
    contenders = differing(problem, _most_probable_first(problem, contenders))
    ordered = simplest_first(problem, contenders)
    base = total_cost(problem, fit)
    tried = replace(tried, base=base, contenders=ordered)
    held = problem.held if problem.held.sum() > 3 else np.ones_like(problem.held)
    for one in ordered:
        fault = _is_fault(problem, one.key, one.fit, calibrated=calibrated)
        if fault and no_worse((base - one.cost)[held]):
            return tried, one
    return tried, None


def cost_under(problem: Problem, fit: Fit, discrepancy: Discrepancy | None) -> float:
    """Mean cost of a fit under another discrepancy of the model; about 1 if that is its own."""
    return float(problem.trusting(discrepancy).window_cost(fit.hypothesis).mean())


def annealed(
    problem: Problem, base: Fit, tried: Round, floor: Discrepancy | None
) -> tuple[Problem, Round]:
    """The contenders of a round under the discrepancy that the best of them leaves.

    Those whose directions should differ and do not are left out; if the best is one, the others are
    judged by what the next one leaves.
    """
    contenders, leader = list(tried.contenders), None
    while contenders and contenders[0] is not leader:
        problem, contenders = _settled(problem, contenders, floor)
        leader = contenders[0]
        contenders = differing(problem, contenders)
    ordered = simplest_first(problem, contenders)
    return problem, replace(tried, base=total_cost(problem, base), contenders=ordered)


def _settled(
    problem: Problem, contenders: list[Contender], floor: Discrepancy | None
) -> tuple[Problem, list[Contender]]:
    """Contenders, most probable first, and discrepancy of the best, fitted in turn until they stay.

    They come in the order in which they are to be taken at first.
    """
    limits = problem.thresholds
    level, leader = np.inf, None
    for _ in range(limits.annealings):
        best = contenders[0]
        now = float(np.median(problem.noise_levels(best.fit.hypothesis)))
        if best.key == leader and now > limits.annealed * level:
            break
        leader, level = best.key, now
        before = problem
        trusted = problem.discrepancy(best.fit.hypothesis)
        problem = problem.trusting(trusted.at_least(floor))
        contenders = [_under(problem, before, c) for c in contenders]
        contenders = _most_probable_first(problem, contenders)
    return problem, contenders


def _most_probable_first(problem: Problem, contenders: Sequence[Contender]) -> list[Contender]:
    if not contenders:
        return []
    places = np.argsort(-probabilities(problem, contenders), kind="stable")
    return [contenders[i] for i in places.tolist()]


def _under(problem: Problem, before: Problem, contender: Contender) -> Contender:
    """A contender that was fitted under another discrepancy."""
    fit = contender.fit
    at = problem.rewhitened(fit.at, before)
    fine = problem.thresholds.fine_differences
    fit = refit(problem, at, fit.free, start=fit.hypothesis, iterations=3, fine=fine)
    return as_contender(problem, contender.key, fit)
