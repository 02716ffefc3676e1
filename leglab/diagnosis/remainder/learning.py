"""Learning of static forces that no effect explains: from force balances, then by simulation."""

from collections.abc import Callable, Collection, Sequence
from copy import copy
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from leglab.base.scale import rms
from leglab.diagnosis.balance.balances import balances
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.remainder.forms import Form, choose_form, worthwhile
from leglab.diagnosis.remainder.part import LearnedLibrary, Part
from leglab.diagnosis.remainder.words import Described, describe
from leglab.diagnosis.replay.following import follow
from leglab.diagnosis.replay.residual import Problem, robust_cost, robust_weight, thinned
from leglab.diagnosis.result import closed, root_mean
from leglab.diagnosis.thresholds import ALIKE, EXPLAINED, EXPLANATION, Thresholds

# Sentence for large remaining errors that are not a static function of the present motion.
MEMORY_WORDS = "What is left has a memory: delay, play or flexibility are suspects"


@dataclass(frozen=True, kw_only=True, eq=False)
class Remainder:
    """Learned static forces ("remainder") whose gain is validated on held-out recordings."""

    parts: tuple[Part, ...]  #: Forces of joints and command offsets of cylinders
    hypothesis: Hypothesis  #: Hypothesis whose nuisance parameters are refitted with the parts
    described: tuple[Described, ...]
    problem: Problem  #: Problem with the parts in all hypotheses; noise model at `hypothesis`
    closed_fraction: float  #: (before - after) / (before - 1) of the held-out RMS in noise levels
    memory: bool  #: Whether the remaining errors depend on the past

    @property
    def words(self) -> str:
        """Description in one or two sentences."""
        text = "; ".join(d.text for d in self.described)
        return f"{text}. {MEMORY_WORDS}" if self.memory else text

    def to_json(self) -> dict[str, Any]:
        """Returns the entry of improvement.json."""
        return {
            "words": self.words,
            "closed_fraction": self.closed_fraction,
            "memory": self.memory,
            "parts": [
                {**asdict(d), "plugin": part.name, "attributes": part.config()}
                for d, part in zip(self.described, self.parts, strict=True)
            ],
        }


def learn_remainder(
    problem: Problem,
    hypothesis: Hypothesis,
    *,
    named: Collection[Key] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Remainder | None:
    """Learns a static remainder in addition to a hypothesis; None if no gain is validated.

    Additive splines are fitted to the balances of forces and oil along the measured motion, and
    refined by replays together with the parameters that have tolerances (nuisance parameters).
    Parts without a gain on held-out recordings are left out; None without such recordings. The
    values of the effects `named` are fixed; by default these are all effects without a tolerance.
    """
    held, sites, least = problem.held, problem.library.sites, EXPLAINED
    if not held.any() or problem.window_cost(hypothesis)[held].mean() < least:
        return None
    if named is None:
        named = [k for k in hypothesis if all(p.tolerance == 0.0 for p in sites[k].parameters)]
    keep = frozenset(named)
    # Fitted nuisance parameters may hide a missing force, so fits without and with them are tried.
    starts = [hypothesis.only(keep)]
    if set(hypothesis) != set(keep):
        starts.append(hypothesis)
    found = []
    for start in starts:
        progress("balances of force and oil")
        if forms := find_forms(problem, start):
            parts = [form.part(form.values) for form in forms]
            costs = with_parts(problem, parts).window_cost(start)
            found.append((float(costs[problem.fitted].mean()), start, forms))
    if not found:
        return None
    progress("refining what was learned by replay")
    _, start, forms = min(found, key=lambda one: one[0])
    refined, beside = refine(problem, start, forms, keep)
    progress("proof on held-out recordings")
    return _proved(problem, hypothesis, beside, [*zip(refined, forms, strict=True)])


def find_forms(problem: Problem, hypothesis: Hypothesis) -> tuple[Form, ...]:
    """Chooses the form of each balance's remainder from fitted windows in which the joint moves."""
    machine, limits = problem.machine, problem.thresholds
    fitted = np.unique(problem.replay.recording[problem.fitted])
    forms = (
        choose_form(
            balance.of(balance.moving & np.isin(balance.recording, fitted)),
            driven_by_oil=balance.joint in machine.on_cylinders,
            limits=limits,
        )
        for balance in balances(problem, hypothesis)
    )
    return tuple(form for form in forms if form is not None)


def _proved(
    problem: Problem, without: Hypothesis, beside: Hypothesis, learned: list[tuple[Part, Form]]
) -> Remainder | None:
    """Keeps the learned parts that improve the held-out recordings; None if no part does."""
    problem, held, limits = copy(problem), problem.held, problem.thresholds

    def joined(some: list[tuple[Part, Form]]) -> Problem:
        return with_parts(problem, [part for part, _ in some])

    problem.noise = joined(learned).about(beside).noise
    before, after = problem.noise_levels(without), joined(learned).noise_levels(beside)
    for one in [*learned] if len(learned) > 1 else ():
        others = [other for other in learned if other is not one]
        alone = joined(others).noise_levels(beside)
        if not pays(alone[held], after[held], limits):
            learned, after = others, alone
    levels = root_mean(before[held]), root_mean(after[held])
    if not pays(before[held], after[held], limits) or levels[1] >= levels[0]:
        return None
    final, unit = joined(learned).about(beside), problem.machine.unit
    if worsens(problem, without, final, beside):
        return None
    cost = float(robust_cost(after, limits.robust_limit).mean())
    return Remainder(
        parts=tuple(part for part, _ in learned),
        hypothesis=beside,
        described=tuple(describe(p, f.balance.inputs, unit(p.joint)) for p, f in learned),
        problem=final,
        closed_fraction=closed(*levels) or 0.0,
        memory=cost > EXPLAINED and has_memory(final, beside),
    )


def worsens(problem: Problem, without: Hypothesis, learned: Problem, beside: Hypothesis) -> bool:
    """Tests whether learned parts enlarge any error of held-out recordings, in physical units.

    It compares errors of channels at the end of windows, and of joints in closed-loop simulations
    of whole recordings. Errors are not whitened, because whitening suppresses errors that uncertain
    start states could cause. An error may grow by its sensor's noise (added in quadrature).
    """
    held, noise = problem.held, problem.sensor_noise
    recordings = np.unique(problem.replay.recording[held]).tolist()
    joints = {c.joint: k for k, c in enumerate(problem.channels) if not c.chamber}
    hidden = [rms(noise[recordings], axis=0), noise[recordings][:, list(joints.values())].ravel()]

    def errors(problem: Problem, hypothesis: Hypothesis) -> np.ndarray:
        found = rms(problem.raw_errors(hypothesis)[held][:, :, -1], axis=0).tolist()
        for i in recordings:
            course = follow(problem, hypothesis, i)
            found += [course.deviation(joint) if course else 0.0 for joint in joints]
        return np.array(found)

    before, after = errors(problem, without), errors(learned, beside)
    return not (after <= np.hypot(before, np.concatenate(hidden))).all()


def pays(before: np.ndarray, after: np.ndarray, limits: Thresholds) -> bool:
    """Tests whether the windows' costs fall significantly, and by a minimum share of the misfit."""
    cost = robust_cost(before, limits.robust_limit)
    saved = cost - robust_cost(after, limits.robust_limit)
    misfit = saved.size * (max(float(cost.mean()), EXPLAINED) - 1.0)
    return saved.size > 1 and bool(worthwhile(saved, misfit, limits))


def has_memory(problem: Problem, hypothesis: Hypothesis) -> bool:
    """Tests whether the errors of a hypothesis are correlated but not functions of the motion.

    Whitened errors of a correct model are independent. If errors of neighbouring bins correlate, an
    effect is missing; if static functions explain little, this effect depends on the past.
    """
    residual = problem.residual(hypothesis).reshape(problem.replay.windows, -1, problem.replay.bins)
    own = residual / (np.sqrt(np.mean(residual**2, axis=(1, 2), keepdims=True)) + 1e-300)
    alike = float(np.mean(own[:, :, 1:] * own[:, :, :-1]) / np.mean(own**2))
    share = EXPLANATION
    return alike > ALIKE and all(form.gain < share for form in find_forms(problem, hypothesis))


def open_directions(form: Form, most: int) -> np.ndarray:
    """Returns up to `most` principal directions of the estimates, one standard deviation long."""
    scale = np.sqrt(np.maximum(np.diag(form.covariance), 1e-300))
    values, vectors = np.linalg.eigh(form.covariance / np.outer(scale, scale))
    order = np.argsort(-values)[:most]
    return np.asarray(scale[:, None] * vectors[:, order] * np.sqrt(np.maximum(values[order], 0.0)))


def with_parts(problem: Problem, parts: Sequence[Part]) -> Problem:
    """Returns a copy of the problem with learned parts in all hypotheses."""
    other = copy(problem)
    other.library = LearnedLibrary(problem.library, parts)
    return other


def refine(
    problem: Problem, hypothesis: Hypothesis, forms: Sequence[Form], fixed: frozenset[Key]
) -> tuple[tuple[Part, ...], Hypothesis]:
    """Fits coefficients of forms (along principal directions) and nuisance parameters to replays.

    Effects in `fixed` do not change. Returns the parts in the order of the forms, each bounded
    slightly above its largest value on the data, and the hypothesis with the nuisance parameters.
    """
    problem, limits = copy(problem), problem.thresholds
    chosen = thinned(problem.fitted, limits.learned_windows)
    each = max(3, limits.learned_directions // len(forms))
    along = [open_directions(form, each) for form in forms]
    ends = np.cumsum([one.shape[1] for one in along])
    u = Unknowns.of(problem.library)
    # Parameters with a tolerance, which differ between good machines, are refitted.
    loose = [i for i in range(u.single) if u.tolerance[i] > 0.0 and u.keys[i] not in fixed]
    count, z, base = ends[-1], np.zeros(ends[-1]), hypothesis

    def parts(z: np.ndarray) -> tuple[Part, ...]:
        rows = zip(forms, along, np.split(z, ends[:-1]), strict=True)
        return tuple(form.part(form.values + axes @ own) for form, axes, own in rows)

    def moved(step: np.ndarray) -> tuple[np.ndarray, Hypothesis, np.ndarray]:
        """Returns `z` and the hypothesis after a step, and their departures from prior means."""
        by = dict(zip(loose, (step[count:] * u.tolerance[loose]).tolist(), strict=True))
        new = z + step[:count], u.moved(base, by)
        eta = u.departures(new[1])[loose] / u.tolerance[loose]
        return *new, np.concatenate([new[0], eta])

    def errors(z: np.ndarray, base: Hypothesis) -> np.ndarray:
        return with_parts(problem, parts(z)).residual(base, chosen)

    def cost(residual: np.ndarray, departed: np.ndarray, scale: float) -> float:
        squares = np.mean(residual**2, axis=1) / scale**2
        told = residual.shape[1] * robust_cost(squares, limits.robust_limit).sum()
        return float(told + departed @ departed)

    for iteration in range(4):
        # A noise model without the learned parts misjudges the growth of start-state errors.
        if iteration < 2:
            problem.noise = with_parts(problem, parts(z)).about(base).noise
        residual, (_, _, offset) = errors(z, base), moved(np.zeros(count + len(loose)))
        # Finite differences over half a standard deviation of the estimates or half a tolerance.
        probes = (moved(0.5 * row)[:2] for row in np.eye(offset.size))
        columns = [(errors(*probe) - residual) / 0.5 for probe in probes]
        step, scale = _step(residual, np.stack(columns, axis=2), offset, limits.robust_limit)
        before = cost(residual, offset, scale)
        for share in 0.4 ** np.arange(5):
            new_z, new_base, departed = moved(share * step)
            after = cost(errors(new_z, new_base), departed, scale)
            if after < before:
                break
        else:
            break
        z, base = new_z, new_base
        if before - after < 1e-2 * before:
            break
    return tuple(map(_within_data, parts(z), forms)), base


def _within_data(part: Part, form: Form) -> Part:
    """Returns a part that is bounded slightly above its largest value on the data of its form."""
    reach = float(np.max(np.abs(part.at(form.balance.inputs))))
    return replace(part, bound=1.05 * reach) if reach > 0.0 else part


def _step(
    residual: np.ndarray, jacobian: np.ndarray, offset: np.ndarray, limit: float
) -> tuple[np.ndarray, float]:
    """Computes a robust step, in standard deviations of priors, and the scale of remaining errors.

    A model that is also wrong in other ways leaves errors of many noise levels. So errors are
    divided by the RMS error of the median window after the step (Kennedy and O'Hagan 2001).
    """
    matrices = jacobian.transpose(0, 2, 1) @ jacobian
    rights = np.einsum("wnk,wn->wk", jacobian, residual)
    x, scale = np.zeros(offset.size), 1.0
    for _ in range(6):
        squares = np.mean((residual + jacobian @ x) ** 2, axis=1)
        scale = max(1.0, float(np.sqrt(np.median(squares))))
        weight = robust_weight(squares / scale**2, limit) / scale**2
        matrix = np.einsum("w,wij->ij", weight, matrices) + np.eye(offset.size)
        x = np.linalg.solve(matrix, -(weight @ rights + offset))
    return x, scale
