"""The search: a linearisation, a beam over sets, fits by replays, all sets under each other."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import process_time

import numpy as np

from leglab.diagnosis.balance.regression import Balanced, balanced_sets
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.likelihood.columns import COARSE, Columns, Errors, trials
from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.likelihood.priors import Priors
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.replay.residual import Problem, thinned
from leglab.diagnosis.search.beam import beam, without_idle
from leglab.diagnosis.search.settle import EXPLAINED, KAPPA, Fit, Fitter

# Windows that are replayed.
WINDOWS = 32
# A set within so many nats of the best one is fitted.
NEAR = 10.0
# Sets that are fitted from the first linearisation, and singles among them.
FIRST, SINGLES = 6, 4
# Share of all that is to be gained by which first promises of equal sets differ.
AS_GOOD = 0.1
# Sets that are fitted from a second start.
LEADING = 3
# Further sets that are fitted; fewer where so many in a row change nothing.
MORE, FRUITLESS = 10, 2
# Times the level of the best set at which another one is given up.
HOPELESS = 10.0


@dataclass(frozen=True, eq=False)
class Found:
    """All fitted sets, best first, under one pattern of the model's own error.

    Attributes:
        fitter: With which they were fitted.
        fits: The sets where they were fitted.
        evidence: Of each set where it is most probable: its own linearisation or another's.
        scores: Likewise.
        kappa: 1/design effect.
        first: Linearisation of the model as it is, with all trials.
        level: Of the model as it is.
    """

    fitter: Fitter
    fits: tuple[Fit, ...]
    evidence: tuple[Evidence, ...]
    scores: tuple[Score, ...]
    kappa: float
    first: Columns
    level: float


def search(
    problem: Problem,
    priors: Priors | None = None,
    fixed: Spread | None = None,
    kappa: float = KAPPA,
    onsets: np.ndarray | None = None,
    log: Callable[[str], None] = lambda _: None,
) -> Found:
    """Finds and fits the sets of effects that explain recordings."""
    began = process_time()
    priors = priors or Priors()
    unknowns = Unknowns.of(problem.library)
    looked_at = problem.fitted
    if onsets is not None:
        looked_at = looked_at & (problem.replay.start > onsets[problem.replay.recording])
    at = Errors(problem, unknowns, thinned(looked_at, WINDOWS))
    fitter = Fitter(at, priors, fixed)
    first = at.jumped(at.columns(Hypothesis(), step=COARSE), trials(unknowns))
    level = fitter.level(first.errors)
    log(
        f"{len(unknowns)} unknowns ({unknowns.single} single), {len(first.jumps)} jumps, level {level:.4g}, cpu {process_time() - began:.0f}"
    )
    spread, weight = fitter.own_spread(first.errors), np.ones(len(first.errors))
    last = None
    for _ in range(4):
        evidence = fitter.evidence(first, spread, weight, kappa)
        ranked = beam(evidence)
        best = ranked[0]
        left = evidence.left(best)
        spread = fitter.own_spread(left)
        weight = fitter.weights(left, spread, best.size)
        kappa = 1.0 / max(evidence.design_effect(best), 1.0)
        log(
            f"  beam {label(unknowns, best)} log {best.log:.1f} size {priors.sizes[best.size]} kappa {kappa:.3f} cpu {process_time() - began:.0f}"
        )
        now = frozenset(best.unknowns), round(float(np.log(kappa)), 1)
        if now == last:
            break
        last = now
    for s in ranked[:8]:
        log(f"    {s.log:9.1f} {label(unknowns, s)}")
    nothing = next(s for s in ranked if not s.members)
    picked: dict[frozenset[Key], Score] = {}

    def keys(score: Score) -> frozenset[Key]:
        return frozenset(unknowns.keys[q] for q in score.unknowns)

    worth = max(ranked[0].log - nothing.log, 0.0)
    for s in ranked[:40]:
        s = without_idle(evidence, s, 3.0 + 0.03 * worth)
        if keys(s) in picked:
            continue
        if len(picked) < 3 or (len(picked) < FIRST and s.log > ranked[0].log - NEAR):
            picked[keys(s)] = s
    singles = sorted((s for s in ranked if len(s.members) == 1), key=lambda s: -s.log)
    for s in singles[:SINGLES]:
        picked.setdefault(keys(s), s)
    empty = evidence.score(())
    exact = replace_size(evidence, empty)
    for _, member in evidence.additions(exact)[:2]:
        s = evidence.score((member,))
        picked.setdefault(keys(s), s)
    fits: list[Fit] = []

    def run(
        columns: Columns, start: dict[int, float], members, spread, weight, beside=False
    ) -> Fit:
        lowest = min((f.level for f in fits), default=np.inf)
        fit = fitter.fit(
            columns, start, members, spread, weight, kappa, give_up=HOPELESS * lowest, beside=beside
        )
        log(
            f"    fitted {tell(unknowns, fit)} cpu {process_time() - began:.0f}{' again' if beside else ''}"
        )
        fits.append(fit)
        return fit

    tried: set[frozenset[Key]] = {frozenset()}
    wanted = [(evidence.departures(one), one.unknowns, one.log) for one in picked.values()]
    seeds = balance_seeds(balanced_sets(at, trials(unknowns)))
    wanted += [(start, tuple(start), -np.inf) for start in seeds]
    least = -np.inf
    for start, members, promise in wanted:
        names = frozenset(unknowns.keys[q] for q in members)
        if names in tried or promise < least:
            continue
        tried.add(names)
        fit = run(first, start, members, spread, weight)
        # Beside what explains everything only what promises nearly as much is a rival.
        if fit.level <= EXPLAINED:
            least = max(least, promise - NEAR - AS_GOOD * worth)
    run(
        first,
        evidence.departures(nothing) if nothing.log > ranked[0].log - 300 else {},
        (),
        spread,
        weight,
    )
    vain, again = 0, set()
    for _ in range(MORE + 1):
        ranks = rank(fitter, fits, kappa)
        lowest = min(ranks, key=lambda r: r[0].level)
        before, kappa = kappa, 1.0 / max(lowest[1].design_effect(lowest[2]), 1.0)
        if abs(np.log(before / kappa)) > 0.1:
            ranks = rank(fitter, fits, kappa)
        log(
            f"  best {label(unknowns, ranks[0][2])} level {ranks[0][0].level:.4g} kappa {kappa:.3f}"
        )
        # The leading sets once more, from where the one that leaves least has the machine.
        point = lowest[0]
        for fit, _, score in ranks[:LEADING]:
            names = fit.keys(fitter), point.keys(fitter)
            if fit is not point and names not in again and fit.level > point.level:
                again.add(names)
                start = {
                    i: -float(point.columns.x[i])
                    for q in point.members
                    for i in unknowns.singles(q)
                }
                for q, value in zip(fit.members, fit.score.values, strict=True):
                    for i in unknowns.singles(q):
                        own = start.get(i, -float(point.columns.x[i]))
                        start[i] = own + float(value)
                run(point.columns, start, fit.members, point.spread, point.weight, beside=True)
                break
        else:
            if vain >= FRUITLESS:
                break
            new = proposal(fitter, ranks, tried)
            if new is None:
                break
            members, start, columns, spread, weight = new
            tried.add(frozenset(unknowns.keys[q] for q in members))
            known = {fit.keys(fitter): fit.level for fit, _, _ in ranks}
            fit = run(columns, start, members, spread, weight)
            # The same set once more, and not much better.
            vain = vain + 1 if fit.level > 0.95 * known.get(fit.keys(fitter), np.inf) else 0
    return Found(
        fitter,
        tuple(r[0] for r in ranks),
        tuple(r[1] for r in ranks),
        tuple(r[2] for r in ranks),
        kappa,
        first,
        level,
    )


def balance_seeds(found: dict[str, list[Balanced]]) -> list[dict[int, float]]:
    """Sets to fit by the balances of all joints: each joint's best, and all joints' together."""
    seeds: dict[frozenset[int], dict[int, float]] = {}
    joined: dict[int, dict[int, float]] = {}
    for sets in found.values():
        for one in sets:
            if one.gain <= 0.0:
                continue
            if len(found) == 1:
                seeds.setdefault(frozenset(one.start), one.start)
            joined.setdefault(len(one.start), {})
        for count in (1, 2, 3):
            best = next((b for b in sets if len(b.start) <= count and b.gain > 0.0), None)
            if best is not None and count in joined:
                joined[count].update(best.start)
    for start in joined.values():
        seeds.setdefault(frozenset(start), start)
    return list(seeds.values())


def replace_size(evidence: Evidence, score: Score) -> Score:
    """The score at the exact end of the sizes, where the model's own error hides nothing."""
    k = 0
    o = len(evidence.priors.spreads) - 1
    shift = evidence.whole.follow[k, o][:, 0].copy()
    return replace(score, size=evidence.places[k], spread=o, shift=shift)


def rank(fitter: Fitter, fits: list[Fit], kappa: float):
    """Sets by evidence, best first.

    The pattern of the model's own error is not known either: each set counts with the one that
    makes it most probable, of its own and those of the sets that leave least; and at the point, its
    own or another's, where it does best: a larger set is never worse than one that it holds.
    """
    near = sorted(fits, key=lambda f: f.level)[:3]
    weight = near[0].weight
    rows = []
    kept: dict[tuple[int, int], Evidence] = {}

    def evidence(fit: Fit, spread: Spread) -> Evidence:
        key = id(fit), id(spread)
        if key not in kept:
            kept[key] = fitter.evidence(fit.columns, spread, weight, kappa)
        return kept[key]

    for fit in fits:
        spreads = (
            [fitter.fixed]
            if fitter.fixed
            else [fit.spread, *(f.spread for f in near if f is not fit)]
        )
        points = [fit] + [
            f
            for f in near
            if f is not fit
            and f.level <= fit.level
            and all(np.abs(f.columns.tangents[:, :, q]).max() > 0 for q in fit.members)
        ]
        members = [(q, None) for q in fit.members]
        tries = []
        for point in points:
            for spread in spreads if point is fit else [fitter.fixed or point.spread]:
                there = evidence(point, spread)
                tries.append((fit, there, there.score(members)))
        rows.append(max(tries, key=lambda r: r[2].log))
    best: dict[frozenset[Key], tuple] = {}
    for row in sorted(rows, key=lambda r: -r[2].log):
        best.setdefault(row[0].keys(fitter), row)
    return list(best.values())


def proposal(fitter: Fitter, ranks, tried: set[frozenset[Key]]):
    """The most promising set that was not fitted: an addition, or a swap, within some nats."""
    u = fitter.at.unknowns
    top = ranks[0][2].log
    best = None
    sound = [r for r in ranks if not r[0].ended] or ranks
    # Each member of the best set is left out once, whatever first order promises.
    fit, _, _ = sound[0]
    for one in fit.members if len(fit.members) > 1 else ():
        rest = tuple(q for q in fit.members if q != one)
        names = frozenset(u.keys[q] for q in rest)
        if names not in tried and len(names) < len(fit.keys(fitter)):
            there = fitter.evidence(fit.columns, fit.spread, fit.weight, ranks[0][1].kappa)
            start = there.departures(there.score([(q, None) for q in rest]))
            return rest, start, fit.columns, fit.spread, fit.weight

    def consider(gain, members, fit, evidence, score):
        nonlocal best
        names = frozenset(u.keys[q] for q in members)
        if names in tried or gain < top - NEAR or len(members) > 7:
            return
        if best is None or gain > best[0]:
            best = gain, members, fit, evidence, score

    for fit, _, _ in sound[:6]:
        evidence = (
            next(r[1] for r in ranks if r[1].columns is fit.columns)
            if any(r[1].columns is fit.columns for r in ranks)
            else fitter.evidence(fit.columns, fit.spread, fit.weight, ranks[0][1].kappa)
        )
        score = evidence.score([(q, None) for q in fit.members])
        if score.log < top - 3.0 * NEAR:
            continue
        for gain, member in evidence.additions(score)[:6]:
            if gain > 0.0:
                consider(score.log + gain, (*fit.members, member[0]), fit, evidence, score)
        if fit is sound[0][0]:
            for one in fit.members:
                rest = evidence.score([(q, None) for q in fit.members if q != one])
                consider(rest.log, tuple(q for q in fit.members if q != one), fit, evidence, rest)
                for gain, member in evidence.additions(rest)[:4]:
                    if member[0] != one:
                        members = (*(q for q in fit.members if q != one), member[0])
                        consider(rest.log + gain, members, fit, evidence, rest)
    for fit, _, score in sound[:6]:
        simpler = simplified(u, fit)
        if simpler is not None and frozenset(u.keys[q] for q in simpler) not in tried:
            by = {q: v - float(fit.columns.x[q]) for q, v in simpler.items()}
            gone = {q: -float(fit.columns.x[q]) for q in fit.members if q not in simpler}
            return (
                tuple(q for q, v in simpler.items() if v),
                {**gone, **by},
                fit.columns,
                fit.spread,
                fit.weight,
            )
    if best is None:
        return None
    _, members, fit, evidence, _ = best
    score = evidence.score([(q, None) for q in members])
    return members, evidence.departures(score), fit.columns, fit.spread, fit.weight


def simplified(u: Unknowns, fit: Fit) -> dict[int, float] | None:
    """The set with an effect by direction replaced by the same one in both directions.

    Returns:
        Departures of its members; None where the set has no such effect.
    """
    x, sites = fit.columns.x, u.library.sites
    for q in fit.members:
        key = u.places[q][0][0]
        effect = sites[key].effect
        for pair in effect.by_direction:
            both = [i for i in fit.members if u.places[i][0][0] == key and u.name(i) in pair]
            if len(both) < 2 or q not in both:
                continue
            unit = sites[key].parameters[u.places[q][0][1]].unit
            mean = float(np.mean([x[i] * u.scale[i] for i in both]))
            for i in range(u.single):
                other, place = u.places[i][0]
                p = sites[other].parameters[place]
                if (
                    other != key
                    and u.library.contains(key, other)
                    and p.unit == unit
                    and u.nameable[i]
                ):
                    kept = {m: float(x[m]) for m in fit.members if m not in both}
                    return {**kept, i: mean / u.scale[i]}
    return None


def label(u: Unknowns, score: Score) -> str:
    """A set in a few words."""
    return (
        " + ".join(
            f"{u.keys[q][0]}@{u.keys[q][1]}.{u.name(q)} {v:.2f}"
            for q, v in zip(score.unknowns, score.values, strict=True)
        )
        or "nothing"
    )


def tell(u: Unknowns, fit: Fit) -> str:
    """A fit in a few words."""
    return f"{label(u, fit.score)} log {fit.score.log:.1f} level {fit.level:.4g}" + (
        f" ENDED {fit.ended}" if fit.ended else ""
    )
