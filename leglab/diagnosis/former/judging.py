"""Judgement: whether an effect is named, and how sure its name and its parameters are."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import chi2, norm
from scipy.stats import t as student

from leglab.diagnosis.effects.hypothesis import Key, Site
from leglab.diagnosis.former.evidence import beyond_specimens, posterior
from leglab.diagnosis.former.fitting import Fit, Sums, free_tangents
from leglab.diagnosis.former.nuisances import Nuisance
from leglab.diagnosis.former.search import Contender, Round
from leglab.diagnosis.replay.residual import Linearisation, Problem, robust_weight
from leglab.diagnosis.thresholds import DEFAULT, Thresholds


def accepted(problem: Problem, tried: Round, contender: Contender) -> bool:
    """Whether an effect is named: its gain is beyond chance, holds where held out, and matters."""
    limits = problem.thresholds
    saved = tried.base - contender.cost
    held = saved[problem.held] if problem.held.sum() > 3 else saved
    holds = t_value(held) >= limits.significant or rarely_but_surely(held, limits)
    if problem.noise.discrepancy is not None:
        # Held-out motion that hardly shows it, a slow one, is lost in the model's own error there.
        # It must not get worse, and all windows must say more than the best of so many effects
        # would reach by chance in 1 of 100 cases (Bonferroni).
        chance = float(norm.isf(0.01 / max(len(tried.candidates), 1)))
        holds |= no_worse(held) and t_value(saved) >= max(chance, limits.significant)
        holds &= nothing_more(problem, tried) <= 0.5
    return bool(
        problem.size * saved[contender.fit.at.chosen].sum() >= tried.threshold
        and holds
        and saved.mean() >= limits.worthwhile * max(1.0, tried.base.mean() - 1.0)
        and noticeable(problem, contender.key, contender.fit.hypothesis)
    )


def nothing_more(problem: Problem, tried: Round) -> float:
    """Probability, on a rough machine, that no effect is there beyond those named before a round.

    That one more is there is as probable as that none is, and each of all effects alike.
    """
    sites, limit = problem.library.sites, problem.thresholds.noticeable
    costs = [float(tried.base.mean()), *(float(c.cost.mean()) for c in tried.contenders)]
    own = (sites[c.key].used(c.fit.hypothesis[c.key], limit) for c in tried.contenders)
    counts = [0, *own]
    share = posterior(costs, problem.worth or problem.numbers, counts)
    none = max(len(tried.candidates), 1) * share[0]
    return float(none / (none + share[1:].sum()))


def no_worse(held: np.ndarray) -> bool:
    """Whether held-out windows, (windows,), lose nothing beyond the standard error."""
    return t_value(held) > -1.0


def earns(problem: Problem, larger: Contender, simpler: Contender) -> bool:
    """Whether an effect explains more than a special case of it, beyond its further parameters.

    The larger one always fits a little better. Further parameters without meaning save a
    chi-square of as many degrees of freedom (Wilks 1938), times the dispersion that is left; in
    1 of 100 cases more than its quantile. And what they save must hold where held out. On a rough
    machine, whose errors are few numbers, the larger one must be the more probable; where held-out
    motion hardly shows what it saves, it must lose nothing there, and all windows must say so.
    """
    sites = problem.library.sites
    further = len(sites[larger.key].parameters) - len(sites[simpler.key].parameters)
    saved = simpler.cost - larger.cost
    spread = max(1.0, float(larger.cost.mean()))
    chance = spread * float(chi2.ppf(0.99, max(further, 1)))
    held = saved[problem.held] if problem.held.sum() > 3 else saved
    significant = problem.thresholds.significant
    holds = t_value(held) >= significant
    if problem.noise.discrepancy is not None:
        if probabilities(problem, (larger, simpler))[0] < 0.5:
            return False
        holds |= no_worse(held) and t_value(saved) >= significant
    return bool(problem.size * saved[larger.fit.at.chosen].sum() > chance and holds)


def simplest_first(problem: Problem, contenders: Sequence[Contender]) -> tuple[Contender, ...]:
    """Contenders as they come, but special cases before a larger effect that earns no more."""
    out = list(contenders)
    for larger in contenders:
        for simpler in contenders:
            if not problem.library.contains(larger.key, simpler.key):
                continue
            if out.index(simpler) > out.index(larger) and not earns(problem, larger, simpler):
                out.remove(simpler)
                out.insert(out.index(larger), simpler)
    return tuple(out)


def departure(problem: Problem, key: Key, hypothesis: Mapping[Key, np.ndarray]) -> float:
    """How far the strengths of an effect are from nominal, in their smallest trials: the most."""
    site = problem.library.sites[key]
    return max(
        p.departure(float(value), float(nominal))
        for value, nominal, p in zip(hypothesis[key], site.nominal, site.parameters, strict=True)
        if p.role == "strength"
    )


def departure_from_known(problem: Problem, key: Key, hypothesis: Mapping[Key, np.ndarray]) -> float:
    """As `departure`, from the nearest value between the model's and the specimen's.

    A calibration also moves strengths to make up for laws that are not the model's. Where a
    change takes back a part of that, what it made up for shows less now; no part has failed.
    """
    site = problem.library.sites[key]
    ends = np.stack([site.model, site.nominal])
    known = np.clip(hypothesis[key], ends.min(axis=0), ends.max(axis=0))
    return max(
        p.departure(float(value), float(near))
        for value, near, p in zip(hypothesis[key], known, site.parameters, strict=True)
        if p.role == "strength"
    )


def may_be_fault(problem: Problem, key: Key, hypothesis: Mapping[Key, np.ndarray]) -> bool:
    """Whether a strength of an effect lies on a side on which faults lie."""
    site = problem.library.sites[key]
    return any(
        p.may_be_fault(float(value), float(nominal))
        for value, nominal, p in zip(hypothesis[key], site.nominal, site.parameters, strict=True)
        if p.role == "strength"
    )


def fault_probability(
    problem: Problem,
    key: Key,
    hypothesis: Mapping[Key, np.ndarray],
    *,
    calibrated: bool,
    beside: bool = False,
) -> float:
    """Probability that the strengths of an effect are a fault's and not a good machine's own.

    Args:
        problem: Recordings and machine.
        key: The effect.
        hypothesis: With its values.
        calibrated: Whether they depart from those of a specimen, which varies from day to day.
        beside: Whether a larger change was found: what takes back a part of the calibration is
            then none.
    """
    limits = problem.thresholds
    if not calibrated and not may_be_fault(problem, key, hypothesis):
        return 0.0  # A better part than the model's is how this machine was made.
    far = departure_from_known if beside else departure
    spread = limits.day_spread if calibrated else specimens_spread(problem, key)
    return beyond_specimens(far(problem, key, hypothesis), spread, limits.fault_range)


def noticeable(problem: Problem, key: Key, hypothesis: Mapping[Key, np.ndarray]) -> bool:
    """Whether a strength departs from nominal by a share of its smallest trial that matters."""
    return departure(problem, key, hypothesis) > problem.thresholds.noticeable


def specimens_spread(problem: Problem, key: Key) -> float:
    """Standard deviation of an effect's strengths among good machines, in their smallest trials.

    Where a tolerance is known it says so; elsewhere some share of what is barely noticeable.
    """
    limits = problem.thresholds
    return max(
        min(limits.specimen_spread, limits.rough_tolerance * p.tolerance / p.scale)
        if p.tolerance > 0.0
        else limits.specimen_spread
        for p in problem.library.sites[key].parameters
        if p.role == "strength"
    )


def t_value(difference: np.ndarray) -> float:
    """Mean over its standard error of paired differences of windows, shape (windows,)."""
    if difference.size < 2:
        return 0.0
    spread = float(difference.std(ddof=1)) / np.sqrt(difference.size)
    return float(difference.mean()) / spread if spread > 0 else 0.0


def rarely_but_surely(saved: np.ndarray, thresholds: Thresholds = DEFAULT) -> bool:
    """Whether a few windows gain much and hardly any loses: an effect that shows at times only.

    A play shows when the torque changes its sign; in a slow recording these are two windows of
    nineteen, too few for a mean over its standard error.

    Args:
        saved: Robust cost saved in held-out windows, in noise variances, shape (windows,).
        thresholds: Of the windows that count.
    """
    changed = saved[np.abs(saved) > thresholds.changed_cost]
    enough = changed.size >= thresholds.changed_windows
    return bool(enough and np.mean(changed > 0) >= thresholds.changed_for_better)


def preferences(
    costs: Sequence[np.ndarray], rng: np.random.Generator, draws: int = DEFAULT.resamples
) -> np.ndarray:
    """Share of resampled sets of windows in which i costs less than j, shape (k, k).

    Args:
        costs: Of each hypothesis, shape (windows,) each.
        rng: Draws windows with replacement (Efron's bootstrap of paired blocks).
        draws: Number of sets.
    """
    table = np.stack(costs)
    count = table.shape[1]
    weights = rng.multinomial(count, np.full(count, 1.0 / count), size=draws)
    totals = weights @ table.T
    wins = (totals[:, :, None] < totals[:, None, :]).mean(axis=0)
    ties = (totals[:, :, None] == totals[:, None, :]).mean(axis=0)
    return wins + 0.5 * ties


def probabilities(problem: Problem, contenders: Sequence[Contender]) -> np.ndarray:
    """Probability of each contender among some, on a rough machine, shape (contenders,)."""
    costs = [float(c.cost.mean()) for c in contenders]
    counts = [parameters(problem, c.fit) for c in contenders]
    return posterior(costs, problem.numbers, counts)


def parameters(problem: Problem, fit: Fit) -> int:
    """Number of parameters that a fit's effects need."""
    sites, limit = problem.library.sites, problem.thresholds.noticeable
    return sum(sites[key].used(fit.hypothesis[key], limit) for key in fit.free)


def intervals(
    problem: Problem, fit: Fit, beside: Sequence[Nuisance] | None = None
) -> dict[Key, np.ndarray]:
    """Half the width of the 95 % intervals of what each free effect says, in its units.

    Of its parameters and then of the differences between its directions, (parameters +
    differences,): what two parameters share may be unsure, and by how much they differ sure.
    The larger of two: the sandwich with windows as clusters (Liang and Zeger 1986), and a
    jackknife over recordings, which sees what all windows of a recording share. Both to first
    order about the fit.

    Args:
        problem: Recordings and machine.
        fit: With the effects.
        beside: What else may be off a little, in the sandwich; None for the fit's own nuisances.
    """
    fine = problem.thresholds.fine_differences
    narrow = _sums(problem, fit, fit.at, fine)
    wide = narrow
    if beside is not None:
        other = problem.with_nuisances(beside)
        at = other.linearise(fit.hypothesis, fit.at.chosen, fit.free, share=fine)
        wide = _sums(problem, fit, at, fine)
    keys = sorted(fit.free)
    rows = [_told(problem.library.sites[key]) for key in keys]
    told = block_diag(*rows)
    half = np.maximum(
        _sandwich(*wide, told),
        _jackknife(*narrow, told, problem.replay.recording[fit.at.chosen]),
    )
    ends = np.cumsum([len(each) for each in rows])[:-1]
    return dict(zip(keys, np.split(half, ends), strict=True))


def _told(site: Site) -> np.ndarray:
    """Parameters and differences of directions, in their units, of unknowns in their scales."""
    scales = np.array([p.scale for p in site.parameters])
    return np.concatenate([np.eye(scales.size), site.differences]) * scales


# Of windows: matrices J'J and gradients J'r with robust weights; and the priors.
_Weighed = tuple[np.ndarray, np.ndarray, np.ndarray]


def _sums(problem: Problem, fit: Fit, at: Linearisation, fine: float) -> _Weighed:
    own = free_tangents(problem, at, fit.free, fine)
    count = own.columns.shape[2]
    jacobian = np.concatenate([own.columns, at.tangents], axis=2)
    limit = problem.thresholds.robust_limit
    weight = robust_weight(np.mean(at.residual**2, axis=1), limit)[:, None]
    sums = Sums.of(at.residual, jacobian)
    prior = np.diag(np.concatenate([np.zeros(count), np.ones(jacobian.shape[2] - count)]))
    return weight[:, :, None] * sums.matrices, weight * sums.gradients, prior


def _sandwich(
    matrices: np.ndarray, gradients: np.ndarray, prior: np.ndarray, told: np.ndarray
) -> np.ndarray:
    """Half widths of sums of the first unknowns, `told` of shape (sums, first unknowns)."""
    total = matrices.sum(axis=0) + prior
    total[np.diag_indices_from(total)] *= 1.0 + 1e-9
    inverse = np.linalg.pinv(total, hermitian=True)
    centred = gradients - gradients.mean(axis=0)
    bread = inverse @ (centred.T @ centred) @ inverse
    count = int((np.diag(prior) == 0.0).sum())
    first = told.shape[1]
    spreads = [told @ c[:first, :first] @ told.T for c in (bread, inverse)]
    noise = np.maximum(*map(np.diag, spreads))
    return student.ppf(0.975, max(gradients.shape[0] - count, 1)) * np.sqrt(noise)


def _jackknife(
    matrices: np.ndarray,
    gradients: np.ndarray,
    prior: np.ndarray,
    told: np.ndarray,
    recording: np.ndarray,
) -> np.ndarray:
    """The same from the shifts without each recording, (windows,); 0 of a single one."""
    mean = gradients.mean(axis=0)
    present = np.unique(recording)
    if present.size < 2:
        return np.zeros(len(told))
    shifts = []
    for number in present:
        keep = recording != number
        part = np.linalg.pinv(matrices[keep].sum(axis=0) + prior, hermitian=True)
        shifts.append(part @ (keep.sum() * mean - gradients[keep].sum(axis=0)))
    spread = np.stack(shifts)[:, : told.shape[1]] @ told.T
    share = (present.size - 1) / present.size
    jack = np.sqrt(share * ((spread - spread.mean(axis=0)) ** 2).sum(axis=0))
    return student.ppf(0.975, present.size - 1) * jack
