"""Record of a cause: its names, parameters that it changes, magnitudes as steps from healthy."""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from functools import cache
from typing import Any, Literal

from leglab._native.hydraulics import parameter_tables
from leglab.base.scenario import Healthy, Options, ParameterChange, Severity

# Function of a healthy value and a step (a factor or a difference) that returns the changed value.
Step = Callable[[float, float], float]


def times(healthy: float, step: float) -> float:
    """Returns the healthy value multiplied by a step, which is a factor."""
    return healthy * step


def plus(healthy: float, step: float) -> float:
    """Returns the healthy value plus a step, which is a difference in the magnitude's unit."""
    return healthy + step


@dataclass(frozen=True)
class Side:
    """Steps (factors or differences) from the healthy magnitude to one side, small to large."""

    bank: tuple[float, ...]  #: Steps at which the fault bank is simulated
    #: Steps of the benchmarks; none is in `bank`, and the last lies beyond the last of `bank`.
    benchmark: tuple[float, float, float]


@dataclass(frozen=True)
class Trials:
    """Trial values of one parameter of a diagnosis effect, as steps from the model's value.

    Attributes:
        parameter: Parameter of `leglab.cylinder`.
        steps: Values to try.
        step: With `times`, steps, tolerance and bounds are factors of the model's value; with
            `plus`, steps are added to it, and tolerance and bounds are absolute.
        tolerance: See `leglab.diagnosis.effects.EffectParameter`, also for all fields below.
    """

    parameter: str
    steps: tuple[float, ...]
    _: KW_ONLY
    step: Step = times
    tolerance: float = 0.0
    lower: float = 0.0
    upper: float
    role: Literal["strength", "shape"] = "strength"
    faults: Literal["above", "below", "either"] = "either"
    inverse: bool = False


@dataclass(frozen=True)
class EffectRow:
    """An effect of the diagnosis that changes cylinder parameters; for the texts see `Effect`."""

    name: str
    trials: tuple[Trials, ...]
    _: KW_ONLY
    group: str
    physics: str
    source: str
    excitation: str


def set_or_scale(cause: "Cause", options: Options) -> tuple[ParameterChange, ...]:
    """Sets the parameters to the magnitude, or scales them if the magnitude is a ratio."""
    change = options.scale if cause.ratio else options.set
    value = cause.unit * options.severity
    where = {"optional": cause.optional, "fallback": cause.fallback}
    return tuple(change(name, value, cause.element, **where) for name in cause.parameters)


@dataclass(frozen=True)
class Cause:
    """A cause with its names as a scenario, in a controller's online reports and in a diagnosis.

    Attributes:
        name: Name of the scenario and in the online reports.
        summary: Summary line of the scenario; empty for a cause that is no scenario.
        effect: Names of its effects in a diagnosis, joined by " and "; empty for none.
        part_of: Cause of which this one is a part.
        condition: Operating condition that this cause changes in one direction; empty for wear.
        parameters: Parameters that change.
        element: Elements that change, a name or a pattern.
        fallback: As in `ParameterChange`.
        optional: As in `ParameterChange`.
        per_joint: Whether the cause can affect the cylinder, spring or encoder of a single joint.
        meaning: Meaning of a magnitude, with its unit.
        healthy: Parameter whose value in the model is the healthy magnitude; empty if magnitudes
            are ratios to the model's value, or amounts that no model has.
        unit: Magnitude 1 in the parameter's unit.
        step: Function that applies a step to the healthy magnitude.
        default: Step to the default magnitude of the scenario.
        allowed: Steps of the smallest and the largest magnitude of the scenario, clipped to the
            bounds of the plugin's parameter.
        sides: Magnitudes in the fault bank and in benchmarks; empty if the cause is in neither.
        changes: Function that returns the changes at the options' magnitude.
        reference_config: Settings of the scenario's reference.
        effects: Effects of the diagnosis that this row defines.
        trials: Parameters of an effect that has a separate class in `leglab.diagnosis.effects`.
    """

    name: str
    summary: str = ""
    _: KW_ONLY
    effect: str = ""
    part_of: str = ""
    condition: str = ""
    parameters: tuple[str, ...]
    element: str = "*"
    fallback: bool = False
    optional: bool = False
    per_joint: bool = False
    meaning: str
    healthy: str = ""
    unit: float = 1.0
    step: Step = times
    default: float = 1.0
    allowed: tuple[float, float] = (1.0, 1.0)
    sides: tuple[Side, ...] = ()
    changes: Callable[["Cause", Options], tuple[ParameterChange, ...]] = set_or_scale
    reference_config: Mapping[str, Any] = field(default_factory=dict)
    effects: tuple[EffectRow, ...] = ()
    trials: tuple[Trials, ...] = ()

    @property
    def ratio(self) -> bool:
        """True if a magnitude is a ratio to the model's value."""
        return not self.healthy and self.step is times

    def healthy_magnitude(self, values: Healthy | None = None) -> float:
        """Returns the magnitude that changes nothing, from the model's values or plugin defaults.

        If elements differ, it is their extreme, so that a magnitude beyond it is a fault of all.
        """
        if not self.healthy:
            return 1.0 if self.ratio else 0.0
        falls = self.step(1.0, self.default) < 1.0
        value = (min if falls else max)(model_values(self.healthy, values))
        return _rounded(value / self.unit)

    def magnitude(self, step: float, healthy: float) -> float:
        """Applies a step to the healthy magnitude, within the bounds of the plugin's parameter."""
        value = _rounded(self.step(healthy, step))
        if not self.healthy:
            return value
        _, lower, upper = _plugin_row(self.healthy)
        return min(max(value, lower / self.unit), upper / self.unit)

    def magnitudes(self, steps: tuple[float, ...], healthy: float) -> tuple[float, ...]:
        """Returns the magnitudes at steps, without the repeats that clipping to bounds causes."""
        found = [self.magnitude(step, healthy) for step in steps]
        return tuple(m for last, m in zip([healthy, *found], found, strict=False) if m != last)

    def severity(self, values: Healthy | None = None) -> Severity:
        """Returns default and range of the scenario's magnitude; see `healthy_magnitude`."""
        healthy = self.healthy_magnitude(values)
        steps = (self.default, *self.allowed)
        default, lowest, highest = (self.magnitude(step, healthy) for step in steps)
        return Severity(meaning=self.meaning, default=default, lowest=lowest, highest=highest)


def model_values(parameter: str, values: Healthy | None) -> tuple[float, ...]:
    """Returns the values of a parameter in a model, or the plugin's default if it has none."""
    return (values and values(parameter)) or _plugin_row(parameter)[:1]


def _rounded(value: float) -> float:
    """Rounds a number to twelve digits, more than units and steps have."""
    return float(f"{value:.12g}")


@cache
def _plugin_row(parameter: str) -> tuple[float, float, float]:
    """Returns default and bounds of a parameter, of the cylinder plugin if several have it."""
    rows = (row for rows, _, _ in parameter_tables().values() for row in rows)
    return next((row[2], row[3], row[4]) for row in rows if row[0] == parameter)
