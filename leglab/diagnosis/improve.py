"""Improvement of a model by recordings: effects of high confidence, and learned static forces."""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from leglab.base.output import piece
from leglab.base.recording import Recording
from leglab.base.scale import rms
from leglab.base.threads import one_blas_thread
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.intake.recordings import split_held_out
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.remainder.learning import (
    MEMORY_WORDS,
    Remainder,
    has_memory,
    learn_remainder,
    pays,
)
from leglab.diagnosis.replay.residual import Problem, robust_cost, thinned
from leglab.diagnosis.result import Estimate, Moved, NamedEffect, closed, root_mean
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.thresholds import EXPLAINED, SMALL, WINDOWS
from leglab.diagnosis.verdict.outcome import Outcome
from leglab.diagnosis.verdict.output import write_model
from leglab.diagnosis.verdict.verdict import diagnose


@dataclass(frozen=True, kw_only=True)
class ReplayError:
    """Replay errors of one recording, before and after the improvement."""

    recording: str
    held_out: bool  #: Whether no fit has used the recording
    noise_levels: tuple[float, float]  #: RMS of whitened errors; noise alone gives 1
    #: RMS error at the end of the windows by channel [rad, m or Pa].
    at_horizon: dict[str, tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class Improvement:
    """Summary of an improved model, or of the finding that nothing improves the model."""

    improved: bool  #: Whether a gain was proved on held-out recordings
    words: str  #: The learned effects and remainder in words, or why nothing was learned
    #: Parameters of the named effects in the model, by "effect at element".
    effects: dict[str, dict[str, float]]
    remainder: dict[str, Any] | None  #: As `Remainder.to_json`; None if none was learned
    closed_fraction: float  #: (before - after) / (before - 1) of the held-out RMS in noise levels
    horizon: float  #: Length of the replayed windows [s]
    recordings: tuple[ReplayError, ...]
    units: dict[str, str]  #: Units of the channels
    model: str | None = None  #: File name of the improved model; None if it does not exist
    #: Reasons why parts of the result are missing, by part (`leglab.base.output.piece`).
    missing: dict[str, str] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Returns the content of improvement.json."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True, eq=False)
class ImprovedModel:
    """Parts of the improved model."""

    problem: Problem  #: Recordings and machine, without the learned remainder
    hypothesis: Hypothesis  #: Named effects, and parameters moved noticeably within tolerances
    named: tuple[Key, ...]
    remainder: Remainder | None  #: Learned remainder; None if none was learned

    def __repr__(self) -> str:
        return f"ImprovedModel({self.learned or 'nothing learned'})"

    @property
    def learned(self) -> str:
        """Description of the learned remainder; empty if there is none."""
        return self.remainder.words if self.remainder else ""

    @property
    def errors(self) -> tuple[float, ...]:
        """RMS errors at the end of held-out windows by channel [SI]; empty without a remainder."""
        if self.remainder is None:
            return ()
        problem = self.remainder.problem
        ends = problem.raw_errors(self.hypothesis)[problem.judged]
        return tuple(_at_ends(ends))

    @property
    def moved(self) -> tuple[Moved, ...]:
        """Parameters of effects that are not named, if they moved within their tolerances."""
        library, found = self.problem.library, []
        for key, values in sorted(library.whole(self.hypothesis).items()):
            site = library.sites[key]
            for p, value, own in zip(site.parameters, values.tolist(), site.model, strict=True):
                if p.tolerance > 0.0 and value != own and key not in self.named:
                    there = Estimate(
                        name=p.name,
                        value=value,
                        unit=p.unit,
                        interval=p.usual(own),
                        nominal=float(own),
                    )
                    share = (value - float(own)) / p.tolerance
                    found.append(Moved(effect=key[0], element=key[1], estimate=there, share=share))
        return tuple(found)

    def write(self, folder: Path) -> tuple[Path, tuple[str, ...]]:
        """Writes DIR/improved.xml; returns its path, and its differences as a unified diff."""
        parts = self.remainder.parts if self.remainder else ()
        return write_model(self.problem, self.hypothesis, folder, parts)


def write_improved(found: Outcome, folder: Path) -> Path | None:
    """Writes DIR/improved.xml like the command; returns None if nothing improves the model.

    Raises:
        LeglabError: MuJoCo refuses the patched model.
    """
    better = improved_model(found)
    return None if better is None else better.write(folder)[0]


@one_blas_thread()
def improved_model(
    found: Outcome, progress: Callable[[str], None] = lambda _: None
) -> ImprovedModel | None:
    """Returns a diagnosis's recalibrated model with the named effects and a learned remainder.

    Effects that were fitted but not named are left out. A remainder (static forces that no effect
    describes) is learned if much error is left. None if the original model replays as well.
    """
    problem, result = found.problem, found.result
    limits = problem.thresholds
    told = (*result.effects, *result.smaller)
    named, final = _recalibrated(found, told if result.verdict == "named" else ())
    remainder = None
    little = (result.gap.explained or 0.0) < 1.0 - SMALL
    if result.verdict != "nothing_missing" and little and result.gap.after > EXPLAINED:
        with piece("remainder", result.missing):
            remainder = learn_remainder(problem, final, named=named, progress=progress)
    better = remainder.problem if remainder else problem
    final = _noticeable(better, remainder.hypothesis if remainder else final, named)
    before, after = problem.noise_levels(problem.library.neutral()), better.noise_levels(final)
    if not pays(before[problem.judged], after[problem.judged], limits):
        return None
    return ImprovedModel(problem=problem, hypothesis=final, named=named, remainder=remainder)


def _recalibrated(
    found: Outcome, kept: Iterable[NamedEffect]
) -> tuple[tuple[Key, ...], Hypothesis]:
    """Returns the keys of kept effects, and the written hypothesis without other named effects."""
    told = {(e.name, e.element) for e in kept}
    named = tuple(key for key in found.named if key in told)
    return named, found.written.without(*(set(found.named) - set(named)))


def _noticeable(problem: Problem, fitted: Hypothesis, named: tuple[Key, ...]) -> Hypothesis:
    """Restores the model's values of unnamed parameters whose change the errors hardly show.

    Backward elimination: parameters return to the model's value one by one. The next is the one
    that costs least after the others are refitted by linearised errors. The elimination ends before
    the replay errors of the fitted windows grow by more than a tenth.
    """
    library, chosen = problem.library, thinned(~problem.held, WINDOWS)
    whole = library.whole(fitted)
    moved = [
        (key, i, value, own, p.tolerance)
        for key, values in sorted(whole.items())
        for i, p in enumerate(library.sites[key].parameters)
        for value, own in [(float(values[i]), float(library.sites[key].model[i]))]
        if value != own and key not in named
    ]

    def at(back: np.ndarray) -> Hypothesis:
        """Returns the hypothesis with each parameter moved back by a share of its change."""
        values = {key: whole[key].copy() for key in {*fitted, *(key for key, *_ in moved)}}
        for share, (key, i, value, own, _) in zip(back.tolist(), moved, strict=True):
            values[key][i] = own if share == 1.0 else value + share * (own - value)
        kept = {k: v for k, v in values.items() if k in fitted or (v != whole[k]).any()}
        return Hypothesis(kept, fitted.onsets)

    def errors(back: np.ndarray) -> np.ndarray:
        return problem.residual(at(back), chosen)

    def level(back: np.ndarray) -> float:
        return root_mean(problem.noise_levels(at(back))[~problem.held])

    count = len(moved)
    if not count:
        return fitted
    stay = np.zeros(count)
    before = errors(stay).ravel()
    columns = np.stack([errors(one).ravel() - before for one in np.eye(count)], axis=1)
    # Departures in multiples of the tolerance; the departure counts as 1 without a tolerance.
    away = np.array([(v - own) / (tolerance or abs(v - own)) for _, _, v, own, tolerance in moved])
    paths = [stay, *_going_back(before, columns, away)]
    limit = (1.0 + SMALL) * level(stay)
    least = bisect_left(range(count), True, key=lambda k: level(paths[k + 1]) > limit)
    return at(paths[least])


def _going_back(before: np.ndarray, columns: np.ndarray, away: np.ndarray) -> Iterator[np.ndarray]:
    """Yields shares by which parameters go back to the model's values, with one more share of 1.

    Args:
        before: Errors before any parameter goes back, (errors,).
        columns: Change of the errors if a parameter alone goes back, (errors, parameters).
        away: Each parameter's departure from the model, in tolerances, (parameters,).

    Yields:
        Shares, (parameters,).
    """
    # Half the sum of squared errors and departures is x'Hx/2 - s'x + const for shares x. To set x_i
    # to 1 and refit the others adds half of (1 - x_i)^2/(H^-1)_ii to the minimum over x.
    curvature = columns.T @ columns + np.diag(away**2)
    slope = away**2 - columns.T @ before
    kept = np.ones(away.size, dtype=bool)
    while True:
        inverse = np.linalg.inv(curvature[np.ix_(kept, kept)])
        share = np.ones(away.size)
        share[kept] = inverse @ (slope[kept] - curvature[np.ix_(kept, ~kept)].sum(axis=1))
        if not kept.all():
            # Clipped, because with a share below 0 a parameter could imitate a missing effect.
            yield np.clip(share, 0.0, 1.0)
        if not kept.any():
            return
        cost = (1.0 - share[kept]) ** 2 / np.diag(inverse)
        kept[np.flatnonzero(kept)[np.argmin(cost)]] = False


@one_blas_thread()
def improve(
    model: str | Path | Machine,
    recordings: Mapping[str, Recording],
    *,
    held_out: Iterable[str] | None = None,
    effects: bool = True,
    settings: DiagnosisSettings | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Improvement, ImprovedModel | None]:
    """Improves a model by recordings; the improved model is None if nothing improves the model.

    Args:
        model: MJCF file, the name of a model that ships with leglab, or its machine.
        recordings: By name.
        held_out: Recordings by which the gain is judged; None for the choice of `split_held_out`.
        effects: Whether to search for effects first and keep those of confidence >= 0.8.
        settings: Settings of the diagnosis.
        progress: Called with a line of text on the present step.

    Raises:
        LeglabError: Model or recordings cannot be used.
    """
    settings = settings or DiagnosisSettings()
    limits = settings.thresholds
    if held_out is None:
        recordings, held_out = split_held_out(model, recordings, (), limits)
    problem, sure, final = _begun(
        model, recordings, tuple(held_out), settings, progress, effects=effects
    )
    missing: dict[str, str] = {}
    remainder = None
    with piece("remainder", missing):
        remainder = learn_remainder(problem, final, named=sure, progress=progress)
    after = remainder.problem if remainder else problem.about(final)
    final = _noticeable(after, remainder.hypothesis if remainder else final, sure)
    before = copy(problem)
    before.noise = after.noise
    pairs, held = [(before, before.library.neutral()), (after, final)], problem.held
    squares = [p.noise_levels(h) for p, h in pairs]
    costs = [float(robust_cost(s[held], limits.robust_limit).mean()) for s in squares]
    gains = bool(held.any()) and pays(squares[0][held], squares[1][held], limits)
    improved = gains and costs[0] >= EXPLAINED
    added = [" at ".join(key) for key in sure] + ([remainder.words] if remainder else [])
    words = _words(*pairs[improved], costs[improved], added if improved else None)
    if not improved:
        remainder, sure, pairs[1], squares[1] = None, (), pairs[0], squares[0]
    unit = problem.machine.unit
    outcome = Improvement(
        improved=improved,
        words=words,
        effects={" at ".join(key): problem.library.sites[key].named(final[key]) for key in sure},
        remainder=remainder.to_json() if remainder else None,
        closed_fraction=closed(*(root_mean(s[held]) for s in squares)) or 0.0,
        horizon=problem.replay.window,
        recordings=_errors(pairs, squares),
        units={c.column: "Pa" if c.chamber else unit(c.joint) for c in problem.channels},
        missing=missing,
    )
    better = ImprovedModel(problem=problem, hypothesis=final, named=sure, remainder=remainder)
    return outcome, better if improved else None


def _begun(
    model: str | Path | Machine,
    recordings: Mapping[str, Recording],
    held_out: tuple[str, ...],
    settings: DiagnosisSettings,
    progress: Callable[[str], None],
    *,
    effects: bool,
) -> tuple[Problem, tuple[Key, ...], Hypothesis]:
    """Returns the problem, effects of high confidence if `effects`, and their hypothesis."""
    if not effects:
        return set_up(model, recordings, held_out, settings), (), Hypothesis()
    result, found = diagnose(
        model, recordings, held_out=held_out, settings=settings, progress=progress
    )
    kept = (e for e in result.effects if e.confidence >= settings.thresholds.sure)
    return found.problem, *_recalibrated(found, kept)


def _words(problem: Problem, final: Hypothesis, cost: float, added: list[str] | None) -> str:
    """Returns what was added, or why nothing; `added` is None if nothing improves the model.

    `cost` is the remaining cost of the held-out recordings.
    """
    if added:
        return f"Added: {'; '.join(added)}."
    much = cost > EXPLAINED
    text = "Recalibrated within tolerances; no further static force improves it."
    if added is None:
        text = "Nothing improves the model on held-out recordings"
        text += "." if much else ": it explains them."
    return f"{text} {MEMORY_WORDS}." if much and has_memory(problem, final) else text


def _errors(
    pairs: Sequence[tuple[Problem, Hypothesis]], squares: Sequence[np.ndarray]
) -> tuple[ReplayError, ...]:
    """Returns each recording's errors before and after; `squares` are mean squares of windows."""
    errors = [problem.raw_errors(hypothesis) for problem, hypothesis in pairs]
    problem, out = pairs[0][0], []
    columns = [channel.column for channel in problem.channels]
    for i, series in enumerate(problem.series):
        own = problem.replay.recording == i
        if not own.any():
            continue
        before, after = (root_mean(s[own]) for s in squares)
        ends = zip(*(_at_ends(e[own]) for e in errors), strict=True)
        out.append(
            ReplayError(
                recording=series.name,
                held_out=bool(problem.held[own].any()),
                noise_levels=(before, after),
                at_horizon=dict(zip(columns, ends, strict=True)),
            )
        )
    return tuple(out)


def _at_ends(errors: np.ndarray) -> list[float]:
    """Returns the RMS by channel at the end of windows, of errors (windows, channels, bins)."""
    return rms(errors[:, :, -1], axis=0).tolist()
