"""Record of a diagnosis: evidence of effects, fitted sets with reasons, factors of confidence."""

from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.result import Certainty, Rank, Tried
from leglab.diagnosis.search.moves.neighbours import neighbours
from leglab.diagnosis.search.pool import Found
from leglab.diagnosis.verdict.confidence import inside
from leglab.diagnosis.verdict.outcome import Outcome


def ranking(found: Found) -> tuple[Rank, ...]:
    """Ranks effects by first-order gain in log evidence [nats] if each is the only fault."""
    fitter, best = found.fitter, found.ranks[0].evidence
    evidence = fitter.evidence(found.first, best.spread, best.weight, best.kappa)
    gains = dict.fromkeys(sorted(fitter.at.problem.library.searched), 0.0)
    nothing = evidence.score(())
    for _, member in evidence.additions(nothing):
        key = evidence.unknowns.keys[member[0]]
        if key in gains:
            gains[key] = max(gains[key], evidence.score((member,)).log - nothing.log)
    added = _added(found)
    rows = sorted(gains.items(), key=lambda row: -row[1])
    return tuple(Rank(name=k[0], element=k[1], gain=g, added=added.get(k)) for k, g in rows)


def _added(found: Found) -> dict[Key, float]:
    """Returns for each effect the best neighbour set's log evidence minus the best set's [nats]."""
    pool, best = found.pool, dict[Key, float]()
    for one in neighbours(pool):
        ahead = one.score.log - pool.sound[0].score.log
        for key in one.evidence.unknowns.names(one.score.unknowns):
            best[key] = max(best.get(key, ahead), ahead)
    return best


def tried(found: Found) -> tuple[Tried, ...]:
    """Lists the fitted sets, each once, with the move that proposed it first."""
    top, ranks = found.ranks[0].score.log, {r.fit.keys: r for r in found.ranks}
    first = {step.keys: step for step in reversed(found.pool.steps)}
    return tuple(
        Tried(
            names=tuple(sorted(keys)),
            move=first[keys].move,
            reason=first[keys].reason,
            level=ranks[keys].fit.level,
            behind=top - ranks[keys].score.log,
        )
        for keys in dict.fromkeys(step.keys for step in found.pool.steps)
    )


def certainties(outcome: Outcome) -> tuple[Certainty, ...]:
    """Lists the effects of the fitted sets with their confidence and its factors."""
    return tuple(
        Certainty(
            name=key[0],
            element=key[1],
            confidence=one.confidence,
            evidence=one.evidence,
            parts=one.parts,
            drive=one.drive,
            explained=one.member.share,
            inside=inside(outcome.table, one.member),
            differs=one.member.differs,
            ties=len(one.ties),
        )
        for key, one in outcome.judged.effects.items()
    )
