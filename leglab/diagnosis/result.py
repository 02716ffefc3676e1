"""Result of a diagnosis: verdict and all figures of reports and pages; immutable.

`before` is a quantity of the original model, `baseline` of the model with its parameters refitted
within their tolerances, and `after` of the model that also has the named effects.
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
    """A fitted parameter of an effect in SI units; `nominal` is its value in the original model.

    `interval` is the 95 % confidence interval.
    """

    name: str
    value: float
    unit: str
    interval: tuple[float, float]
    nominal: float


@dataclass(frozen=True, kw_only=True)
class Moved:
    """A parameter that the improved model changes within its tolerance."""

    effect: str
    element: str
    estimate: Estimate  #: Its `interval` is the 95 % range of good machines
    share: float  #: Signed change as a share of the tolerance


@dataclass(frozen=True, kw_only=True)
class NamedEffect:
    """An effect that the simulation lacks."""

    name: str
    element: str
    group: str
    physics: str
    #: Recording and time [s] at which the effect begins; empty if it is present throughout.
    onset: tuple[tuple[str, float], ...]
    #: Probability in [0, 1] that the effect is the cause, rather than another of the fitted sets of
    #: effects or a cause that no effect describes; the least of several estimates.
    confidence: float
    contribution: float  #: Share of the error above noise that the effect removes if added last
    parameters: tuple[Estimate, ...]
    indistinguishable_from: tuple[str, ...]  #: Effects that explain these recordings equally well
    #: Normalised replay error on the held-out recordings without this effect alone.
    without: float = math.nan
    #: Recording, earliest and latest time [s] of the onset: no motion between them shows it.
    onset_interval: tuple[tuple[str, float, float], ...] = ()
    #: Differences between values for the two directions, which are surer than the values.
    differences: tuple[Estimate, ...] = ()

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Reported values: difference between directions, then the parameters."""
        return (*self.differences, *self.parameters)

    def begins(self) -> tuple[str, ...]:
        """Returns when the effect begins in each recording: a time, or an interval around it."""
        wide = {
            name: f"between {low:.2f} and {high:.2f} s of {name}"
            for name, low, high in self.onset_interval
            if high - low >= ONSET_WIDE
        }
        return tuple(wide.get(name, f"at {time:.2f} s of {name}") for name, time in self.onset)

    def told(self) -> str:
        """Returns the effect with its element and parameters in a few words."""
        values = ", ".join(f"{p.name} {p.value:.4g} {p.unit}".strip() for p in self.parameters)
        return f"{self.name} at {self.element}" + (f" ({values})" if values else "")


@dataclass(frozen=True, kw_only=True)
class Remaining:
    """RMS error of one channel at the end of replay windows of the held-out recordings."""

    channel: str  #: Column of the recordings
    unit: str  #: "rad", "m" or "Pa"
    horizon: float  #: Time from the measured start of a replay to its end [s]
    before: float
    after: float
    noise: float  #: Standard deviation of the sensor's samples
    #: Error of the improved model; None without a learned remainder.
    learned: float | None = None


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Calibration of a specimen by its healthy recordings."""

    #: Name, normalised error of the original model, normalised error of the calibrated model.
    recordings: tuple[tuple[str, float, float], ...]
    #: Effect, element and parameter that differ, the largest difference first.
    estimates: tuple[tuple[str, str, Estimate], ...]


@dataclass(frozen=True, kw_only=True)
class Where:
    """Element at which simulation and data disagree, and the region of the largest error."""

    #: "mechanical" (pressures to motion), "hydraulic" (command and motion to pressures) or "motion"
    #: (command to motion) if no pressures are measured.
    residual: str
    element: str
    level: float  #: Error of the original model, in multiples of the noise
    region: str


@dataclass(frozen=True, kw_only=True)
class RecordingGap:
    """Normalised replay error (RMS of whitened errors) of one recording; noise alone gives 1."""

    name: str
    held_out: bool
    before: float
    baseline: float
    after: float


@dataclass(frozen=True, kw_only=True)
class Gap:
    """Normalised replay error on the held-out recordings, as in `RecordingGap`."""

    metric: str = "normalised replay error"
    noise_floor: float = 1.0
    before: float
    baseline: float
    after: float
    #: Error of the calibrated specimen in its healthy recordings; None without such recordings.
    healthy: float | None = None
    #: Error of the final fit without the named effects; NaN if no effect is named.
    unnamed: float = math.nan
    #: Value of `shown` if effects are named, else None: errors relative to noise and the healthy
    #: specimen, of all recordings if the held-out recordings hardly show the effects.
    compared: tuple[float, float, float] | None = None
    held_out: tuple[str, ...]

    @property
    def shown(self) -> tuple[float, float, float]:
        """Error without the named effects, error with them, and noise floor (not in the gap)."""
        return self.compared or (self.unnamed, self.after, self.noise_floor)

    @property
    def explained(self) -> float | None:
        """Share of the gap that the named effects close; None if no effect is named.

        The gap excludes noise, and the model error from before the machine changed.
        """
        share = closed(*self.shown)
        return None if share is None else min(max(share, 0.0), 1.0)

    @property
    def closed_fraction(self) -> float | None:
        """(before - after)/(before - noise_floor); None if there was no gap."""
        return closed(self.before, self.after, self.noise_floor)


def closed(before: float, after: float, floor: float = 1.0) -> float | None:
    """Returns the closed share of an error's excess over the noise floor; None if it has none."""
    room = before - floor
    return (before - after) / room if room > ROOM else None


@dataclass(frozen=True, kw_only=True)
class Rank:
    """One effect that was tried."""

    name: str
    element: str
    #: First-order log of the factor by which this effect alone makes the recordings more probable.
    gain: float
    #: Predicted log evidence of the best set with this effect among neighbours of good sets, minus
    #: the best set's log evidence; None if no set with this effect was scored.
    added: float | None = None


@dataclass(frozen=True, kw_only=True)
class Tried:
    """A set of effects that was fitted."""

    names: tuple[tuple[str, str], ...]  #: Effects and elements; empty for the model itself
    move: str  #: Move of the search that proposed it first
    reason: str  #: Reason of the proposal, in words
    level: float  #: Median whitened RMS error
    behind: float  #: Log evidence of the most probable set minus this set's


@dataclass(frozen=True, kw_only=True)
class Certainty:
    """Confidence of an effect of the fitted sets, and the factors that it follows from."""

    name: str
    element: str
    confidence: float  #: Probability that the effect is the cause
    evidence: float  #: Probability of the sets with the effect, by all recordings
    #: `evidence` without the least favourable part of the recordings, and without sets at a bound.
    parts: float
    drive: float  #: `parts` if errors are divided by the motion that commands cause
    explained: float  #: Share of the errors that the effect explains
    inside: float  #: Probability that the library contains the cause, by `explained`
    differs: float  #: Probability that directions differ noticeably; 1 for a symmetric effect
    ties: int  #: Number of rivals that the data do not distinguish from the effect


@dataclass(frozen=True, kw_only=True, eq=False)
class Rivals:
    """Sets of effects whose fits were completed."""

    #: Effects of each set, joined by " + ", or "nothing"; most probable first.
    names: tuple[str, ...]
    cost: tuple[float, ...]  #: Mean square error of each set; noise alone gives about 1
    preference: np.ndarray  #: [i, j] is the probability of set i against set j


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualTrace:
    """Replay errors of one channel over one recording by bins; arrays of shape (bins,)."""

    recording: str
    channel: str
    unit: str  #: Of the channel and its errors
    time: np.ndarray  #: s
    position: np.ndarray  #: Position of the channel's joint [rad or m]
    velocity: np.ndarray  #: Velocity of the channel's joint [rad/s or m/s]
    #: Pressure difference across the piston [Pa]; None if not measured.
    pressure: np.ndarray | None
    before: np.ndarray  #: Measured minus predicted, like `after`
    after: np.ndarray
    measured: np.ndarray  #: Measured values of the channel
    bins: int  #: Number of bins of a window; windows follow one another in the arrays


@dataclass(frozen=True, kw_only=True, eq=False)
class WholeRecording:
    """A recording simulated as a whole in closed loop; arrays (samples,)."""

    recording: str
    joint: str  #: Joint with the largest position error
    unit: str  #: "rad" or "m", of the positions
    actuator: str  #: Actuator whose command the loop corrects
    time: np.ndarray  #: s
    measured: np.ndarray  #: Position of the joint
    before: np.ndarray  #: Simulated position, like `after`; NaN from where the simulation diverged
    after: np.ndarray
    #: Correction that the loop added to the command, in standard deviations of that command, like
    #: `correction_after`.
    correction_before: np.ndarray
    correction_after: np.ndarray

    def to_json(self) -> dict[str, Any]:
        """Returns names, and RMS values over the recording, NaN if a simulation diverged."""
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
    """An effect that these recordings cannot test."""

    name: str
    element: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """The experiment that would best distinguish the rivals."""

    name: str
    description: str
    rivals: tuple[str, str]
    separation: float  #: Expected chi-square between the rivals
    separation_now: float  #: Chi-square between the rivals in the present recordings


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosis:
    """The verdict and its evidence.

    Attributes:
        effects: Ordered by contribution.
        where: Largest error first.
        ranking: All effects that were tried, best first.
        tried: Fitted sets of effects, in the order of the search.
        judged: Effects of the fitted sets with their confidence and its factors.
        moved: Parameters that the improved model changes within their tolerances.
        changed: Unified diff between the model and the improved model, as lines.
        notes: Remarks for the reader: repairs, missing pressures, bounds that were hit.
        among: Probability that the cause is one of a confusion set; None for other verdicts.
        smaller: Effects that close less than a tenth of the gap each: deviations, not the cause.
        model: File of the improved model; empty before it is written, or if nothing improves.
        learned: Description of the remainder that the improved model has learned.
        covariance: ELEMENT:EFFECT.PARAMETER of each fitted parameter, and their covariance [SI
            units], (parameters, parameters); None for a diagnosis.
        missing: Reasons why parts of the result are missing, by part
            (`leglab.base.output.piece`).
        rollouts: Number of replays of all windows.
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
    judged: tuple[Certainty, ...] = ()
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
        """Whether parameters moved within tolerances; `leglab fit` moves only fitted ones."""
        return self.verdict != "fitted"

    @property
    def nominal_words(self) -> str:
        """Words for nominal values: "in the model", or "before" after a healthy calibration."""
        return "in the model" if self.calibration is None else "before"

    @property
    def all_effects(self) -> list[tuple[NamedEffect, bool]]:
        """All effects, each with a flag for the smaller ones."""
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
        """Returns the parameters of the effects as a `pandas.DataFrame`, one row per parameter.

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
        """Returns the diagnosis with the improved model's file, learned remainder and errors.

        `errors` are in the order of `remaining`; empty if nothing was learned.
        """
        remaining = self.remaining
        if errors:
            rows = zip(remaining, errors, strict=True)
            remaining = tuple(replace(one, learned=error) for one, error in rows)
        return replace(self, model=name, learned=learned, remaining=remaining)

    def to_json(self) -> dict[str, Any]:
        """Returns the content of diagnosis.json; readers rely on its fixed keys."""
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
            "judged": [asdict(one) for one in self.judged],
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
    """Returns the root of the mean of squares; NaN if there are none."""
    return float(np.sqrt(squares.mean())) if squares.size else math.nan


def shown_unit(unit: str) -> tuple[float, str]:
    """Returns factor and name of the unit in which errors are shown: mrad, mm or bar."""
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
    """Returns the fields in order, with `baseline` renamed as in diagnosis.json."""
    names = {"baseline": "recalibrated"}
    return {names.get(k, k): v for k, v in asdict(row).items() if k not in left_out}


def _plain(value: Any) -> Any:
    """Converts a value for JSON, with five significant digits, since more would pretend precision.

    Infinite values and NaN become None.
    """
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else None
    return value
