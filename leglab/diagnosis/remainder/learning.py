"""Learns what no effect explains: a static remainder from the balances, refined by replay."""

from collections.abc import Callable, Collection
from copy import copy
from dataclasses import asdict, dataclass
from typing import Any

import mujoco
import numpy as np

from leglab.diagnosis.balance.balances import balances
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.plant.model import CYLINDER
from leglab.diagnosis.remainder.forms import Form, choose_form, worthwhile
from leglab.diagnosis.remainder.part import Part
from leglab.diagnosis.remainder.refining import refine, with_parts
from leglab.diagnosis.remainder.words import Described, describe
from leglab.diagnosis.replay.residual import Problem, robust_cost
from leglab.diagnosis.result import closed
from leglab.diagnosis.thresholds import ALIKE, Thresholds

# What is said where the rest is large and no static function of the moment.
MEMORY_WORDS = "What is left has a memory: delay, play or flexibility are suspects"


@dataclass(frozen=True, kw_only=True, eq=False)
class Remainder:
    """A learned static remainder, its gain proved on held-out recordings.

    Attributes:
        parts: Forces of joints and command offsets of cylinders.
        hypothesis: Replaces the one beside which it was learned, nuisances refitted.
        problem: With the parts in every hypothesis, noise model about the end.
        closed_fraction: (before - after) / (before - 1) of the held-out RMS in noise levels.
        memory: Whether what is left has a memory.
    """

    parts: tuple[Part, ...]
    hypothesis: Hypothesis
    described: tuple[Described, ...]
    problem: Problem
    closed_fraction: float
    memory: bool

    def write(self, spec: mujoco.MjSpec) -> None:
        """Adds its plugin instances to a specification."""
        for part in self.parts:
            part.write(spec)

    @property
    def words(self) -> str:
        """One or two sentences."""
        text = "; ".join(d.text for d in self.described)
        return f"{text}. {MEMORY_WORDS}" if self.memory else text

    def to_json(self) -> dict[str, Any]:
        """What improvement.json tells of it."""
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
    """Learns a static remainder beside a hypothesis; None where no gain was proved.

    Additive splines are fitted to the balances of forces and oil along the measured motion, and
    refined by replays together with the nuisances. What does not pay on held-out recordings is
    left out.

    Args:
        problem: Without held-out windows nothing can be proved.
        hypothesis: Named effects and nuisances.
        named: Effects whose values stay; None for all that are not nuisances.
        progress: Called with what is being done.
    """
    held, sites = problem.held, problem.library.sites
    if not held.any():
        return None
    if problem.window_cost(hypothesis)[held].mean() < problem.thresholds.explained:
        return None
    if named is None:
        named = [k for k in hypothesis if all(p.tolerance == 0.0 for p in sites[k].parameters)]
    keep = frozenset(named)
    # Nuisances that a missing force has pulled along hide it: begin without, or with them.
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
    """Forms of all balances' remainders, by windows of fitted recordings in which joints move."""
    machine, limits = problem.machine, problem.thresholds
    fitted = np.unique(problem.replay.recording[problem.fitted])
    by_oil = {j for cylinder in machine.instances(CYLINDER) for j in machine.driven[cylinder]}
    forms = (
        choose_form(
            balance.of(balance.moving & np.isin(balance.recording, fitted)),
            driven_by_oil=balance.joint in by_oil,
            limits=limits,
        )
        for balance in balances(problem, hypothesis)
    )
    return tuple(form for form in forms if form is not None)


def _proved(
    problem: Problem, without: Hypothesis, beside: Hypothesis, learned: list[tuple[Part, Form]]
) -> Remainder | None:
    """What pays on held-out recordings, beside a hypothesis and against one without it."""
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
    rms = [float(np.sqrt(np.mean(s[held]))) for s in (before, after)]
    if not pays(before[held], after[held], limits) or rms[1] >= rms[0]:
        return None
    final = joined(learned).about(beside)
    cost = float(robust_cost(after, limits.robust_limit).mean())
    return Remainder(
        parts=tuple(part for part, _ in learned),
        hypothesis=beside,
        described=tuple(
            describe(part, form.balance.inputs, problem.machine.unit(part.joint))
            for part, form in learned
        ),
        problem=final,
        closed_fraction=closed(*rms) or 0.0,
        memory=cost > limits.explained and has_memory(final, beside),
    )


def pays(before: np.ndarray, after: np.ndarray, limits: Thresholds) -> bool:
    """Whether mean squares of held-out windows fall by a share of the misfit, beyond chance."""
    cost = robust_cost(before, limits.robust_limit)
    saved = cost - robust_cost(after, limits.robust_limit)
    misfit = saved.size * (max(float(cost.mean()), limits.explained) - 1.0)
    return saved.size > 1 and bool(worthwhile(saved, misfit, limits))


def has_memory(problem: Problem, hypothesis: Hypothesis) -> bool:
    """Whether what a hypothesis leaves lasts and is no function of the moment.

    Whitened errors of a right model are independent; what lasts makes neighbouring bins err alike.
    If static functions explain little of the balances, what is missing depends on the past.
    """
    residual = problem.residual(hypothesis).reshape(problem.replay.windows, -1, problem.replay.bins)
    own = residual / (np.sqrt(np.mean(residual**2, axis=(1, 2), keepdims=True)) + 1e-300)
    alike = float(np.mean(own[:, :, 1:] * own[:, :, :-1]) / np.mean(own**2))
    share = problem.thresholds.explanation_share
    return alike > ALIKE and all(form.gain < share for form in find_forms(problem, hypothesis))
