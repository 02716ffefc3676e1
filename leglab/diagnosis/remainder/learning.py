"""Learns what no effect explains: a static remainder from the balances, refined by replay."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from leglab.diagnosis.balance.balances import balances
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.effects.joints import unit
from leglab.diagnosis.plant.model import CYLINDER
from leglab.diagnosis.remainder.forms import Form, choose_form, usable
from leglab.diagnosis.remainder.part import Part
from leglab.diagnosis.remainder.refining import Directions, Refined, bounded, refine, with_parts
from leglab.diagnosis.remainder.words import Described, describe
from leglab.diagnosis.replay.residual import Problem, robust_cost, thinned

# Windows to which replays are fitted.
_WINDOWS = 60
# A remainder must save this share of the held-out misfit, ...
_WORTHWHILE = 0.1
# ... a part of it this, with this t value over held-out windows.
_PART_WORTHWHILE = 0.02
_SIGNIFICANT = 2.5
# Below this cost nothing more is to be learned: noise alone gives 1.
CLEAN = 1.25
# Correlation of whitened errors in neighbouring bins that last.
_LASTING = 0.3
# Share of a balance's squares from which on static functions explain it.
_STATIC = 0.5

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Remainder:
    """A learned static remainder, its gain proved on held-out recordings.

    Attributes:
        parts: Forces of joints and command offsets of cylinders.
        hypothesis: The hypothesis beside it, nuisances refitted: it replaces the one given.
        described: The parts in words.
        problem: With the parts in every hypothesis, noise model about the end.
        before: Robust mean square of every window without it, (windows,).
        after: With it, (windows,).
        closed_fraction: (before - after) / (before - 1) of the RMS of whitened errors in held-out
            windows.
        memory: Whether what is left has a memory.
    """

    parts: tuple[Part, ...]
    hypothesis: Hypothesis
    described: tuple[Described, ...]
    problem: Problem
    before: np.ndarray
    after: np.ndarray
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
        if self.memory:
            text += ". " + memory_words()
        return text

    def to_json(self) -> dict[str, Any]:
        """Returns what is known of it as JSON can hold it."""
        return {
            "words": self.words,
            "closed_fraction": self.closed_fraction,
            "memory": self.memory,
            "parts": [
                {**d.to_json(), "plugin": part.name, "attributes": part.config()}
                for d, part in zip(self.described, self.parts, strict=True)
            ],
        }


def memory_words() -> str:
    """What is said where the rest is large and no static function of the moment."""
    return "What is left has a memory: delay, play or flexibility are suspects"


def learn_remainder(
    problem: Problem,
    hypothesis: Hypothesis,
    *,
    named: Collection[Key] | None = None,
    progress: Progress = lambda _: None,
) -> Remainder | None:
    """Learns a static remainder beside a hypothesis.

    Additive splines are fitted to the balances of forces and oil along the measured motion, and
    refined by replays together with the nuisances. What does not pay on held-out recordings is
    left out.

    Args:
        problem: Recordings and machine; without held-out windows nothing can be proved.
        hypothesis: Named effects and nuisances.
        named: Effects of it that were named, whose values stay; None for all that are not
            nuisances.
        progress: Called with what is being done.

    Returns:
        None where no gain was proved.
    """
    if not problem.held.any() or problem.window_cost(hypothesis)[problem.held].mean() < CLEAN:
        return None
    if named is None:
        sites = problem.library.sites
        named = [k for k in hypothesis if all(p.tolerance == 0.0 for p in sites[k].parameters)]
    keep = frozenset(named)
    chosen = thinned(problem.fitted, _WINDOWS)
    best: tuple[float, Hypothesis, tuple[Form, ...]] | None = None
    # Nuisances that a missing force has pulled along hide it: begin without, or with them.
    starts = [hypothesis.only(keep)]
    if set(hypothesis) != set(keep):
        starts.append(hypothesis)
    for start in starts:
        progress("balances of force and oil")
        forms = find_forms(problem, start)
        if not forms:
            continue
        directions = Directions.of(forms)
        there = with_parts(problem, directions.parts(np.zeros(directions.count)))
        cost = float(there.window_cost(start)[problem.fitted].mean())
        if best is None or cost < best[0]:
            best = cost, start, forms
    if best is None:
        return None
    progress("refining what was learned by replay")
    _, start, forms = best
    refined = refine(problem, start, forms, chosen, free=keep)
    by_name = {(f.balance.element, f.balance.oil): f for f in forms}

    def form_of(part: Part) -> Form:
        return by_name[part.element, part.oil]

    parts = [bounded(part, form_of(part)) for part in refined.parts]
    progress("proof on held-out recordings")
    return _proved(problem, hypothesis, refined, parts, form_of)


def find_forms(problem: Problem, hypothesis: Hypothesis) -> tuple[Form, ...]:
    """Forms of all balances' remainders under a hypothesis, by the fitted recordings."""
    machine = problem.machine
    fitted = np.unique(problem.replay.recording[problem.fitted]).tolist()
    by_oil = {j for cylinder in machine.instances(CYLINDER) for j in machine.driven[cylinder]}
    found = []
    for balance in balances(problem, hypothesis):
        part = balance.of(usable(balance, fitted))
        form = choose_form(part, driven_by_oil=balance.joint in by_oil)
        if form is not None:
            found.append(form)
    return tuple(found)


def _proved(
    problem: Problem,
    hypothesis: Hypothesis,
    refined: Refined,
    parts: list[Part],
    form_of: Callable[[Part], Form],
) -> Remainder | None:
    final = with_parts(problem, parts).about(refined.hypothesis)
    held, limit = problem.held, problem.thresholds.robust_limit

    def squares(some: Sequence[Part], under: Hypothesis) -> np.ndarray:
        there = with_parts(problem, some)
        there.noise = final.noise
        return np.asarray(np.mean(there.residual(under) ** 2, axis=1))

    before = squares((), hypothesis)
    after = squares(parts, refined.hypothesis)
    for part in [*parts] if len(parts) > 1 else ():
        others = [p for p in parts if p is not part]
        without = squares(others, refined.hypothesis)
        if not pays(without[held], after[held], limit, _PART_WORTHWHILE):
            parts, after = others, without
    if not pays(before[held], after[held], limit, _WORTHWHILE):
        return None
    rms = [float(np.sqrt(np.mean(s[held]))) for s in (before, after)]
    if rms[1] >= rms[0]:
        return None
    final = with_parts(problem, parts)
    noise = final.about(refined.hypothesis).noise
    final.noise = noise
    units = [unit(problem.machine, p.joint) for p in parts]
    cost = float(robust_cost(after, limit).mean())
    return Remainder(
        parts=tuple(parts),
        hypothesis=refined.hypothesis,
        described=tuple(
            describe(p, form_of(p).balance.inputs, u) for p, u in zip(parts, units, strict=True)
        ),
        problem=final,
        before=robust_cost(before, limit),
        after=robust_cost(after, limit),
        closed_fraction=closed(*rms),
        memory=cost > problem.thresholds.explained and has_memory(final, refined.hypothesis),
    )


def closed(before: float, after: float) -> float:
    """Share of a gap in noise levels that is closed; 0 where there was none."""
    return (before - after) / (before - 1.0) if before > 1.05 else 0.0


def pays(before: np.ndarray, after: np.ndarray, limit: float, share: float) -> bool:
    """Whether mean squares of held-out windows fall by a share of the misfit, beyond chance."""
    saved = robust_cost(before, limit) - robust_cost(after, limit)
    if saved.size < 2:
        return False
    spread = float(saved.std(ddof=1)) / np.sqrt(saved.size)
    excess = max(float(robust_cost(before, limit).mean()) - 1.0, CLEAN - 1.0)
    mean = float(saved.mean())
    return bool(mean > _SIGNIFICANT * spread and mean > share * excess)


def has_memory(problem: Problem, hypothesis: Hypothesis) -> bool:
    """Whether what a hypothesis leaves is far from noise, lasting, and no function of the moment.

    Whitened errors of a right model do not depend on each other; what lasts makes neighbouring bins
    err alike. If static functions explain little of the balances, then what is missing depends on
    what was before.
    """
    residual = problem.residual(hypothesis).reshape(problem.replay.windows, -1, problem.replay.bins)
    own = residual / (np.sqrt(np.mean(residual**2, axis=(1, 2), keepdims=True)) + 1e-300)
    alike = float(np.mean(own[:, :, 1:] * own[:, :, :-1]) / np.mean(own**2))
    if alike < _LASTING:
        return False
    return all(form.gain < _STATIC for form in find_forms(problem, hypothesis))
