"""Tabulation of the sets of effects of a search: the last step of a diagnosis with replays."""

from collections.abc import Iterator

import numpy as np
from scipy.stats import norm

from leglab.diagnosis import thresholds
from leglab.diagnosis.effects.base import all_effects
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.replay.residual import as_noise
from leglab.diagnosis.search.healthy import Specimen
from leglab.diagnosis.verdict.sets import Row, Sets
from leglab.diagnosis.verdict.table import Action, Entry, Member, Table


def tabulated(sets: Sets, specimen: Specimen | None) -> Table:
    """Tabulates all sets.

    Args:
        sets: The sets of a search.
        specimen: The machine in its healthy recordings; None without these.
    """
    keys = sorted({key for row in sets.rows for key in row.keys})
    best = {id(row) for key in keys for row in _best(sets, key)}
    library, problem = sets.unknowns.library, sets.at.problem
    return Table(
        sets=tuple(_entry(sets, row, specimen, shown=id(row) in best) for row in sets.rows),
        level=sets.found.level,
        impostor=impostors(sets),
        contains=tuple((a, b) for a in keys for b in keys if library.contains(a, b)),
        as_it_was=specimen.as_it_was(problem, Hypothesis()) if specimen else None,
    )


def _best(sets: Sets, key: Key) -> Iterator[Row]:
    """Yields the most probable set with an effect, without and with the change `Row.drive`."""
    having = [row for row in sets.rows if key in row.keys]
    yield max(having, key=lambda row: row.score.log)
    yield max(having, key=lambda row: row.score.log + row.drive)


def _entry(sets: Sets, row: Row, specimen: Specimen | None, *, shown: bool) -> Entry:
    """Tabulates a set; `shown` is whether the influence of its effects is computed."""
    keys, quiet = sorted(row.keys), False
    if not keys:
        quiet = _as_noise(sets, row) if specimen is None else _as_healthy(sets, row, specimen)
    return Entry(
        keys=tuple(keys),
        ended=tuple(sorted(row.ended)),
        log=_finite(row.score.log),
        fit=_finite(row.score.fit),
        apart=tuple(map(_finite, row.apart.tolist())),
        drive=row.drive,
        numbers=len(row.score.members),
        members=tuple(_member(sets, row, key) for key in keys if shown),
        quiet=quiet,
        quiet_held_out=quiet and (specimen is not None or _as_noise_held_out(sets, row)),
    )


def _finite(log: float) -> float:
    """Returns a log evidence as JSON can hold it: an impossible set has the evidence exp(-1e12)."""
    return max(log, -1e12)


def _as_healthy(sets: Sets, row: Row, specimen: Specimen) -> bool:
    """Tests whether a set's errors are as small as the specimen's in healthy recordings.

    If the set only contains effects that are no change, the errors without these are tested.
    """
    tested = Hypothesis() if row.score.members else row.hypothesis
    return specimen.as_it_was(sets.at.problem, tested)


def _as_noise(sets: Sets, row: Row) -> bool:
    """Tests whether a set leaves only noise and keeps all parameters within tolerances.

    19 of 20 good machines keep these limits.
    """
    u = row.evidence.unknowns
    known = np.flatnonzero(u.tolerance[: u.single])
    away = u.departures(row.hypothesis)[known] / u.tolerance[known]
    within = bool((np.abs(away) <= norm.isf(0.025 / max(known.size, 1))).all())
    left = sets.channel_squares(row.left).mean(axis=1)
    return within and as_noise(left, sets.at.recording)


def _as_noise_held_out(sets: Sets, row: Row) -> bool:
    """Tests whether a set leaves only noise on held-out recordings; True without these."""
    problem = sets.at.problem
    if not problem.held.any():
        return True
    squares = problem.noise_levels(row.hypothesis)
    return as_noise(squares[problem.held], problem.replay.recording[problem.held])


def _member(sets: Sets, row: Row, key: Key) -> Member:
    actions = [
        Action(
            numbers=tuple(
                at.size // sets.channels * int((at.recording == r).sum())
                for r in np.unique(at.recording)
            ),
            left=_nested(medians[0]),
            without=_nested(medians[1]),
            change=_nested(medians[2]),
        )
        for at, medians in sets.shown(row, key)
    ]
    return Member(
        key=key,
        differs=_differs(row, key),
        fitted=actions[0],
        held_out=actions[1] if len(actions) > 1 else None,
    )


def _nested(values: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in values.tolist())


def _differs(row: Row, key: Key) -> float:
    """Computes the probability that directions differ noticeably; 1 for a symmetric effect."""
    u, score = row.evidence.unknowns, row.score
    places = [] if key in row.renamed.values() else row.places(key)
    if not places:
        return 1.0
    claims = []
    for pair in u.effect(score.unknowns[places[0]]).by_direction:
        both = [i for i in places if u.name(score.unknowns[i]) in pair]
        if both:
            values = score.values[both]
            away = abs(float(values[0] - values[1] if len(both) == 2 else values[0]))
            spread = float(np.linalg.norm(score.deviations[both]))
            claims.append(float(norm.cdf((away - 1.0) / max(spread, 1e-9))))
    return max(claims, default=1.0)


def impostors(sets: Sets) -> tuple[float, float]:
    """Computes mean and standard deviation of the logit of the share that impostors explain."""
    u, first, best = sets.unknowns, sets.found.first, sets.best
    evidence = sets.fitter.evidence(first, best.spread, best.weight, best.kappa, places=[sets.size])
    product = evidence.likeness(sets.found.ranks[0].score)
    size = np.maximum(np.diag(product), 1e-12)
    group = {e.name: e.group for e in all_effects()}
    keys = [u.keys[q] for q, _ in first.jumps]
    kinds = np.array([group[k[0]] for k in keys])
    best_of: dict[Key, tuple[float, float]] = {}
    for b in range(len(keys)):
        others = kinds != kinds[b]
        if size[b] < thresholds.VISIBLE or not others.any():
            continue
        share = np.maximum(product[others, b], 0.0) ** 2 / (size[others] * size[b])
        if keys[b] not in best_of or size[b] > best_of[keys[b]][0]:
            best_of[keys[b]] = float(size[b]), float(min(share.max(), 1.0))
    shares = np.array([share for _, share in best_of.values()])
    x = np.log((shares + 1e-3) / (1.0 - shares + 1e-3))
    m0, s0, w = thresholds.IMPOSTOR
    mean = (w * m0 + x.sum()) / (w + x.size)
    variance = w * (s0**2 + (m0 - mean) ** 2) + ((x - mean) ** 2).sum()
    return float(mean), float(np.sqrt(variance / (w + x.size)))
