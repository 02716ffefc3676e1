"""The record of a cause: its names, what it changes, and its magnitudes as steps from healthy."""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from functools import cache
from typing import Any, Literal

from leglab._native.hydraulics import parameter_tables
from leglab.base.scenario import Healthy, Options, ParameterChange, Severity

# Value at a step from the healthy one.
Step = Callable[[float, float], float]


def times(healthy: float, step: float) -> float:
    """A factor."""
    return healthy * step


def plus(healthy: float, step: float) -> float:
    """A difference in the unit of the magnitude."""
    return healthy + step


@dataclass(frozen=True)
class Side:
    """Magnitudes on one side of the healthy one, as steps from it, from small to large."""

    bank: tuple[float, ...]  #: Nodes of the curve in the bank of faults
    #: Of the benchmarks: none is a node of the bank, and the last lies beyond the bank's last.
    benchmark: tuple[float, float, float]


@dataclass(frozen=True)
class Trials:
    """A parameter of an effect of the diagnosis, by steps from the model's value.

    Attributes:
        parameter: Of `leglab.cylinder`.
        steps: Values to try.
        step: `times`: steps, tolerance and bounds are factors of the model's value; `plus`: steps
            are added to it, and the others are values.
        tolerance: This and what follows as in `leglab.diagnosis.effects.EffectParameter`.
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
    """An effect of the diagnosis that shifts parameters of a cylinder; texts as of an `Effect`."""

    name: str
    trials: tuple[Trials, ...]
    _: KW_ONLY
    group: str
    physics: str
    source: str
    excitation: str


def set_or_scale(cause: "Cause", options: Options) -> tuple[ParameterChange, ...]:
    """Sets the parameters to the magnitude, or scales them where it is a ratio."""
    change = options.scale if cause.ratio else options.set
    value = cause.unit * options.severity
    where = {"optional": cause.optional, "fallback": cause.fallback}
    return tuple(change(name, value, cause.element, **where) for name in cause.parameters)


@dataclass(frozen=True)
class Cause:
    """A cause with its names as a scenario, while the machine runs and in a diagnosis.

    Attributes:
        name: Of its scenario, and while the machine runs.
        summary: Line of the scenario; empty of a cause that is no scenario.
        effect: Names of its effects in a diagnosis, joined by " and "; empty for none.
        part_of: Cause of which it is one part.
        condition: Operating condition of which it is one direction; empty of wear.
        parameters: What changes.
        element: Elements that change, a name or a pattern.
        fallback: As in `ParameterChange`.
        optional: As in `ParameterChange`.
        per_joint: Whether it can happen to the cylinder, spring or encoder of one joint alone.
        meaning: What a magnitude says, with its unit.
        healthy: Parameter whose value in the model is the healthy magnitude; empty of a ratio to
            the model's value, and of an amount that no model has.
        unit: Magnitude 1 in the parameter's own unit.
        step: How steps count from the healthy magnitude.
        default: Step of the scenario's default.
        allowed: Steps of the smallest and the largest magnitude of the scenario, which the bounds
            of the plugin's parameter cut.
        sides: Magnitudes in the bank of faults and in benchmarks; none where it is in neither.
        changes: Makes the changes at the options' magnitude.
        reference_config: Settings of the scenario's reference.
        effects: Effects of the diagnosis that this row defines.
        trials: Parameters of an effect that is a class of its own in `leglab.diagnosis.effects`.
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
        """Whether a magnitude is a ratio to the model's value."""
        return not self.healthy and self.step is times

    def healthy_magnitude(self, values: Healthy | None = None) -> float:
        """Magnitude that changes nothing, of the model's values or else the plugins' defaults.

        Where elements differ it is the one beyond which a magnitude is a fault of all.
        """
        if not self.healthy:
            return 1.0 if self.ratio else 0.0
        falls = self.step(1.0, self.default) < 1.0
        value = (min if falls else max)(model_values(self.healthy, values))
        return _rounded(value / self.unit)

    def magnitude(self, step: float, healthy: float) -> float:
        """Magnitude at a step from the healthy one, within the plugin's bounds."""
        value = _rounded(self.step(healthy, step))
        if not self.healthy:
            return value
        _, lower, upper = _plugin_row(self.healthy)
        return min(max(value, lower / self.unit), upper / self.unit)

    def magnitudes(self, steps: tuple[float, ...], healthy: float) -> tuple[float, ...]:
        """Magnitudes at steps, without those that a bound makes those before."""
        found = [self.magnitude(step, healthy) for step in steps]
        return tuple(m for last, m in zip([healthy, *found], found, strict=False) if m != last)

    def severity(self, values: Healthy | None = None) -> Severity:
        """Magnitudes that the scenario may have, of the model's values as above."""
        healthy = self.healthy_magnitude(values)
        steps = (self.default, *self.allowed)
        default, lowest, highest = (self.magnitude(step, healthy) for step in steps)
        return Severity(meaning=self.meaning, default=default, lowest=lowest, highest=highest)


def model_values(parameter: str, values: Healthy | None) -> tuple[float, ...]:
    """Values of a parameter in a model; the plugin's default without one that has it."""
    return (values and values(parameter)) or _plugin_row(parameter)[:1]


def _rounded(value: float) -> float:
    """A number to twelve digits, which is more than units and steps have."""
    return float(f"{value:.12g}")


@cache
def _plugin_row(parameter: str) -> tuple[float, float, float]:
    """Default and bounds of a plugin's parameter, the cylinder's where several have it."""
    rows = (row for rows, _, _ in parameter_tables().values() for row in rows)
    return next((row[2], row[3], row[4]) for row in rows if row[0] == parameter)
