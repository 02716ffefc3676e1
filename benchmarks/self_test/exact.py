"""The self-test: many blind cases, scored, resumed where it was interrupted."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from benchmarks.self_test.command import diagnosed
from benchmarks.self_test.outcomes import numbers, run_missing
from leglab.base.recording import Recording
from leglab.diagnosis.effects.hypothesis import Library
from leglab.diagnosis.plant.model import Machine
from rigs.bench import (
    FAULTS,
    SUDDEN,
    FaultyBench,
    HiddenValue,
    detuned,
    references,
)

MODEL = "knee_bench"
# Of every hundred single-effect cases.
_SHARES = {"single": 1.0, "null": 0.3, "pair": 0.2, "removed": 0.1, "onset": 0.05}
SCORE_HEAD = ("question", "reached", "cases", "asked")
_SET = 3  # largest confusion set that counts as an answer
_SURE = 0.9  # a name that is wrong must not be given with more confidence
_DOUBT = 0.5  # at most this is low confidence
_ONSET, _ONSET_TOLERANCE = 6.0, 0.3  # s
_KINDS = {"single": 1, "null": 2, "pair": 3, "removed": 4, "onset": 5}  # in the seeds


@dataclass(frozen=True, kw_only=True)
class Case:
    """Effects hidden in one set of recordings."""

    kind: str  #: "single", "null", "pair", "removed" or "onset"
    number: int  #: Of the case among its kind; with the seed it fixes every random choice
    effects: tuple[str, ...]  #: Hidden effects
    onset: float = 0.0  #: s; 0 where they are there throughout


def cases(counts: Mapping[str, int], seed: int, names: Sequence[str]) -> list[Case]:
    """So many cases of each kind: single ones cycle through the names."""
    found = []
    for kind, count in counts.items():
        for number in range(count):
            rng = np.random.default_rng([seed, _KINDS[kind], number])
            if kind == "null":
                effects: tuple[str, ...] = ()
            elif kind == "single":
                effects = (names[number % len(names)],)
            elif kind == "pair":
                effects = tuple(rng.choice(names, 2, replace=False).tolist())
            else:
                choice = [n for n in names if n in SUDDEN] if kind == "onset" else list(names)
                effects = (choice[int(rng.integers(len(choice)))],)
            onset = _ONSET if kind == "onset" else 0.0
            found.append(Case(kind=kind, number=number, effects=effects, onset=onset))
    return found


def make(case: Case, seed: int) -> tuple[dict[str, Recording], tuple[HiddenValue, ...]]:
    """Recordings of a case, and the severities that were drawn."""
    rng = np.random.default_rng([seed, _KINDS[case.kind], case.number, 1])
    plant = FaultyBench(onset=case.onset)
    detuned(plant, rng)
    severities = tuple(FAULTS[name](plant, rng) for name in case.effects)
    return {n: plant.record(values, rng) for n, values in references(rng).items()}, severities


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A case and its diagnosis."""

    kind: str  #: Of the case
    number: int  #: Of the case
    hidden: tuple[str, ...]  #: Effects that were there
    severities: tuple[str, ...]  #: "parameter=value" of each
    verdict: str  #: Of the diagnosis
    #: Effects that it names, first the one that contributes most; smaller ones as well.
    named: tuple[str, ...]
    alternatives: tuple[tuple[str, ...], ...]  #: Effects that each is not told apart from
    confidence: tuple[float, ...]  #: Of each
    #: Whether its interval holds each parameter whose true value is known.
    covered: tuple[bool, ...]
    onsets: tuple[float, ...]  #: Estimated onsets [s]; empty where none was found
    before: float  #: Gap on the held-out recording
    after: float  #: The same with the named effects
    seconds: float  #: Time of the diagnosis on one thread
    #: Earliest and latest onset [s], in the order of `onsets`.
    onset_intervals: tuple[tuple[float, float], ...] = ()
    changed: tuple[str, ...] = ()  #: How improved.xml differs from the model
    sets: dict[str, Any] = field(default_factory=dict)  #: What sets.json holds

    @property
    def first(self) -> bool:
        """Whether the hidden effect is named first, or nothing where nothing was hidden."""
        return (self.named[:1] == self.hidden[:1]) if self.hidden else not self.named

    @property
    def found(self) -> bool:
        """Whether every hidden effect is named or in a small enough confusion set."""
        sets = [
            {name, *others}
            for name, others in zip(self.named, self.alternatives, strict=True)
            if len(others) < _SET
        ]
        return all(any(effect in s for s in sets) for effect in self.hidden)

    @property
    def honest(self) -> bool:
        """Whether doubt is expressed: nothing named, or with low confidence, in any verdict."""
        return not self.named or max(self.confidence) <= _DOUBT

    @property
    def onset_right(self) -> bool:
        """Whether an onset was found within the tolerance in every recording that has one."""
        return bool(self.onsets) and all(abs(t - _ONSET) <= _ONSET_TOLERANCE for t in self.onsets)

    @property
    def onset_told(self) -> bool:
        """Whether, where an onset is off, it is told as an interval that holds the true one."""
        near = [abs(t - _ONSET) <= _ONSET_TOLERANCE for t in self.onsets]
        held = [low <= _ONSET <= high for low, high in self.onset_intervals] or near
        return bool(near) and all(a or b for a, b in zip(near, held, strict=True))


def self_test(
    folder: Path,
    count: int = 100,
    *,
    seed: int = 0,
    kinds: Sequence[str] = tuple(_SHARES),
    **how: Any,
) -> list[Outcome]:
    """Runs the cases that FOLDER/outcomes-SEED.jsonl does not hold yet, and returns all.

    So many of single effects, and of the other kinds in proportion; `how` is as of `run_missing`.

    Raises:
        LeglabError: A kind does not exist, or a case came to no outcome.
    """
    names = sorted(set(FAULTS) & set(Library(Machine(MODEL)).names))
    todo = cases(numbers(_SHARES, kinds, count), seed, names)
    path, parse = folder / f"outcomes-{seed}.jsonl", _OUTCOME.validate_python
    return run_missing(path, todo, outcome_of, parse=parse, settings={"seed": seed}, **how)


def outcome_of(given: dict[str, Any]) -> dict[str, Any]:
    """Runs a case in whatever process: `given` has `case` and, in `settings`, its `seed`."""
    return asdict(run_case(_CASE.validate_python(given["case"]), given["settings"]["seed"]))


def run_case(case: Case, seed: int) -> Outcome:
    """Makes a case and diagnoses it on one thread."""
    recordings, severities = make(case, seed)
    left = set(Library(Machine(MODEL)).names) - set(case.effects)
    began = perf_counter()
    content = diagnosed(MODEL, recordings, effects=sorted(left) if case.kind == "removed" else ())
    told = [*content["effects"], *content["smaller"]]
    covered = [
        low is not None and high is not None and low <= hidden.value <= high
        for name, hidden in zip(case.effects, severities, strict=True)
        for e in told
        for parameter, estimate in e["parameters"].items()
        if (e["name"], parameter) == (name, hidden.parameter)
        for low, high in [estimate["interval"]]
    ]
    return Outcome(
        kind=case.kind,
        number=case.number,
        hidden=case.effects,
        severities=tuple(f"{s.parameter}={s.value:.4g}" for s in severities),
        verdict=content["verdict"],
        named=tuple(e["name"] for e in told),
        alternatives=tuple(tuple(e["indistinguishable_from"]) for e in told),
        confidence=tuple(e["confidence"] for e in told),
        covered=tuple(covered),
        onsets=tuple(t for e in told for t in (e["onset"] or {}).values()),
        onset_intervals=tuple(
            (low, high) for e in told for low, high in (e["onset_interval"] or {}).values()
        ),
        before=content["gap"]["before"],
        after=content["gap"]["after"],
        seconds=perf_counter() - began,
        changed=tuple(content["changed"]),
        sets=content["sets"],
    )


# They make tuples of JSON's lists.
_CASE, _OUTCOME = TypeAdapter(Case), TypeAdapter(Outcome)


def scores(outcomes: list[Outcome]) -> list[tuple[str, str, str, str]]:
    """Rows of `SCORE_HEAD`: shares reached beside those asked."""
    rows: list[tuple[str, str, str, str]] = []

    def add(question: str, good: list[bool], asked: str) -> None:
        if good:
            share = f"{sum(good)} ({sum(good) / len(good):.0%})"
            rows.append((question, share, str(len(good)), asked))

    def of(kind: str, good: Callable[[Outcome], bool]) -> list[bool]:
        return [good(o) for o in outcomes if o.kind == kind]

    def wrong_for_sure(outcome: Outcome) -> bool:
        return not outcome.honest and max(outcome.confidence) > _SURE

    add("single effect named first", of("single", lambda o: o.first), "85 %")
    add("single effect named or in a set of 3", of("single", lambda o: o.found), "95 %")
    add("false alarms where nothing is hidden", of("null", lambda o: bool(o.named)), "3 %")
    add("pairs: both named", of("pair", lambda o: o.found), "80 %")
    add("effect unknown to the library: doubt", of("removed", lambda o: o.honest), "80 %")
    add("... and a wrong name given for sure", of("removed", wrong_for_sure), "0 %")
    add("95 % intervals hold the truth", [c for o in outcomes for c in o.covered], "85 %")
    onset = of("onset", lambda o: o.found and o.onset_right)
    add("onset at 6 s named and within 0.3 s", onset, "all")
    told = of("onset", lambda o: o.found and o.onset_told)
    add("... or in an interval that is told instead", told, "all")
    seconds = [o.seconds for o in outcomes]
    if seconds:
        question = "seconds a diagnosis on one thread, median / longest"
        times = f"{np.median(seconds):.1f} / {max(seconds):.1f}"
        rows.append((question, times, str(len(seconds)), ""))
    return rows


MISSED_HEAD = ("hidden", "named instead", "verdict", "times")


def missed(outcomes: Iterable[Outcome]) -> list[tuple[str, str, str, str]]:
    """Rows of `MISSED_HEAD`: single effects that were not named first."""
    wrong = Counter(
        (o.hidden[0], ", ".join(o.named) or "nothing", o.verdict)
        for o in outcomes
        if o.kind == "single" and not o.first
    )
    return [(*what, str(times)) for what, times in sorted(wrong.items())]
