"""The search: a linearisation, a beam over sets, fits by replays, all sets under each other."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from leglab.diagnosis import thresholds
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.likelihood.columns import Columns, Errors, trials
from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.likelihood.priors import Priors
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.likelihood.twins import own_forces, scale_twins
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.replay.residual import Problem, lessens, thinned
from leglab.diagnosis.search.beam import beam, without_idle
from leglab.diagnosis.search.rank import Compared, Ranked, next_candidate, rank
from leglab.diagnosis.search.regression import Balanced, balanced_sets
from leglab.diagnosis.search.settle import Candidate, Fit, Fitter
from leglab.diagnosis.thresholds import DEFAULT


@dataclass(frozen=True, eq=False)
class Found:
    """All fitted sets, best first."""

    fitter: Fitter  #: With which they were fitted
    ranks: tuple[Ranked, ...]  #: The sets
    first: Columns  #: Linearisation of the model as it is, with all trials
    level: float  #: Of the model as it is
    onsets: np.ndarray | None = None  #: As `search` was given them


@dataclass(frozen=True, eq=False)
class Within:
    """A fit of recordings within what machines differ by."""

    fitter: Fitter  #: With which they were fitted
    first: Columns  #: Linearisation of the model as it is, without jumps
    fit: Fit  #: The fit of no set


def windows_of(u: Unknowns) -> int:
    """Number of windows to replay; fewer with many unknowns, each of which replays them all."""
    most = thresholds.WINDOWS
    return max(most // 2, min(most, most * thresholds.MANY_UNKNOWNS // len(u)))


def search(
    problem: Problem,
    priors: Priors | None = None,
    fixed: Spread | None = None,
    kappa: float = thresholds.KAPPA,
    onsets: np.ndarray | None = None,
    log: Callable[[str], None] = lambda _: None,
    within: Within | None = None,
) -> Found:
    """Finds and fits the sets of effects that explain recordings.

    Args:
        problem: Recordings and machine about the specimen.
        priors: Of everything but the errors; None for a machine without healthy recordings.
        fixed: Pattern of the model's own error by healthy recordings; None without.
        kappa: 1/design effect at first.
        onsets: Time at which what is missing begins [s], (recordings,); None for throughout.
        log: Called with what is being done.
        within: A fit of no set, where any good description of the recordings will do: no rival of
            one is sought. None for all sets that can be the cause.
    """
    u = Unknowns.of(problem.library)
    looked_at = problem.fitted
    if onsets is not None:
        looked_at = looked_at & (problem.replay.start > onsets[problem.replay.recording])
    if within:
        fitter, at, u = within.fitter, within.fitter.at, within.fitter.at.unknowns
    else:
        at = Errors(problem, u, thinned(looked_at, windows_of(u)))
        fitter = Fitter(at, priors or Priors(), fixed)
    log(f"tangents and trials of {len(u)} unknowns")
    errors = within.first.errors if within else at.at(Hypothesis())
    as_it_is, clear = fitter.level(errors), fitter.clear(errors)
    # Where noise alone is left no large fault hides, for that would show: first order is exact.
    first = within.first if within else at.columns(thresholds.FINE if clear else thresholds.COARSE)
    first = at.jumped(replace(first, fine=clear), trials(u), near=clear)
    fits: list[Fit] = []
    if clear:
        as_built = Candidate((), {}, first, *fitter.about(first.errors))
        fits.append(fitter.fit(as_built, kappa, renewals=0))
    evidence, ranked, kappa = _annealed(fitter, fits[0].columns if clear else first, kappa)
    wanted = {u.names(one.members): one for one in _wanted(evidence, ranked)}

    def begins(one: Candidate) -> float:
        return fitter.level(at.at(u.moved(one.columns.base, one.start)))

    log("balance of forces")
    for seed in [] if clear else _seeds(evidence, balanced_sets(at, trials(u))):
        names = u.names(seed.members)
        if any(pair <= names for pair in at.twins):
            continue
        if names not in wanted:
            # A balance of what the machine does not do promises what no replay holds; one that
            # leaves little more than noise is a rival whatever else explains.
            level = begins(seed)
            if level < thresholds.HOPELESS * as_it_is:
                near_noise = level < thresholds.HOPELESS * DEFAULT.explained
                wanted[names] = replace(seed, promise=np.inf) if near_noise else seed
        elif begins(seed) < begins(wanted[names]):
            # A set that both propose begins where a replay is nearer.
            wanted[names] = replace(seed, promise=wanted[names].promise)

    def run(new: Candidate, *, beside: bool = False, renewals: int = 0) -> Fit:
        most = thresholds.HOPELESS * min((f.level for f in fits), default=np.inf)
        fit = fitter.fit(new, kappa, give_up=most, beside=beside, renewals=renewals)
        log(f"fitted {told(u, fit.score)}: {fit.level:.3g} noise levels")
        fits.append(fit)
        return fit

    nothing = _of(evidence, evidence.score(()))
    worth = ranked[0].log - nothing.promise
    tried: set[frozenset[int]] = {frozenset()}
    # Beside what explains everything only what promises nearly as much is a rival, or is simpler:
    # far from the base first order errs. Near noise it is exact, and a rival promises more.
    room = thresholds.NEAR + DEFAULT.smaller_share * worth
    least = nothing.promise if clear else -np.inf
    fewest = 0 if clear else len(u)
    for new in wanted.values():
        if new.promise < least and len(new.members) >= fewest:
            continue
        tried.add(frozenset(new.members))
        if run(new, beside=clear).level <= DEFAULT.explained:
            least = max(least, new.promise - room)
            fewest = min(fewest, len(new.members))
    if within:
        fits.append(within.fit)
    elif not clear:
        run(nothing)
    vain, more, last = 0, 0, frozenset[Key]()
    again, ended = set[tuple[frozenset[Key], frozenset[Key]]](), set[Fit]()
    without = cache(lambda fit, key: at.without(fit.columns, fit.members, key))
    # A tangent shows a limit only where commands or forces come near it.
    forces, limits = own_forces(problem, u), [jump for jump in trials(u) if u.limits[jump[0]]]
    limited = cache(lambda fit: at.jumped(fit.columns, limits))
    simpler = set[tuple[Fit, Key]]()
    compared, erring = Compared(fitter), fits[0]
    unexplained = fitter.rms(errors)

    def needed(fit: Fit, there: Evidence | None = None) -> bool:
        """Whether no other fitted set does as well there, or at its own fit, with fewer members."""
        there = there or compared.evidence(fit, fit.spread, fit, kappa)
        less = without_idle(there, there.score([(q, None) for q in fit.members]), 0.0)
        names = u.names(less.unknowns)
        return names == fit.keys or all(names != f.keys for f in fits)

    def left(fit: Fit) -> float:
        return fitter.rms(fit.columns.errors)

    while True:
        ranks = rank(compared, fits, kappa)
        least_left = min(ranks, key=lambda r: r.fit.level)
        if least_left.fit is not erring:
            erring = least_left.fit
            kappa = 1.0 / max(least_left.evidence.design_effect(least_left.score), 1.0)
            ranks = rank(compared, fits, kappa)
        # Near noise first order is exact: what is behind nothing stays there. What is before it but
        # hardly lessens the errors is not told.
        if clear and not (ranks[0].fit.members and lessens(unexplained, min(map(left, fits)))):
            break
        # What may lead is fitted to its end; what is more probable where another set was fitted
        # also from there.
        top = ranks[0].score.log
        behind = 0.0 if within else thresholds.BEHIND * thresholds.NEAR
        if within and fitter.explains(ranks[0].fit):
            break
        if not within and not fitter.explains(least_left.fit):
            behind += DEFAULT.smaller_share * (
                top - next(r.score.log for r in ranks if not r.fit.members)
            )
        # So may a set no larger than the best one that leaves noise alone already.
        small, noise = len(ranks[0].fit.members), DEFAULT.explained
        near = [
            r
            for r in ranks
            if r.score.log + r.fit.gained >= top - behind
            or (not within and r.fit.level <= noise and len(r.fit.members) <= small)
        ]
        most = thresholds.HOPELESS * least_left.fit.level
        open_ = (r.fit for r in near if not r.fit.finished and r.fit.level < most)
        begun = next((f for f in open_ if f not in ended and needed(f)), None)
        if begun is not None:
            # From where it is, or from where what leaves least is: whichever leaves less.
            where = [begun, *([least_left.fit] if least_left.fit.finished else [])]
            starts = (_from(fitter, begun, point, kappa) for point in where)
            ended.add(run(min(starts, key=begins), beside=True, renewals=thresholds.RENEWALS))
            fits.remove(begun)
            continue
        points = {id(f.columns): f for f in fits}
        moved = (
            (r.fit, point)
            for r in near
            for point in [points[id(r.evidence.columns)]]
            if r.gain > thresholds.NEAR
            and (r.fit.keys, point.keys) not in again
            and needed(r.fit, r.evidence)
        )
        late, point = next(moved, (None, None))
        if late is not None and point is not None:
            again.add((late.keys, point.keys))
            there = Candidate(late.members, {}, point.columns, point.spread, point.weight)
            run(there, beside=True, renewals=thresholds.RENEWALS)
            continue
        # A set that moves alike in any recording is a rival of every good set.
        twins = (
            Candidate(names, moves, r.fit.columns, r.fit.spread, r.fit.weight)
            for r in ([] if within else near)
            for names, moves in scale_twins(problem, u, forces, r.fit.members, r.fit.columns.x)
            if frozenset(names) not in tried
        )
        if twin := next(twins, None):
            tried.add(frozenset(twin.members))
            run(twin, beside=True, renewals=thresholds.RENEWALS)
            continue
        # What was proposed last is a rival now, or was in vain.
        vain = (
            0
            if last in {r.fit.keys for r in near if r.score.log > top - thresholds.NEAR}
            else vain + 1
        )
        done = vain > thresholds.FRUITLESS or more >= thresholds.FURTHER_FITS
        # A description that hardly promises to be more probable is none the better.
        ahead = thresholds.NEAR if within else -thresholds.NEAR
        then = None if done else next_candidate(fitter, ranks, tried, without, limited, ahead)
        if then is None and within:
            break
        if then is None:
            best = ranks[0].fit
            # What does without an effect of the best set is fitted from there.
            out = next((k for k in sorted(best.keys) if (best, k) not in simpler), None)
            if out is None or len(best.keys) < 2:
                break
            simpler.add((best, out))
            if (columns := without(best, out)) is not None:
                rest = tuple(q for q in best.members if u.keys[q] != out)
                run(Candidate(rest, {}, columns, best.spread, best.weight), beside=True)
            continue
        more += 1
        last = u.names(then.members)
        tried.add(frozenset(then.members))
        run(then)
    return Found(fitter, tuple(ranks), first, as_it_is, onsets)


def _annealed(fitter: Fitter, first: Columns, kappa: float) -> tuple[Evidence, list[Score], float]:
    """Sets by the first linearisation, with the pattern of errors that the best of them leaves."""
    spread, weight = fitter.about(first.errors)
    last = None
    for _ in range(thresholds.ANNEALINGS):
        evidence = fitter.evidence(first, spread, weight, kappa)
        ranked = beam(evidence)
        best = ranked[0]
        left = evidence.left(best)
        spread = fitter.own_spread(left)
        weight = fitter.weights(left, spread, best.size)
        kappa = 1.0 / max(evidence.design_effect(best), 1.0)
        now = frozenset(best.unknowns), round(float(np.log(kappa)), 1)
        if now == last:
            break
        last = now
    return evidence, ranked, kappa


def _wanted(evidence: Evidence, ranked: Sequence[Score]) -> list[Candidate]:
    """Sets to fit by the first linearisation, the most promising first."""
    u = evidence.unknowns
    picked: dict[frozenset[Key], Score] = {}

    nothing = next(s for s in ranked if not s.members)
    idle = thresholds.IDLE[0] + thresholds.IDLE[1] * max(ranked[0].log - nothing.log, 0.0)
    for score in ranked:
        score = without_idle(evidence, score, idle)
        near = len(picked) < thresholds.FIRST_FITS and score.log > ranked[0].log - thresholds.NEAR
        if len(picked) < thresholds.SURE_FITS or near:
            picked.setdefault(u.names(score.unknowns), score)
    for score in [s for s in ranked if len(s.members) == 1][: thresholds.SURE_FITS]:
        picked.setdefault(u.names(score.unknowns), score)
    # What leads where the model is exact: its own error, as estimated while something is missing,
    # has that one's shape and hides it.
    widest = int(evidence.priors.usual().sum()) - 1
    shift = evidence.whole.follow(0, widest, np.eye(1, evidence.gram.shape[1])[0])
    exact = replace(evidence.score(()), size=evidence.places[0], spread=widest, shift=shift)
    for _, member in evidence.additions(exact)[: thresholds.EACH_WAY]:
        score = evidence.score((member,))
        picked.setdefault(u.names(score.unknowns), score)
    return [_of(evidence, score) for names, score in picked.items() if names]


def _of(evidence: Evidence, score: Score) -> Candidate:
    """A set to fit from the first linearisation."""
    return Candidate(
        score.unknowns,
        evidence.departures(score),
        evidence.columns,
        evidence.spread,
        evidence.weight,
        score.log,
    )


def _seeds(evidence: Evidence, found: dict[str, list[Balanced]]) -> list[Candidate]:
    """Sets to fit by the balances of forces: each joint's best, and all joints' together."""
    seeds: dict[frozenset[int], dict[int, float]] = {}
    joined: dict[int, dict[int, float]] = {}
    for sets in found.values():
        gaining = [one for one in sets if one.gain > 0.0]
        if len(found) == 1:
            seeds |= {frozenset(one.start): one.start for one in gaining}
        for count in {len(one.start) for one in gaining}:
            best = next(one for one in gaining if len(one.start) <= count)
            joined.setdefault(count, {}).update(best.start)
    for start in joined.values():
        if len(start) <= thresholds.LARGEST_SET:
            seeds.setdefault(frozenset(start), start)
    columns, spread, weight = evidence.columns, evidence.spread, evidence.weight
    return [
        Candidate(tuple(start), start, columns, spread, weight, -np.inf) for start in seeds.values()
    ]


def _from(fitter: Fitter, fit: Fit, point: Fit, kappa: float) -> Candidate:
    """A fitted set once more, from where the tangents at another one's point have it."""
    start: dict[int, float] = {}
    if fit is not point:
        evidence = fitter.evidence(point.columns, point.spread, point.weight, kappa)
        start = evidence.departures(evidence.score([(q, None) for q in fit.members]))
    return Candidate(fit.members, start, point.columns, point.spread, point.weight)


def told(u: Unknowns, score: Score) -> str:
    """A set in a few words."""
    members = zip(score.unknowns, score.values, strict=True)
    return " + ".join(f"{u.keys[q][0]} {v:.3g}" for q, v in members) or "nothing"
