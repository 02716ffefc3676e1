"""The search: moves propose sets of effects, which are fitted by replays and ranked."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from leglab.diagnosis import thresholds
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.likelihood.columns import Columns, Errors, trials
from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.likelihood.priors import Priors
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.replay.residual import Problem, thinned
from leglab.diagnosis.search.moves import (
    another_point,
    balance,
    both_ways,
    finish,
    first_order,
    force_scale,
    neighbours,
    removal,
)
from leglab.diagnosis.search.pool import Aim, Found, Pool, Proposal, Scene, in_words
from leglab.diagnosis.search.rank import Compared
from leglab.diagnosis.search.regression import balanced_sets
from leglab.diagnosis.search.renewal import renewed, wanted
from leglab.diagnosis.search.settle import Candidate, Fit, Fitter
from leglab.diagnosis.thresholds import EXPLAINED, SMALL

#: Aim to find the causes of the misfit, with their rivals.
CAUSES = Aim(
    moves=(
        finish.propose,
        another_point.propose,
        force_scale.propose,
        both_ways.propose,
        neighbours.propose,
        removal.propose,
    ),
    rivals=True,
    ahead=-thresholds.NEAR,
)
#: Aim to find one good description of recordings; only sets that clearly improve it are fitted.
DESCRIPTION = Aim(
    moves=(finish.propose, another_point.propose, neighbours.propose),
    rivals=False,
    ahead=thresholds.NEAR,
)

Log = Callable[[str], None]


def windows_of(u: Unknowns) -> int:
    """Returns the number of windows to fit, smaller if many unknowns have to be replayed."""
    most = thresholds.WINDOWS
    return max(most // 2, min(most, most * thresholds.MANY_UNKNOWNS // len(u)))


def search(
    problem: Problem,
    priors: Priors | None = None,
    fixed: Spread | None = None,
    kappa: float = thresholds.KAPPA,
    onsets: np.ndarray | None = None,
    log: Log = lambda _: None,
) -> Found:
    """Finds and fits the sets of effects that can cause the misfit of recordings.

    Args:
        problem: Recordings, machine, and the library of effects on the specimen.
        priors: Priors of parameters and model error; None for the default, without healthy data.
        fixed: Covariance of the model error from healthy recordings; None without these.
        kappa: Initial factor on log likelihoods, 1/design effect.
        onsets: Times at which the missing effects begin [s], (recordings,); None for no onset.
        log: Called with what is being done.
    """
    u = Unknowns.of(problem.library)
    looked_at = problem.fitted
    if onsets is not None:
        looked_at = looked_at & (problem.replay.start > onsets[problem.replay.recording])
    at = Errors(problem, u, thinned(looked_at, windows_of(u)))
    fitter = Fitter(at, priors or Priors(), fixed)
    log(f"tangents and trials of {len(u)} unknowns")
    errors = at.at(Hypothesis())
    # If the unchanged model leaves only noise, no fault is large, and small steps are accurate.
    first = at.columns(thresholds.FINE if fitter.clear(errors) else thresholds.COARSE)
    return Found(_searched(fitter, first, CAUSES, kappa, log), fitter.level(errors), onsets)


def describe(fitter: Fitter, first: Columns, fit: Fit, kappa: float, log: Log) -> Pool:
    """Finds sets of effects that describe recordings, starting from the fit of the empty set.

    Args:
        fitter: Fits the sets.
        first: Linearisation of the unchanged model, without changes by finite steps.
        fit: The fit of the empty set.
        kappa: Initial factor on log likelihoods, 1/design effect.
        log: Called with what is being done.
    """
    return _searched(fitter, first, DESCRIPTION, kappa, log, fit)


def _searched(
    fitter: Fitter, first: Columns, aim: Aim, kappa: float, log: Log, nothing: Fit | None = None
) -> Pool:
    """Fits the proposals of all moves; `nothing` is the fit of the empty set, if already made."""
    at, clear = fitter.at, fitter.clear(first.errors)
    first = at.jumped(replace(first, fine=clear), trials(at.unknowns), near=clear)
    pool = Pool(Scene(fitter, aim, first, Compared(fitter)), kappa)
    begin = first
    if clear:
        as_built = Candidate((), {}, first, *fitter.about(first.errors))
        pool = pool.with_unchanged(fitter.fit(as_built, kappa, renewals=0))
        begin = pool.fits[0].columns
    evidence, ranked, kappa = first_order.annealed(fitter, begin, kappa)
    log("balance of forces")
    pool = _opened(replace(pool, kappa=kappa), evidence, ranked, log)
    if nothing is not None:
        pool = pool.with_unchanged(nothing)
    elif not clear:
        as_it_is = first_order.begun(evidence, evidence.score(()))
        pool = _fitted(pool, Proposal("first order", as_it_is, "the model as it is", False), log)
    pool = pool.ranked()
    while aim.rivals and not clear and wanted(pool):
        pool = _moved(renewed(pool), log)
    return _moved(pool, log)


def _moved(pool: Pool, log: Log) -> Pool:
    """Fits the proposals of the moves until none is left or the search has ended."""
    while not pool.ended:
        proposal = next((p for move in pool.scene.aim.moves for p in move(pool)), None)
        if proposal is None:
            break
        pool = _fitted(pool, proposal, log).ranked()
    return pool


def _fitted(pool: Pool, proposal: Proposal, log: Log) -> Pool:
    """Fits a proposal and adds it to the pool."""
    fit = pool.scene.fitter.fit(
        proposal.candidate,
        pool.kappa,
        give_up=pool.give_up,
        beside=proposal.beside,
        renewals=proposal.renewals,
    )
    log(f"fitted {in_words(fit.keys)}: {fit.level:.3g} noise levels")
    return pool.after(proposal, fit)


def _opened(pool: Pool, evidence: Evidence, ranked: Sequence[Score], log: Log) -> Pool:
    """Fits the sets that the first linearisation and the balance of forces propose.

    Once a set explains the recordings, other sets are fitted only if they are simpler or if their
    predicted evidence is lower by `room` at most, as predictions for large faults err much.
    """
    clear = pool.scene.clear
    nothing = evidence.score(()).log
    room = thresholds.NEAR + SMALL * (ranked[0].log - nothing)
    least, fewest = (nothing, 0) if clear else (-np.inf, len(evidence.unknowns))
    for proposal in _openings(pool, evidence, ranked):
        promise, count = proposal.candidate.promise, len(proposal.candidate.members)
        if promise < least and count >= fewest:
            continue
        pool = _fitted(pool, proposal, log)
        if pool.fits[-1].level <= EXPLAINED:
            least, fewest = max(least, promise - room), min(fewest, count)
    return pool


def _openings(pool: Pool, evidence: Evidence, ranked: Sequence[Score]) -> list[Proposal]:
    """Returns proposals by the first linearisation, then proposals by the balance of forces."""
    scene, u, nothing = pool.scene, evidence.unknowns, evidence.score(()).log
    at, level = scene.fitter.at, scene.fitter.level(scene.first.errors)
    wanted = {
        u.names(one.members): Proposal(
            "first order", one, _promise(one.promise - nothing), beside=scene.clear
        )
        for one in first_order.candidates(evidence, ranked)
    }
    reason = "the balance of forces suggests it"
    for seed in [] if scene.clear else balance.candidates(evidence, balanced_sets(at, trials(u))):
        names = u.names(seed.members)
        if any(pair <= names for pair in at.twins):
            continue
        begins, other = scene.begins(seed), wanted.get(names)
        if other is None:
            # The balance predicts no evidence, so a set that starts near noise is always fitted.
            if begins < thresholds.HOPELESS * level:
                near_noise = begins < thresholds.HOPELESS * EXPLAINED
                one = replace(seed, promise=np.inf) if near_noise else seed
                wanted[names] = Proposal("balance", one, reason, beside=scene.clear)
        elif begins < scene.begins(other.candidate):
            # If both sources propose a set, its fit starts where the error is smaller.
            one = replace(seed, promise=other.candidate.promise)
            wanted[names] = replace(other, candidate=one)
    return list(wanted.values())


def _promise(gain: float) -> str:
    return f"first order promises {gain:.0f} nats over no effect"
