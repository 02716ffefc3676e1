"""A better model from recordings: effects that are sure, and a learned remainder."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leglab.base.recording import Recording
from leglab.base.threads import one_blas_thread
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.effects.joints import unit
from leglab.diagnosis.intake.recordings import split_held_out
from leglab.diagnosis.remainder.learning import (
    Remainder,
    closed,
    has_memory,
    learn_remainder,
    memory_words,
    pays,
)
from leglab.diagnosis.replay.residual import Problem, robust_cost
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.verdict.output import write_model
from leglab.diagnosis.verdict.verdict import Outcome, diagnose

# An effect is written into the model from this confidence on.
_SURE = 0.8


@dataclass(frozen=True, kw_only=True)
class ReplayError:
    """Replay errors of one recording, before and after.

    Attributes:
        recording: Its name.
        held_out: Whether no fit has seen it.
        noise_levels: RMS of whitened errors; noise alone gives 1.
        at_horizon: RMS error at the end of the windows by channel [rad, m or Pa].
    """

    recording: str
    held_out: bool
    noise_levels: tuple[float, float]
    at_horizon: dict[str, tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class Improvement:
    """An improved model, or the statement that nothing improves it.

    Attributes:
        improved: Whether a gain was proved on held-out recordings.
        words: What was learned, or why nothing was.
        effects: Parameters of the named effects in the model, by "effect at element".
        remainder: As `Remainder.to_json`; None for none.
        closed_fraction: (before - after) / (before - 1) of the held-out RMS in noise levels.
        horizon: Length of the replayed windows [s].
        recordings: Errors.
        units: Of the channels.
        model: File name of the improved model; None where there is none.
    """

    improved: bool
    words: str
    effects: dict[str, dict[str, float]]
    remainder: dict[str, Any] | None
    closed_fraction: float
    horizon: float
    recordings: tuple[ReplayError, ...]
    units: dict[str, str]
    model: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Returns the content of improvement.json."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True, eq=False)
class ImprovedModel:
    """What the improved model is made of.

    Attributes:
        problem: Recordings and machine.
        hypothesis: Effects and refitted nuisances.
        remainder: Learned; None for none.
    """

    problem: Problem
    hypothesis: Hypothesis
    remainder: Remainder | None

    def __repr__(self) -> str:
        return f"ImprovedModel({self.learned or 'nothing learned'})"

    @property
    def learned(self) -> str:
        """What was learned beside the effects, in words; empty for nothing."""
        return self.remainder.words if self.remainder else ""

    @property
    def errors(self) -> tuple[float, ...]:
        """RMS error at the end of held-out windows by channel [rad, m or Pa].

        With what was learned; empty where nothing was.
        """
        if self.remainder is None:
            return ()
        problem = self.remainder.problem
        ends = problem.raw_errors(self.hypothesis)[problem.judged][:, :, -1]
        return tuple(np.sqrt(np.mean(ends**2, axis=0)).tolist())

    def write(self, folder: Path) -> Path:
        """Writes DIR/improved.xml."""
        parts = self.remainder.parts if self.remainder else ()
        return write_model(self.problem, self.hypothesis, folder, parts)


def write_improved(found: Outcome, folder: Path) -> Path | None:
    """Writes DIR/improved.xml, as the command does; None where nothing improves the model.

    Raises:
        LeglabError: MuJoCo refuses the patched model.
    """
    better = improved_model(found)
    return None if better is None else better.write(folder)


@one_blas_thread()
def improved_model(
    found: Outcome, progress: Callable[[str], None] = lambda _: None
) -> ImprovedModel | None:
    """The model that a diagnosis leaves: recalibrated, with what has a name, and with a remainder.

    An effect without a name is no improvement, however well it fits. A remainder is learned where
    much is left. None where the held-out recordings are not met better than by the model as it was.
    """
    limits, result = found.problem.thresholds, found.result
    told = {(e.name, e.element) for e in (*result.effects, *result.smaller)}
    named = tuple(key for key in found.named if key in told and result.verdict == "named")
    problem, final = _recalibrated(found, named)
    remainder = None
    more_than_noise = result.gap.after > limits.explained
    much_left = (result.gap.explained or 0.0) < limits.well_explained
    if result.verdict != "nothing_missing" and more_than_noise and much_left:
        remainder = learn_remainder(problem, final, named=named, progress=progress)
    before = problem.noise_levels(problem.library.neutral())
    after = problem.noise_levels(final)
    if remainder:
        final, after = remainder.hypothesis, remainder.problem.noise_levels(remainder.hypothesis)
    judged = problem.judged
    if after[judged].mean() >= limits.improvement**2 * before[judged].mean():
        return None
    return ImprovedModel(problem=problem, hypothesis=final, remainder=remainder)


def _recalibrated(found: Outcome, named: Sequence[Key]) -> tuple[Problem, Hypothesis]:
    """The model with some of the named effects, and what has a tolerance where it fits best."""
    return found.problem, found.written.without(*(k for k in found.named if k not in named))


@one_blas_thread()
def improve(
    model: str | Path,
    recordings: Mapping[str, Recording],
    *,
    held_out: Iterable[str] | None = None,
    effects: bool = True,
    settings: DiagnosisSettings | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Improvement, ImprovedModel | None]:
    """Improves a model by recordings.

    Args:
        model: MJCF file, or the name of a model that ships with leglab.
        recordings: By name.
        held_out: Names of those on which the gain is proved; None for the choice of
            `split_held_out`.
        effects: Whether effects are looked for first; those of confidence 0.8 are kept.
        settings: Of the diagnosis.
        progress: Called with a line on what is being done.

    Returns:
        What was reached, and the improved model; None where nothing improves on held-out
        recordings.

    Raises:
        LeglabError: Model or recordings cannot be used.
    """
    settings = settings or DiagnosisSettings()
    if held_out is None:
        recordings, held_out = split_held_out(model, recordings, (), settings.thresholds)
    held_out = tuple(held_out)
    sure: tuple[Key, ...] = ()
    if effects:
        result, found = diagnose(
            model, recordings, held_out=held_out, settings=settings, progress=progress
        )
        certain = {(e.name, e.element) for e in result.effects if e.confidence >= _SURE}
        sure = tuple(key for key in found.named if key in certain)
        problem, hypothesis = _recalibrated(found, sure)
    else:
        problem, hypothesis = set_up(model, recordings, held_out, settings), Hypothesis()
    remainder = learn_remainder(problem, hypothesis, named=sure, progress=progress)
    final = remainder.hypothesis if remainder else hypothesis
    judged = problem.about(final)
    after_problem = judged
    if remainder:
        after_problem = remainder.problem
        judged.noise = remainder.problem.noise
    squares = [
        np.mean(p.residual(h) ** 2, axis=1)
        for p, h in ((judged, judged.library.neutral()), (after_problem, final))
    ]
    held = problem.judged
    limits = problem.thresholds
    improved = (
        bool(problem.held.any())
        and float(robust_cost(squares[0][held], limits.robust_limit).mean()) >= limits.explained
        and pays(squares[0][held], squares[1][held], limits)
    )
    if not improved:
        remainder, final, after_problem = None, judged.library.neutral(), judged
        squares[1] = squares[0]
    rms = [float(np.sqrt(s[held].mean())) for s in squares]
    outcome = Improvement(
        improved=improved,
        words=_words(after_problem, final, remainder, sure if improved else (), squares, held),
        effects={
            f"{key[0]} at {key[1]}": problem.library.sites[key].named(final[key])
            for key in (sure if improved else ())
        },
        remainder=remainder.to_json() if remainder else None,
        closed_fraction=closed(*rms),
        horizon=problem.replay.window,
        recordings=_errors(judged, after_problem, final, squares),
        units={
            c.column: "Pa" if c.chamber else unit(problem.machine, c.joint)
            for c in problem.channels
        },
    )
    if not improved:
        return outcome, None
    return outcome, ImprovedModel(problem=problem, hypothesis=final, remainder=remainder)


def _words(
    problem: Problem,
    final: Hypothesis,
    remainder: Remainder | None,
    sure: tuple[Key, ...],
    squares: list[np.ndarray],
    held: np.ndarray,
) -> str:
    limits = problem.thresholds
    cost = float(robust_cost(squares[1], limits.robust_limit)[held].mean())
    memory = cost > limits.explained and (remainder is None) and has_memory(problem, final)
    parts = [f"{name} at {element}" for name, element in sure]
    if remainder:
        parts.append(remainder.words)
    if parts:
        return "Added: " + "; ".join(parts) + "."
    text = "Recalibrated within tolerances; no further static force improves it."
    if squares[0] is squares[1]:
        text = "Nothing improves the model on held-out recordings"
        text += ": it explains them." if cost <= limits.explained else "."
    if memory:
        text += f" {memory_words()}."
    return text


def _errors(
    before: Problem, after: Problem, final: Hypothesis, squares: list[np.ndarray]
) -> tuple[ReplayError, ...]:
    ends = [
        p.raw_errors(h)[:, :, -1] for p, h in ((before, before.library.neutral()), (after, final))
    ]
    out = []
    for i, series in enumerate(before.series):
        own = before.replay.recording == i
        if not own.any():
            continue
        levels = [float(np.sqrt(s[own].mean())) for s in squares]
        at_end = [np.sqrt((e[own] ** 2).mean(axis=0)).tolist() for e in ends]
        out.append(
            ReplayError(
                recording=series.name,
                held_out=bool(before.held[own].any()),
                noise_levels=(levels[0], levels[1]),
                at_horizon={
                    c.column: (at_end[0][k], at_end[1][k]) for k, c in enumerate(before.channels)
                },
            )
        )
    return tuple(out)
