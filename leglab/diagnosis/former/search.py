"""One round of the greedy search for effects: screen, refit, sharpen, compare."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.former.evidence import posterior
from leglab.diagnosis.former.fitting import Fit, free_tangents, refit
from leglab.diagnosis.former.screening import Candidate, beyond_tangents, pairs, screen
from leglab.diagnosis.replay.residual import Linearisation, Problem

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Contender:
    """An effect that was added to the named ones and fitted to the end with them.

    Attributes:
        key: The effect that was added last.
        fit: On the fitted windows.
        cost: Robust mean square of every window, fitted and held out, shape (windows,).
    """

    key: Key
    fit: Fit
    cost: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Round:
    """One round of the search.

    Attributes:
        base: Robust mean square of every window before the round, shape (windows,).
        candidates: As screened, best first.
        contenders: As fitted, best first.
        threshold: Gain that the best of all effects reaches by chance in 1 of 100 cases.
        dropped: First fits that were not finished, for another one left them no chance, though
            they explain something: beside a further effect they may explain it all.
    """

    base: np.ndarray
    candidates: tuple[Candidate, ...]
    contenders: tuple[Contender, ...]
    threshold: float
    dropped: tuple[tuple[Key, Fit], ...] = ()

    @property
    def at_once(self) -> bool:
        """Whether two effects were fitted at once: both stand for the same fit."""
        return len({id(c.fit) for c in self.contenders}) < len(self.contenders)


def thinned(mask: np.ndarray, every: int) -> np.ndarray:
    """Every n-th of the windows in a mask, same shape."""
    out = np.zeros_like(mask)
    out[np.flatnonzero(mask)[::every]] = True
    return out


def baseline(problem: Problem, chosen: np.ndarray) -> Fit:
    """The unmodified model with its nuisances refitted under their priors."""
    at = problem.linearise(Hypothesis(), chosen)
    return refit(problem, at, frozenset(), iterations=3)


def sharpen(
    problem: Problem, fit: Fit, *, chosen: np.ndarray | None = None, iterations: int = 4
) -> Fit:
    """Refits with tangents taken anew where the first fit ended, on its windows or others."""
    fine = problem.thresholds.fine_differences
    chosen = fit.at.chosen if chosen is None else chosen
    at = problem.linearise(fit.hypothesis, chosen, fit.free, share=fine)
    return refit(problem, at, fit.free, iterations=iterations, fine=fine)


def total_cost(problem: Problem, fit: Fit) -> np.ndarray:
    """Robust mean square of every window, and what the priors say, shape (windows,).

    n numbers of mean square c and departures of square sum d have the likelihood
    c^(-n/2) exp(-d/2), as that of numbers of mean square c exp(d/n). Beside all errors of an exact
    model, counted one by one, priors are nothing.
    """
    cost = problem.window_cost(fit.hypothesis)
    if problem.worth is None:
        return cost
    return cost * np.exp(problem.departed(fit.hypothesis, fit.free) / problem.worth)


def chance_gain(
    candidates: Sequence[Candidate],
    tangents: np.ndarray,
    overdispersion: float,
    rng: np.random.Generator,
    *,
    draws: int = 2000,
) -> float:
    """Gain that the best effect reaches by chance in 1 of 100 cases: bootstrap of the maximum.

    Under the null the gain of an effect is the square of the projection of white noise on its
    direction, nuisances projected out; directions of different effects are correlated.

    Args:
        candidates: With their directions.
        tangents: Of the nuisances, shape (chosen windows, size, nuisances).
        overdispersion: Mean square of the residuals when nothing is missing.
        rng: Draws the noise.
        draws: Bootstrap samples.

    Returns:
        Infinity without candidates.
    """
    if not candidates:
        return np.inf
    directions = np.stack([c.direction.ravel() for c in candidates], axis=1)
    matrix = beyond_tangents(directions, tangents)
    norm = np.linalg.norm(matrix, axis=0)
    matrix = matrix[:, norm > 0] / norm[norm > 0]
    if not matrix.shape[1]:
        return np.inf
    values, vectors = np.linalg.eigh(matrix.T @ matrix)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    scores = rng.standard_normal((draws, root.shape[1])) @ root.T
    return float(overdispersion * np.quantile((scores**2).max(axis=1), 0.99))


def search_round(
    problem: Problem,
    start: Hypothesis,
    best: Fit,
    rng: np.random.Generator,
    progress: Progress,
    onset: np.ndarray | None = None,
    *,
    beside: Hypothesis | None = None,
) -> tuple[Problem, Round]:
    """Looks for one more effect on top of those that are named already.

    Args:
        problem: Recordings and machine.
        start: Where screening starts: nominal nuisances in the first round, since nuisances that
            were pulled by a missing effect would mislead; the last fit in later rounds.
        best: Best fit without a further effect: of the effects that are named already.
        rng: For the null.
        progress: Called with what is being done.
        onset: Time at which the effect begins, shape (recordings,); None: throughout.
        beside: Where screening starts once more: what does best there is fitted as well.

    Returns:
        The problem, its noise model about the best rough fit if there is one; and the round.
    """
    named, chosen, limits = best.free, best.at.chosen, problem.thresholds
    progress("tangents of the nuisance parameters")
    at = problem.linearise(start, chosen, named)
    progress("screening")
    own = free_tangents(problem, at, named)
    same = best.hypothesis is start
    floor = problem.cost(
        at.residual if same else problem.residual(best.hypothesis, chosen),
        problem.prior_weight(chosen) * problem.departed(best.hypothesis, named),
    )
    candidates = screen(problem, at, own, floor, skip=named, onset=onset, started_best=same)
    settled = float(np.median(np.mean(best.at.residual**2, axis=1)))
    threshold = chance_gain(candidates, at.tangents, float(np.clip(settled, 1.0, 2.0)), rng)
    noise = problem.size * chosen.sum()  # chi-square of noise alone
    hopeful = candidates and candidates[0].gain > limits.hopeful_gain * noise
    tried = [(at, c) for c in _refitted(problem, candidates)] if hopeful else []
    if tried and beside is not None:
        other = problem.linearise(beside, chosen, named)
        own = free_tangents(problem, other, named)
        again = screen(problem, other, own, floor, skip=named, onset=onset)
        tried = _by_rank(tried, [(other, c) for c in _refitted(problem, again)])
    rough: list[tuple[Key, Fit]] = []
    for about, candidate in tried:
        key, values = candidate.key, candidate.values
        progress(f"fitting {key[0]}")

        def fitted(
            base: Hypothesis,
            about: Linearisation = about,
            key: Key = key,
            values: np.ndarray = values,
        ) -> Fit:
            begun = base.changed(key, values, onset)
            return refit(problem, about, named | {key}, start=begun, iterations=4)

        fit = fitted(about.base)
        if fit.cost > limits.stuck_share * floor and about.base is not best.hypothesis:
            # Worse than without the effect: the nuisances are far from where they belong.
            fit = min(fit, fitted(best.hypothesis), key=lambda f: f.cost)
        rough.append((key, fit))
    rough.sort(key=lambda entry: entry[1].cost)
    dropped: list[tuple[Key, Fit]] = []
    if problem.noise.discrepancy is not None:
        rough, dropped = _possible(problem, floor, rough, first=not named)
    if rough:
        progress("start states and time step about the best fit")
        problem = problem.about(rough[0][1].hypothesis)
    contenders = _sharpened(problem, rough, noise, progress)
    return problem, Round(
        base=total_cost(problem, best),
        candidates=tuple(candidates),
        contenders=tuple(sorted(contenders, key=lambda c: c.fit.cost)),
        threshold=threshold,
        dropped=tuple(dropped),
    )


def _sharpened(
    problem: Problem, rough: Sequence[tuple[Key, Fit]], noise: float, progress: Progress
) -> list[Contender]:
    """The best of the first fits, fitted further; `noise` is the cost of noise alone."""
    limits = problem.thresholds
    # A first fit that began far from the baseline is not at its end where nuisances are many.
    count = limits.sharpened if problem.worth is None else limits.rough_sharpened
    # On a rough machine all come near, and are fitted again as its discrepancy is annealed.
    near = limits.close_cost * noise if problem.noise.discrepancy is None else 0.0
    contenders: list[Contender] = []
    lead = np.inf
    for place, (key, fit) in enumerate(rough):
        special = any(problem.library.contains(c.key, key) for c in contenders)
        # Below this all may still reach the noise, whatever a few first steps made of them.
        if place >= count and not special and fit.cost >= near:
            continue
        behind = fit.cost - noise > limits.hopeless_factor * max(lead, 0.2 * noise)
        if behind and fit.cost >= limits.close_cost * noise:
            continue
        progress(f"sharpening {key[0]}")
        one = as_contender(problem, key, sharpen(problem, fit))
        # A rival that comes near is fitted to the end, or a tie would pass for a victory; and so
        # is the first one, if a rival has overtaken it.
        if contenders and one.fit.cost < near:
            one = finished(problem, one)
        lead = min(lead, one.fit.cost - noise)
        contenders.append(one)
    if contenders and lead + noise < contenders[0].fit.cost < near:
        contenders[0] = finished(problem, contenders[0])
    return contenders


def _possible(
    problem: Problem, floor: float, rough: list[tuple[Key, Fit]], *, first: bool
) -> tuple[list[tuple[Key, Fit]], list[tuple[Key, Fit]]]:
    """First fits on a rough machine, without those that another one leaves no chance.

    All are left out where none comes near to what its parameters cost, `floor` being the cost
    without any. In the first round none of them is at its end, for all that follows begins far
    from where it belongs.

    Returns:
        Those that stay; and of the others those that pay for their parameters.
    """
    limits = problem.thresholds
    sites = problem.library.sites
    costs = [fit.cost for _, fit in rough]
    used = (sites[key].used(f.hypothesis[key], limits.noticeable) for key, f in rough)
    counts = [0, *used]
    # A first fit may still lose a share of what it began with.
    unfinished = limits.rough_unfinished * floor
    near = unfinished if first else 0.0
    share = posterior([floor, *(c - near for c in costs)], problem.numbers, counts)
    none, own = share[0], share[1:]
    if (own < limits.rough_chance * none).all():
        return [], []
    pays = own >= limits.rough_chance * none
    own = posterior([c + unfinished for c in costs], limits.rough_numbers, counts[1:])
    stays = own >= limits.rough_hopeless * own.max()

    def those(mask: np.ndarray) -> list[tuple[Key, Fit]]:
        return [entry for entry, keep in zip(rough, mask.tolist(), strict=True) if keep]

    return those(stays), those(~stays & pays)


def as_contender(problem: Problem, key: Key, fit: Fit) -> Contender:
    """A fit as a contender, by the effect that was added last."""
    return Contender(key=key, fit=fit, cost=total_cost(problem, fit))


def finished(problem: Problem, rival: Contender) -> Contender:
    """A contender fitted to the end, with the defect of the time step that is its own."""
    fit = rival.fit
    for _ in range(problem.thresholds.patience):
        problem = problem.with_defect_of(fit.hypothesis)
        before, fit = fit.cost, sharpen(problem, fit)
        if fit.cost >= 0.98 * before:
            break
    return as_contender(problem, rival.key, fit)


def _refitted(problem: Problem, candidates: Sequence[Candidate]) -> list[Candidate]:
    """The best candidates, and special cases of them, which may do as well."""
    limits = problem.thresholds
    count = limits.refitted if problem.worth is None else limits.rough_refitted
    best = list(candidates[:count])
    contains = problem.library.contains
    return best + [
        c for c in candidates[len(best) :] if any(contains(larger.key, c.key) for larger in best)
    ]


# A screened effect, with the tangents where it was screened.
_Screened = tuple[Linearisation, Candidate]


def _by_rank(one: Sequence[_Screened], other: Sequence[_Screened]) -> list[_Screened]:
    """Each effect of two screenings once, from the one in which it ranks higher."""
    ranked = sorted([*enumerate(one), *enumerate(other)], key=lambda entry: entry[0])
    found: dict[Key, _Screened] = {}
    for _, entry in ranked:
        found.setdefault(entry[1].key, entry)
    return list(found.values())


def pair_search(
    problem: Problem, last: Round, chosen: np.ndarray, progress: Progress
) -> tuple[Problem, Contender | None]:
    """Fits two effects of the last round at once: greedy search may start with an impostor.

    Returns:
        The problem with its noise model about the best pair, and that pair: its `key` is the effect
        that matters less. None where there are no two candidates.
    """
    base = Hypothesis()
    at = problem.linearise(base, chosen)
    # The round has changed the noise model since it screened: the steps are replayed under the new
    # one. What an effect gained alone says little about what it gains beside another.
    candidates = [
        replace(c, step=problem.residual(base.with_values(c.key, c.values), chosen) - at.residual)
        for c in last.candidates
        if c.detectable > 0.0
    ]
    fits = fitted_pairs(problem, at, pairs(problem, at, candidates), progress)
    if not fits:
        return problem, None
    fits.sort(key=lambda f: f.cost)
    problem = problem.about(fits[0].hypothesis)
    # None of the first fits is at its end.
    nearer = [sharpen(problem, fit) for fit in fits[: problem.thresholds.sharpened]]
    return problem, as_pair(problem, min(nearer, key=lambda f: f.cost))


def fitted_pairs(
    problem: Problem,
    at: Linearisation,
    promising: Sequence[tuple[Hypothesis, frozenset[Key]]],
    progress: Progress,
) -> list[Fit]:
    """First fits of two effects at once, of the most promising of all pairs."""
    fits, limits = [], problem.thresholds
    count = limits.pairs if problem.worth is None else limits.rough_pairs
    for start, keys in promising[:count]:
        progress(f"fitting {' and '.join(sorted(name for name, _ in keys))}")
        fits.append(refit(problem, at, keys, start=start))
    return fits


def as_pair(problem: Problem, fit: Fit) -> Contender:
    """A fit of two effects as a contender, by the one that matters less."""
    less = min(fit.free, key=lambda k: problem.window_cost(fit.hypothesis.without(k)).mean())
    return as_contender(problem, less, fit)
