"""What a search tried: what effects promise, and which sets were fitted and why."""

from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.result import Rank, Tried
from leglab.diagnosis.search.moves.neighbours import neighbours
from leglab.diagnosis.search.pool import Found


def ranking(found: Found) -> tuple[Rank, ...]:
    """Evidence of each effect alone at the first linearisation, and beside good sets [nats]."""
    fitter, best = found.fitter, found.ranks[0].evidence
    evidence = fitter.evidence(found.first, best.spread, best.weight, best.kappa)
    gains = dict.fromkeys(sorted(fitter.at.problem.library.searched), 0.0)
    nothing = evidence.score(())
    for _, member in evidence.additions(nothing):
        key = evidence.unknowns.keys[member[0]]
        if key in gains:
            gains[key] = max(gains[key], evidence.score((member,)).log - nothing.log)
    beside = _beside(found)
    rows = sorted(gains.items(), key=lambda row: -row[1])
    return tuple(Rank(name=k[0], element=k[1], gain=g, beside=beside.get(k)) for k, g in rows)


def _beside(found: Found) -> dict[Key, float]:
    """How far neighbours of good sets with each effect are above the most probable set [nats]."""
    pool, best = found.pool, dict[Key, float]()
    # Beside an exact model first order has said all.
    for one in [] if pool.scene.clear else neighbours(pool):
        ahead = one.score.log - pool.sound[0].score.log
        for key in one.evidence.unknowns.names(one.score.unknowns):
            best[key] = max(best.get(key, ahead), ahead)
    return best


def tried(found: Found) -> tuple[Tried, ...]:
    """Sets that were fitted, each once, with what proposed it first and what it came to."""
    top, ranks = found.ranks[0].score.log, {r.fit.keys: r for r in found.ranks}
    first = {s.fit.keys: s.proposal for s in reversed(found.pool.steps)}
    return tuple(
        Tried(
            names=tuple(sorted(keys)),
            move=first[keys].move,
            reason=first[keys].reason,
            level=ranks[keys].fit.level,
            behind=top - ranks[keys].score.log,
        )
        for keys in dict.fromkeys(s.fit.keys for s in found.pool.steps)
    )
