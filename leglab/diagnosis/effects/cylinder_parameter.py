"""Effects that are a changed parameter of a hydraulic cylinder or its valve: a table."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from leglab.diagnosis.change import Change
from leglab.diagnosis.effects.base import Effect, EffectParameter, Group, register
from leglab.diagnosis.machine import CYLINDER, Machine

HYQ = "HyQ leg parameters (Ledezma 2016)"
VALVE = "tolerances of small servovalves (type 30 data sheets)"


@dataclass(frozen=True, kw_only=True)
class Row:
    """One parameter of `leglab.cylinder` as an effect's parameter.

    Attributes:
        name: Of the plugin parameter.
        trials: To screen; factors of the nominal value where `relative`, else values to add.
        tolerance: Standard deviation between good machines, in the same terms.
        lower: Smallest value, as a factor or as the value itself.
        upper: Largest value, likewise.
        relative: Whether trials, tolerance and bounds are factors of the nominal value.
        follows: Parameters that are shifted by the same difference (stiction stays above Coulomb).
    """

    name: str
    trials: tuple[float, ...]
    tolerance: float = 0.0
    lower: float
    upper: float
    relative: bool = True
    follows: tuple[str, ...] = ()


class CylinderEffect(Effect):
    """Base of effects that set plugin parameters of a cylinder; rows give which and how far."""

    rows: ClassVar[tuple[Row, ...]]

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """All cylinders."""
        return machine.instances(CYLINDER)

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The rows about the element's nominal values."""
        return tuple(_parameter(row, machine, element) for row in self.rows)

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Shifts the plugin parameters by the difference from nominal."""
        for row in self.rows:
            nominal = change.machine.parameter(element, row.name)
            difference = values[row.name] - nominal
            for name in (row.name, *row.follows):
                change.add_parameter(element, name, difference)


def _parameter(row: Row, machine: Machine, element: str) -> EffectParameter:
    nominal = machine.parameter(element, row.name)
    table = machine.base.elements[element][1].parameters[row.name]
    unit = nominal if row.relative else 1.0
    return EffectParameter(
        name=row.name,
        unit=table.unit,
        nominal=nominal,
        lower=max(row.lower * unit, table.minimum),
        upper=min(row.upper * unit, table.maximum),
        trials=tuple(t * nominal if row.relative else nominal + t for t in row.trials),
        tolerance=row.tolerance * unit,
    )


def define(
    name: str, group: Group, physics: str, source: str, excitation: str, *rows: Row
) -> type[Effect]:
    """Registers an effect that changes parameters of cylinders; arguments as in `Effect`."""
    body = {
        "name": name,
        "group": group,
        "physics": physics,
        "source": source,
        "excitation": excitation,
        "rows": rows,
        "__doc__": physics,
        "__module__": __name__,
    }
    title = "".join(part.title() for part in name.split("_"))
    return register(type(title, (CylinderEffect,), body))
