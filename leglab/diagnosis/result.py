"""The verdict of a diagnosis, with all that a report or a page shows; immutable.

What is told `before` is of the model as it was, `baseline` of that with nuisances refitted within
their tolerance, and `after` with the named effects.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np

from leglab.base.notebook import data_frame, html_table, panels
from leglab.base.scale import rms
from leglab.diagnosis.thresholds import ONSET_WIDE, ROOM

Verdict = Literal["named", "confusion_set", "unexplained", "nothing_missing", "fitted"]


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A fitted parameter of an effect in SI units, with its value in the model as it was.

    `interval` is that of 95 % confidence.
    """

    name: str
    value: float
    unit: str
    interval: tuple[float, float]
    nominal: float


@dataclass(frozen=True, kw_only=True)
class Moved:
    """A parameter that the improved model has elsewhere within its tolerance."""

    effect: str
    element: str
    estimate: Estimate  #: Its interval is the tolerance
    share: float  #: How far it moved, of its tolerance, with its sign


@dataclass(frozen=True, kw_only=True)
class NamedEffect:
    """An effect that the simulation lacks."""

    name: str
    element: str
    group: str
    physics: str
    #: Recording and time [s] at which it begins, where it is not there throughout.
    onset: tuple[tuple[str, float], ...]
    #: Probability of the name among all sets of effects that were fitted, the least of several, and
    #: against causes that no effect describes, in [0, 1].
    confidence: float
    contribution: float  #: Share of the gap that it closes when it is added last
    parameters: tuple[Estimate, ...]
    indistinguishable_from: tuple[str, ...]  #: Effects that explain these recordings as well
    #: Normalised replay error on the held-out recordings where it alone is taken out.
    without: float = math.nan
    #: Recording, earliest and latest time [s] of an onset; in between it shows in no motion.
    onset_interval: tuple[tuple[str, float, float], ...] = ()
    #: By how much directions differ that the effect says do; surer than each alone.
    differences: tuple[Estimate, ...] = ()

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Reported values: difference between directions, then the parameters."""
        return (*self.differences, *self.parameters)

    def begins(self) -> tuple[str, ...]:
        """When it begins in each recording: a time, or from when to when it may have been."""
        wide = {
            name: f"between {low:.2f} and {high:.2f} s of {name}"
            for name, low, high in self.onset_interval
            if high - low >= ONSET_WIDE
        }
        return tuple(wide.get(name, f"at {time:.2f} s of {name}") for name, time in self.onset)

    def told(self) -> str:
        """The effect with its element and parameters in a few words."""
        values = ", ".join(f"{p.name} {p.value:.4g} {p.unit}".strip() for p in self.parameters)
        return f"{self.name} at {self.element}" + (f" ({values})" if values else "")


@dataclass(frozen=True, kw_only=True)
class Remaining:
    """RMS error at the end of a replay window, on the held-out recordings, in one channel."""

    channel: str  #: Column of the recordings
    unit: str  #: "rad", "m" or "Pa"
    horizon: float  #: Time from the measured start of a replay to its end [s]
    before: float
    after: float
    noise: float  #: Standard deviation of the sensor's samples
    #: Of the improved model, where something was learned for it; else None.
    learned: float | None = None


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """A specimen as its healthy recordings show it."""

    #: Name, normalised error of the model as it was, and of the calibrated one.
    recordings: tuple[tuple[str, float, float], ...]
    #: Effect, element and parameter that differ, the largest difference first.
    estimates: tuple[tuple[str, str, Estimate], ...]


@dataclass(frozen=True, kw_only=True)
class Where:
    """Where simulation and data disagree, and in which region most."""

    #: "mechanical" (pressures to motion), "hydraulic" (command and motion to pressures) or "motion"
    #: (command to motion) where there are no pressures.
    residual: str
    element: str
    level: float  #: RMS in noise levels, of the model as it was
    region: str


@dataclass(frozen=True, kw_only=True)
class RecordingGap:
    """Normalised replay error of one recording: RMS of whitened errors; noise alone gives 1."""

    name: str
    held_out: bool
    before: float
    baseline: float
    after: float


@dataclass(frozen=True, kw_only=True)
class Gap:
    """Gap on the held-out recordings, as in `RecordingGap`."""

    metric: str = "normalised replay error"
    noise_floor: float = 1.0
    before: float
    baseline: float
    after: float
    #: Error that the calibrated specimen had in its healthy recordings; None without any.
    healthy: float | None = None
    #: Error of the final fit without the named effects; NaN where there are none.
    unnamed: float = math.nan
    #: As `shown`, in errors that noise and the healthy specimen have, and over all recordings where
    #: those held out hardly show what is named; None for `unnamed`, `after` and what noise gives.
    compared: tuple[float, float, float] | None = None
    held_out: tuple[str, ...]

    @property
    def shown(self) -> tuple[float, float, float]:
        """Errors without the named effects and with them, and what is no part of the gap."""
        return self.compared or (self.unnamed, self.after, self.noise_floor)

    @property
    def explained(self) -> float | None:
        """Share of the named effects' gap that they close; None where nothing is named.

        What was off before the machine changed, or noise, is no part of the gap.
        """
        share = closed(*self.shown)
        return None if share is None else min(max(share, 0.0), 1.0)

    @property
    def closed_fraction(self) -> float | None:
        """(before - after)/(before - noise_floor); None where there was no gap."""
        return closed(self.before, self.after, self.noise_floor)


def closed(before: float, after: float, floor: float = 1.0) -> float | None:
    """Share of the gap between an error and what noise gives that is closed; None without one."""
    room = before - floor
    return (before - after) / room if room > ROOM else None


@dataclass(frozen=True, kw_only=True)
class Rank:
    """One effect that was tried."""

    name: str
    element: str
    #: Log of the factor by which it alone makes the recordings more probable, first order.
    gain: float
    #: Predicted log evidence of the best set with it, one step from a good set, over that of the
    #: best set; None if none was scored.
    added: float | None = None


@dataclass(frozen=True, kw_only=True)
class Tried:
    """A set of effects that was fitted."""

    names: tuple[tuple[str, str], ...]  #: Effects and elements; none is the model as it is
    move: str  #: Move of the search that proposed it first
    reason: str  #: In words
    level: float  #: Median error, in noise levels
    behind: float  #: Log evidence of the most probable set over its own


@dataclass(frozen=True, kw_only=True, eq=False)
class Rivals:
    """Sets of effects that were fitted to the end."""

    #: Effects of each set, joined by " + ", or "nothing"; most probable first.
    names: tuple[str, ...]
    cost: tuple[float, ...]  #: Mean square error of each; noise alone gives about 1
    preference: np.ndarray  #: [i, j] is the probability of set i against set j


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualTrace:
    """Replay errors of one channel over one recording, a point a bin; arrays of shape (bins,)."""

    recording: str
    channel: str
    unit: str  #: Of the channel and its errors
    time: np.ndarray  #: s
    position: np.ndarray  #: Of the channel's joint [rad or m], with its velocity
    velocity: np.ndarray
    #: Pressure difference across the piston [Pa]; None where not measured.
    pressure: np.ndarray | None
    before: np.ndarray  #: Measured less predicted, as is `after`
    after: np.ndarray
    measured: np.ndarray  #: The channel itself
    bins: int  #: Number of bins of a window; windows lie behind each other


@dataclass(frozen=True, kw_only=True, eq=False)
class WholeRecording:
    """A recording simulated in one go, in closed loop; arrays (samples,)."""

    recording: str
    joint: str  #: Whose position strays most
    unit: str  #: "rad" or "m", of the positions
    actuator: str  #: Whose command the loop corrects
    time: np.ndarray  #: s
    measured: np.ndarray  #: Position of the joint
    before: np.ndarray  #: As simulated, as is `after`; NaN from where that blew up
    after: np.ndarray
    #: What the loop added to the command, in standard deviations of that command, as is
    #: `correction_after`.
    correction_before: np.ndarray
    correction_after: np.ndarray

    def to_json(self) -> dict[str, Any]:
        """Names, and root mean squares over the recording; None where a simulation blew up."""
        return {
            "recording": self.recording,
            "joint": self.joint,
            "unit": self.unit,
            "before": float(rms(self.before - self.measured)),
            "after": float(rms(self.after - self.measured)),
            "correction_before": float(rms(self.correction_before)),
            "correction_after": float(rms(self.correction_after)),
        }


@dataclass(frozen=True, kw_only=True)
class NotTestable:
    """An effect on which these recordings say nothing."""

    name: str
    element: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """The experiment that would separate the rivals best."""

    name: str
    description: str
    rivals: tuple[str, str]
    separation: float  #: Expected chi-square between them
    separation_now: float  #: The same in the present recordings


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosis:
    """The verdict and its evidence.

    Attributes:
        effects: Ordered by what each contributes.
        where: Worst first.
        ranking: All effects that were tried, best first.
        tried: Fitted sets of effects, in the order of the search.
        moved: Parameters that the improved model has elsewhere within their tolerance.
        changed: How the improved model differs from the model, as lines of a unified diff.
        notes: What the reader should know: repairs, missing pressures, bounds that were hit.
        among: Probability that the cause is one of a confusion set; None for other verdicts.
        smaller: Effects that close less than a tenth of the gap each: differences, not the cause.
        model: File of the improved model; empty before it is written, or where nothing improves.
        learned: What the improved model has learned beside the effects, in words.
        covariance: Of fitted parameters: ELEMENT:EFFECT.PARAMETER of each, and [SI units] shape
            (parameters, parameters); None of a diagnosis.
        missing: Reasons why parts of the result are missing, by part
            (`leglab.base.output.piece`).
        rollouts: Replays of all windows that it took.
        seconds: Wall time.
    """

    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    where: tuple[Where, ...]
    not_testable: tuple[NotTestable, ...]
    gap: Gap
    recordings: tuple[RecordingGap, ...]
    ranking: tuple[Rank, ...]
    rivals: tuple[Rivals, ...]
    traces: tuple[ResidualTrace, ...]
    next_experiment: Proposal | None
    notes: tuple[str, ...]
    tried: tuple[Tried, ...] = ()
    among: float | None = None
    smaller: tuple[NamedEffect, ...] = ()
    remaining: tuple[Remaining, ...] = ()
    whole: WholeRecording | None = None
    calibration: Calibration | None = None
    model: str = ""
    moved: tuple[Moved, ...] = ()
    changed: tuple[str, ...] = ()
    learned: str = ""
    covariance: tuple[tuple[str, ...], np.ndarray] | None = None
    missing: dict[str, str] = field(default_factory=dict)
    rollouts: float = 0.0
    seconds: float = 0.0

    def __repr__(self) -> str:
        told = "; ".join(effect.told() for effect in self.effects) or "no effect"
        explained = self.gap.explained
        share = "" if explained is None else f"; {explained:.0%} explained"
        return f"Diagnosis({self.verdict}: {told}{share})"

    @property
    def recalibrated(self) -> bool:
        """Whether parameters moved within their tolerances; `leglab fit` moves none but its own."""
        return self.verdict != "fitted"

    @property
    def nominal_words(self) -> str:
        """Where the nominal values of effects were: healthy recordings tell the specimen's own."""
        return "in the model" if self.calibration is None else "before"

    @property
    def all_effects(self) -> list[tuple[NamedEffect, bool]]:
        """All effects, each with whether it is one of the smaller."""
        return [(e, False) for e in self.effects] + [(e, True) for e in self.smaller]

    def _repr_html_(self) -> str:
        rows: list[tuple[str, ...]] = []
        for effect, smaller in self.all_effects:
            first = (effect.name, effect.element, "smaller" * smaller, f"{effect.confidence:.0%}")
            for p in effect.parameters:
                interval = "{:.4g} to {:.4g}".format(*p.interval)
                told = (p.name, f"{p.value:.4g}", p.unit, interval, f"{p.nominal:.4g}")
                rows.append((*first, *told))
                first = ("",) * 4
            if not effect.parameters:
                rows.append((*first, *("",) * 5))
        names = ("effect", "element", "", "confidence", "parameter", "value", "unit")
        return html_table(repr(self), (*names, "95 % interval", self.nominal_words), rows)

    def plot(self) -> list[Any]:
        """Draws the replay error of every recording: before, recalibrated, with the effects.

        Returns:
            One axis, in a list, of a new figure of `matplotlib.pyplot`.
        """
        axes = panels(1, height=1.0 + 0.5 * len(self.recordings))
        places = np.arange(len(self.recordings))
        labels = {"before": "before", "baseline": "recalibrated", "after": "with the effects"}
        for i, (name, label) in enumerate(labels.items()):
            values = [getattr(recording, name) for recording in self.recordings]
            axes[0].barh(places + 0.25 * i, values, height=0.22, label=label)
        names = [f"{r.name}{' (held out)' * r.held_out}" for r in self.recordings]
        axes[0].set_yticks(places + 0.25, names)
        axes[0].invert_yaxis()
        axes[0].set_xscale("log")
        axes[0].set_xlabel(f"{self.gap.metric}; noise alone gives {self.gap.noise_floor:g}")
        axes[0].legend(fontsize="small")
        return axes

    def to_pandas(self) -> Any:
        """Returns the parameters of the effects as a `pandas.DataFrame`, one row a parameter.

        Raises:
            LeglabError: pandas is missing.
        """
        names = ("effect", "element", "smaller", "confidence", "parameter", "value", "unit")
        rows: list[tuple[Any, ...]] = []
        for e, smaller in self.all_effects:
            first = (e.name, e.element, smaller, e.confidence)
            for p in e.parameters:
                rows.append((*first, p.name, p.value, p.unit, *p.interval, p.nominal))
        return data_frame(rows, columns=[*names, "lower", "upper", "in_the_model"])

    def with_model(self, name: str, learned: str = "", errors: Sequence[float] = ()) -> "Diagnosis":
        """The same with an improved model's file, what it has learned and the errors it leaves.

        The errors are in the order of `remaining`; empty where nothing was learned.
        """
        remaining = self.remaining
        if errors:
            rows = zip(remaining, errors, strict=True)
            remaining = tuple(replace(one, learned=error) for one, error in rows)
        return replace(self, model=name, learned=learned, remaining=remaining)

    def to_json(self) -> dict[str, Any]:
        """The content of diagnosis.json; keys are fixed, readers rely on them."""
        content = {
            "verdict": self.verdict,
            "among": self.among,
            "explained": self.gap.explained,
            "effects": [_effect(e) for e in self.effects],
            "smaller": [_effect(e) for e in self.smaller],
            "where": [asdict(where) for where in self.where],
            "not_testable": sorted({n.name for n in self.not_testable}),
            "gap": _fields(self.gap, "held_out", "unnamed", "compared")
            | {"closed_fraction": self.gap.closed_fraction, "held_out": self.gap.held_out},
            "recordings": [_fields(recording) for recording in self.recordings],
            "remaining": [asdict(one) for one in self.remaining],
            "whole": self.whole and self.whole.to_json(),
            "calibration": self.calibration
            and {
                "recordings": [
                    {"name": name, "before": before, "after": after}
                    for name, before, after in self.calibration.recordings
                ],
                "parameters": [
                    {"effect": effect, "element": element, **asdict(estimate)}
                    for effect, element, estimate in self.calibration.estimates
                ],
            },
            "ranking": [asdict(one) for one in self.ranking],
            "tried": [asdict(one) for one in self.tried],
            "rivals": [{"names": one.names, "cost": one.cost} for one in self.rivals],
            "next_experiment": self.next_experiment and asdict(self.next_experiment),
            "notes": self.notes,
            "learned": self.learned or None,
            "model": self.model or None,
            "moved": [
                {
                    "effect": one.effect,
                    "element": one.element,
                    "parameter": one.estimate.name,
                    "unit": one.estimate.unit,
                    "from": one.estimate.nominal,
                    "to": one.estimate.value,
                    "share": one.share,
                }
                for one in self.moved
            ],
            "changed": self.changed,
            "covariance": self.covariance
            and {"parameters": self.covariance[0], "matrix": self.covariance[1].tolist()},
            "missing": self.missing or None,
        }
        return {key: _plain(value) for key, value in content.items()}


def root_mean(squares: np.ndarray) -> float:
    """Root of the mean of squares; NaN of none."""
    return float(np.sqrt(squares.mean())) if squares.size else math.nan


def shown_unit(unit: str) -> tuple[float, str]:
    """Factor and name of the unit in which errors are shown: mrad, mm, bar."""
    shown = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "Pa": (1e-5, "bar")}
    return shown.get(unit, (1.0, unit))


def _effect(effect: NamedEffect) -> dict[str, Any]:
    return {
        **_fields(effect, "group", "physics", "without"),
        "onset": dict(effect.onset) or None,
        "onset_interval": {name: both for name, *both in effect.onset_interval} or None,
        "parameters": {p.name: _fields(p, "name") for p in effect.parameters},
        "differences": {p.name: _fields(p, "name") for p in effect.differences} or None,
    }


def _fields(row: Estimate | NamedEffect | Gap | RecordingGap, *left_out: str) -> dict[str, Any]:
    """Fields in their order, a baseline under the name that diagnosis.json gives it."""
    names = {"baseline": "recalibrated"}
    return {names.get(k, k): v for k, v in asdict(row).items() if k not in left_out}


def _plain(value: Any) -> Any:
    """The same for JSON, with five significant digits: more would pretend a precision.

    Numbers that JSON cannot hold become None.
    """
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else None
    return value
