"""The self-test on specimens of another simulator: are names right, and confidences true?

Specimens are rough benches (`rough_bench`), or exact ones by the same simulator. Outcomes keep what
the diagnosis said as it said it; scores are drawn from that alone.
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from pydantic import TypeAdapter
from scipy.stats import binomtest

from benchmarks.self_test.command import diagnosed
from benchmarks.self_test.outcomes import numbers, run_missing
from leglab.base.errors import SettingsError
from leglab.diagnosis.effects.hypothesis import Library
from leglab.diagnosis.plant.model import Machine
from rigs.rough_bench import FAULTS, SIZES, effect_of, rough_case, specimen

MODEL = "knee_bench"
HEAD = ("question", "reached", "95 % interval", "cases", "asked")
# Of every hundred single faults. "torque" is a torque of position: no effect of its own.
SHARES = {"single": 1.0, "null": 0.3, "torque": 0.15, "pair": 0.1}
_UNKNOWN = "position_torque"
_KINDS = {"single": 1, "null": 2, "torque": 3, "pair": 4}  # in the seeds
SURE, DOUBT, CLAIM = 0.8, 0.5, 0.9
_PERIOD_TOLERANCE = 0.03
# Claims are counted between these confidences.
EDGES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 1.0)
NOTHING = "nothing"
_RANKED = 5  # effects of the screening that are kept


@dataclass(frozen=True, kw_only=True)
class RoughTestSettings:
    """Effects that are hidden, and their places."""

    rough: bool = True  #: Rough specimens; else exact ones
    sizes: str = "gross"  #: "gross", or "visible" for everything from just visible to gross
    healthy: bool = True  #: Whether the diagnosis gets recordings from before the fault
    seed: int = 0  #: With it every random choice is fixed

    def __post_init__(self) -> None:
        if self.sizes not in SIZES:
            raise SettingsError.unknown("range of sizes", self.sizes, SIZES)

    @property
    def name(self) -> str:
        """For files."""
        parts = ["rough" if self.rough else "exact", self.sizes]
        return "-".join([*parts, *["healthy"] * self.healthy, str(self.seed)])


@dataclass(frozen=True, kw_only=True)
class RoughTestCase:
    """Faults hidden in one set of recordings."""

    kind: str  #: A key of `SHARES`
    number: int  #: Of the case among its kind
    specimen: int  #: Seed for `rough_case`
    faults: tuple[str, ...]  #: Names of the bench's faults


@dataclass(frozen=True, kw_only=True)
class RoughOutcome:
    """A case and what the diagnosis said of it."""

    kind: str  #: Of the case
    number: int  #: Of the case
    specimen: int  #: Seed for `rough_case`
    faults: tuple[str, ...]  #: That were there
    severities: tuple[tuple[str, float], ...]  #: Parameter and true value of each
    diagnosis: dict[str, Any]  #: What diagnosis.json holds; empty where the diagnosis failed
    ranking: tuple[tuple[str, str, float], ...]  #: Name, element and gain of the best effects alone
    seconds: float  #: Time of the diagnosis on one thread
    error: str = ""  #: Why it failed

    @property
    def hidden(self) -> tuple[str, ...]:
        """The faults by the names of the diagnosis."""
        return tuple(effect_of(fault) for fault in self.faults)

    @property
    def verdict(self) -> str:
        """Of the diagnosis, or "failed"."""
        return str(self.diagnosis.get("verdict", "failed"))

    @property
    def claims(self) -> tuple[tuple[str, float], ...]:
        """Names with their confidence, in the order of the diagnosis."""
        return tuple((e["name"], float(e.get("confidence") or 0.0)) for e in self._told)

    @property
    def _told(self) -> list[dict[str, Any]]:
        return [*self.diagnosis.get("effects", ()), *self.diagnosis.get("smaller", ())]

    @property
    def first(self) -> str:
        """The first name, or `NOTHING`."""
        return self.claims[0][0] if self.claims else NOTHING

    def right_first(self, confidence: float = 0.0) -> bool:
        """Whether the first name is right, with this confidence at least."""
        return any(n in self.hidden and c >= confidence for n, c in self.claims[:1])

    def named(self, effect: str) -> bool:
        """Whether an effect is among the names, or not told apart from one of them."""
        told = self._told
        return any(effect in (e["name"], *e.get("indistinguishable_from", ())) for e in told)

    def wrong(self, confidence: float = DOUBT) -> bool:
        """Whether a name that is not there has more than this confidence, whatever the verdict."""
        return any(n not in self.hidden and c > confidence for n, c in self.claims)

    @property
    def closed(self) -> float:
        """Share of the gap on held-out recordings that was closed; 0 where there is none."""
        return float(self.diagnosis.get("gap", {}).get("closed_fraction") or 0.0)

    @property
    def period_right(self) -> bool:
        """Whether a period is told, the true one within 3 %."""
        told = told_period(self.diagnosis)
        true = dict(self.severities).get("period")
        return bool(told and true and abs(told / true - 1.0) <= _PERIOD_TOLERANCE)

    @property
    def covered(self) -> tuple[bool, ...]:
        """For each right name with a known true value: whether its interval holds it."""
        found = []
        for effect, (parameter, value) in zip(self.hidden, self.severities, strict=True):
            for e in self._told:
                estimate = e["parameters"].get(parameter) if e["name"] == effect else None
                if estimate and None not in estimate["interval"]:
                    low, high = estimate["interval"]
                    found.append(low <= value <= high)
        return tuple(found)


def told_period(content: Any) -> float | None:
    """The first period in what a diagnosis says: a number of that name, or "repeats every x"."""
    if isinstance(content, dict):
        for key, value in content.items():
            if "period" in str(key):
                value = value.get("value") if isinstance(value, dict) else value
                if isinstance(value, int | float) and value > 0.0:
                    return float(value)
            found = told_period(value)
            if found is not None:
                return found
    elif isinstance(content, list | tuple):
        return next((p for p in map(told_period, content) if p is not None), None)
    elif isinstance(content, str):
        match = re.search(r"repeats every (\d+(?:\.\d+)?)", content)
        return float(match[1]) if match else None
    return None


def rough_cases(
    counts: Mapping[str, int], settings: RoughTestSettings, effects: Iterable[str]
) -> list[RoughTestCase]:
    """The cases of a self-test: single ones cycle through all faults that have a name.

    Each cycle has an order of its own, drawn at random: the first cases of a test that is
    interrupted, or resumed later, are a fair sample of all faults. The seed of the settings fixes
    specimens and pairs, `effects` are names that the diagnosis knows.
    """
    known = set(effects)
    faults = [name for name in FAULTS if effect_of(name) in known and name != _UNKNOWN]
    found = []
    for kind, count in counts.items():
        for number in range(count):
            rng = np.random.default_rng([settings.seed, 40, _KINDS[kind], number])
            chosen: tuple[str, ...] = ()
            if kind == "single":
                cycle, place = divmod(number, len(faults))
                order = np.random.default_rng([settings.seed, 41, cycle]).permutation(len(faults))
                chosen = (faults[order[place]],)
            elif kind == "torque":
                chosen = (_UNKNOWN,)
            elif kind == "pair":
                while len(set(map(effect_of, chosen))) < 2:  # two faults may go by one name
                    chosen = tuple(str(name) for name in rng.choice(faults, 2, replace=False))
            specimen = settings.seed * 1_000_000 + _KINDS[kind] * 100_000 + number
            found.append(RoughTestCase(kind=kind, number=number, specimen=specimen, faults=chosen))
    return found


def rough_self_test(
    folder: Path,
    count: int = 100,
    settings: RoughTestSettings | None = None,
    *,
    kinds: Sequence[str] = tuple(SHARES),
    **how: Any,
) -> list[RoughOutcome]:
    """Runs the cases whose outcome the folder lacks in a file of the settings, and returns all.

    So many of single faults, and of the other kinds in proportion; `how` is as of `run_missing`.

    Raises:
        LeglabError: A kind does not exist, or a case came to no outcome.
    """
    settings = settings or RoughTestSettings()
    known = Library(Machine(MODEL)).names
    todo = rough_cases(numbers(SHARES, kinds, count), settings, known)
    hidden = {(case.kind, case.number): case.faults for case in todo}
    return run_missing(
        folder / f"outcomes-{settings.name}.jsonl",
        todo,
        outcome_of,
        parse=_OUTCOME.validate_python,
        done=lambda o: not o.error and o.faults == hidden[o.kind, o.number],
        settings=asdict(settings),
        **how,
    )


def outcome_of(given: dict[str, Any]) -> dict[str, Any]:
    """Runs a case in whatever process: `given` has the `case` and the self-test's `settings`."""
    settings = RoughTestSettings(**given["settings"])
    return asdict(run_case(_CASE.validate_python(given["case"]), settings))


def run_case(case: RoughTestCase, settings: RoughTestSettings) -> RoughOutcome:
    """Makes a case and diagnoses it on one thread; a failure is an outcome as well."""
    made = rough_case(
        case.specimen,
        case.faults,
        sizes=settings.sizes,
        healthy=settings.healthy,
        exact=not settings.rough,
    )
    content: dict[str, Any] = {}
    ranking: list[tuple[str, str, float]] = []
    error = ""
    began = perf_counter()
    try:
        content = diagnosed(MODEL, made.recordings, healthy=made.healthy)
        ranked = content.pop("ranking")[:_RANKED]
        ranking = [(r["name"], r["element"], r["gain"]) for r in ranked]
    except Exception as failure:  # hours of other cases must not be lost
        error = f"{type(failure).__name__}: {failure}"
    return RoughOutcome(
        kind=case.kind,
        number=case.number,
        specimen=case.specimen,
        faults=case.faults,
        severities=tuple((s.parameter, s.value) for s in made.severities),
        diagnosis=content,
        ranking=tuple(ranking),
        seconds=perf_counter() - began,
        error=error,
    )


# They make tuples of JSON's lists.
_CASE, _OUTCOME = TypeAdapter(RoughTestCase), TypeAdapter(RoughOutcome)


def interval(good: int, count: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    bounds = binomtest(good, count).proportion_ci(method="wilson")
    return float(bounds.low), float(bounds.high)


def scores(
    outcomes: Sequence[RoughOutcome], settings: RoughTestSettings
) -> list[tuple[str, str, str, str, str]]:
    """Rows of `HEAD`: shares reached, their intervals, and what is asked."""
    rows: list[tuple[str, str, str, str, str]] = []
    ran = [o for o in outcomes if not o.error]

    def add(question: str, good: Iterable[bool], asked: str) -> None:
        told = list(good)
        if told:
            low, high = interval(sum(told), len(told))
            share = f"{sum(told)} ({sum(told) / len(told):.0%})"
            rows.append((question, share, f"{low:.0%} to {high:.0%}", str(len(told)), asked))

    def of(kind: str) -> list[RoughOutcome]:
        return [o for o in ran if o.kind == kind]

    rough, healthy = settings.rough, settings.healthy
    single, torque = of("single"), of("torque")
    first, sure = (("90 %", "80 %") if healthy else ("85 %", "65 %")) if rough else ("", "")
    add("single fault: right name first", (o.right_first() for o in single), first)
    question = f"... with confidence {SURE:g} or more"
    add(question, (o.right_first(SURE) for o in single), sure)
    if rough:
        # Other edges leave a replay of slow motion ten times as far off as all the rest together.
        for which, law in (("the model's", True), ("other", False)):
            edges = [o for o in single if (specimen(o.specimen)["edge_law"] == 0.0) == law]
            question = f"... a valve with {which} metering edges: right name first"
            add(question, (o.right_first() for o in edges), "")
    add(f"... a wrong name above {DOUBT:g}", (o.wrong() for o in single), "")
    exact = "" if rough else "at most 2 %"
    add(f"... a wrong name above {SURE:g}", (o.wrong(SURE) for o in single), exact)
    asked = "at most 3 %" if healthy else ""
    add(f"nothing hidden: a name above {DOUBT:g}", (o.wrong() for o in of("null")), asked)
    both = (all(o.named(effect) for effect in o.hidden) for o in of("pair"))
    add("pair: both named", both, "")
    sides = [right for right, confidence in all_claims(ran) if confidence >= CLAIM]
    add(f"names given with {CLAIM:g} or more that are right", sides, "87 to 97 %" if rough else "")
    question = "torque of position: its period told within 3 %"
    add(question, (o.period_right for o in torque), "90 %")
    if torque:
        closed = f"{np.median([o.closed for o in torque]):.2f}"
        rows.append(("... gap closed, median", closed, "", str(len(torque)), "0.8"))
    add("95 % intervals of right names hold the truth", (c for o in ran for c in o.covered), "")
    seconds = [o.seconds for o in ran]
    if seconds:
        times = f"{np.median(seconds):.0f} / {max(seconds):.0f}"
        rows.append(("seconds on one thread, median / longest", times, "", str(len(ran)), ""))
    failed = len(outcomes) - len(ran)
    if failed:
        rows.append(("diagnoses that failed", str(failed), "", str(len(outcomes)), "0"))
    return rows


def all_claims(outcomes: Iterable[RoughOutcome]) -> Iterator[tuple[bool, float]]:
    """Whether each name of all cases is right, and the confidence it was given with."""
    for outcome in outcomes:
        for name, confidence in outcome.claims:
            yield name in outcome.hidden, confidence


@dataclass(frozen=True, kw_only=True)
class Bin:
    """Claims between two confidences."""

    low: float  #: Least confidence
    high: float  #: Confidence of the next bin; the last one holds it as well
    count: int  #: Claims
    right: int  #: Of them
    mean: float  #: Confidence; nan without claims


def reliability(outcomes: Iterable[RoughOutcome]) -> list[Bin]:
    """Claims by their confidence, all kinds of cases together."""
    return binned(list(all_claims(outcomes)))


def binned(claims: Sequence[tuple[bool, float]]) -> list[Bin]:
    """Claims, right or not and with their confidence, by the confidence."""
    right = np.array([r for r, _ in claims], dtype=bool)
    confidence = np.array([c for _, c in claims], dtype=float)
    place = np.clip(np.searchsorted(EDGES, confidence, side="right") - 1, 0, len(EDGES) - 2)
    return [
        Bin(
            low=EDGES[i],
            high=EDGES[i + 1],
            count=int((place == i).sum()),
            right=int(right[place == i].sum()),
            mean=float(confidence[place == i].mean()) if (place == i).any() else float("nan"),
        )
        for i in range(len(EDGES) - 1)
    ]


def confusions(outcomes: Iterable[RoughOutcome]) -> Counter[tuple[str, str]]:
    """How often a hidden effect of single and null cases got a first name."""
    kinds = ("single", "null")
    return Counter(
        ((o.hidden or (NOTHING,))[0], o.first) for o in outcomes if o.kind in kinds and not o.error
    )


RELIABILITY_HEAD = ("confidence", "names", "right", "95 % interval")


def reliability_rows(bins: Iterable[Bin]) -> list[tuple[str, str, str, str]]:
    """Rows of `RELIABILITY_HEAD`."""
    rows = []
    for one in bins:
        share = bounds = ""
        if one.count:
            low, high = interval(one.right, one.count)
            share = f"{one.right / one.count:.0%}"
            bounds = f"{low:.0%} to {high:.0%}"
        rows.append((f"{one.low:g} to {one.high:g}", str(one.count), share, bounds))
    return rows


MISSED_HEAD = ("hidden", "first name", "confidence", "verdict", "place in the screening")


def missed(outcomes: Iterable[RoughOutcome]) -> list[tuple[str, ...]]:
    """Rows of `MISSED_HEAD`: single faults that were not named first."""
    rows: list[tuple[str, ...]] = []
    wrong = [o for o in outcomes if o.kind == "single" and not o.error and not o.right_first()]
    for o in sorted(wrong, key=lambda o: o.faults):
        names = [name for name, _, _ in o.ranking]
        place = str(names.index(o.hidden[0]) + 1) if o.hidden[0] in names else f"> {len(names)}"
        confidence = f"{o.claims[0][1]:.2f}" if o.claims else ""
        rows.append((o.faults[0], o.first, confidence, o.verdict, place))
    return rows
