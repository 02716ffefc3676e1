"""Descriptions in words of learned forces and command offsets (parts of the remainder)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from leglab.diagnosis.remainder.part import Part, Periodicity
from leglab.diagnosis.thresholds import SMALL

Parity = Literal["odd", "even", "mixed"]
Side = Literal["positive", "negative"]

# Negligible share: of a term relative to the largest term, of the even or odd part of a curve, of
# the curve's change on one side of zero, or of its change in an outer quarter of the range.
_HARDLY = SMALL


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Shape of one additive term of a learned part, as a function of one variable."""

    variable: str
    size: float  #: Half the difference of its largest and smallest value on the data [N m, N or 1]
    interval: tuple[float, float]  #: Range of the data [unit of the variable]
    #: Parity about zero input; None for positions and if one sign of the input is missing.
    parity: Parity | None
    one_sided: Side | None  #: Sign of the input for which alone the term changes; None for both
    saturating: bool  #: Whether it is nearly flat in the outer quarters of its range
    rising: bool  #: Whether it rises with the variable (a resistance falls with velocity)
    period: Periodicity | None  #: Repetition over the position


@dataclass(frozen=True, kw_only=True)
class Described:
    """A learned part in words."""

    element: str
    unit: str  #: Unit of its magnitudes
    shapes: tuple[Shape, ...]  #: Shapes of its terms, the largest first
    constant: float  #: Mean of the part over the data
    text: str  #: Description in one sentence


def describe(part: Part, inputs: Mapping[str, np.ndarray], unit: str) -> Described:
    """Describes a part in words; `inputs` are the data of its fit, `unit` is the joint's unit."""
    found = [_shape(part, variable, inputs[variable]) for variable in part.terms]
    shapes = tuple(sorted(found, key=lambda shape: -shape.size))
    constant = sum(float(spline(inputs[v].ravel()).mean()) for v, spline in part.terms.items())
    force = "1" if part.oil else "N m" if unit == "rad" else "N"
    kind = "torque" if force == "N m" else "force"
    if shapes[0].size < _HARDLY * abs(constant):
        thing = f"opening of {part.element}" if part.oil else f"{kind} on the {part.element}"
        text = f"a constant {thing}, {_size(part, constant, force)}"
    else:
        told = [s for s in shapes if s.size >= _HARDLY * shapes[0].size]
        text = ", and ".join(_sentence(part, shape, kind, force, unit) for shape in told)
    return Described(element=part.element, unit=force, shapes=shapes, constant=constant, text=text)


def _shape(part: Part, variable: str, data: np.ndarray) -> Shape:
    spline = part.terms[variable]
    low, high = np.quantile(data, (0.01, 0.99)).tolist()
    x = np.linspace(low, high, 401)
    y = spline(x)
    parity: Parity | None = None
    one_sided: Side | None = None
    reach = min(-low, high)
    if variable != "position" and reach > _HARDLY * max(-low, high):
        arm = np.linspace(0.0, reach, 201)
        forth, back = (side - side[0] for side in (spline(arm), spline(-arm)))
        odd = _share((forth - back) ** 2, (forth + back) ** 2)
        ahead = _share(np.abs(forth), np.abs(back))
        parity = "odd" if odd > 1.0 - _HARDLY else "even" if odd < _HARDLY else "mixed"
        if not _HARDLY <= ahead <= 1.0 - _HARDLY:
            one_sided = "positive" if ahead > 0.5 else "negative"
    quarters = np.split(y[:400], 4)
    size, outer = 0.5 * float(np.ptp(y)), max(np.ptp(quarters[0]), np.ptp(quarters[-1]))
    inner = abs(quarters[-1][0] - quarters[1][0])
    return Shape(
        variable=variable,
        size=size,
        interval=(low, high),
        parity=parity,
        one_sided=one_sided,
        saturating=bool(outer < _HARDLY * 2.0 * size and inner > size),
        rising=size > 0.0 and bool(np.corrcoef(x, y)[0, 1] > 0.0),
        period=part.period if variable == "position" else None,
    )


def _share(one: np.ndarray, other: np.ndarray) -> float:
    """Computes the sum of the first array as a share of the sum of both arrays."""
    return float(np.sum(one) / (np.sum(one) + np.sum(other) + 1e-300))


def _size(part: Part, value: float, force: str, digits: int = 3) -> str:
    return f"{100 * value:.2g} % of full travel" if part.oil else f"{value:.{digits}g} {force}"


def _sentence(part: Part, shape: Shape, kind: str, force: str, unit: str) -> str:
    size = _size(part, shape.size, force)
    thing = f"an opening of {part.element}" if part.oil else f"a {kind}"
    where = "" if part.oil else f" of the {part.element}"
    low, high = shape.interval
    if (period := shape.period) is not None:
        size = _size(part, period.amplitudes[0], force, digits=2)
        if len(period.amplitudes) > 1:
            size += f" with {len(period.amplitudes) - 1} overtones"
        seen = (high - low) / period.length
        once = f" (the recordings show {seen:.1f} of it)" if seen < 1.5 else ""
        return f"{thing} that repeats every {period.length:.3g} {unit}{where}, {size}{once}"
    if shape.variable == "position":
        way = f"between {low:.2g} and {high:.2g} {'m' if part.oil else unit}"
        return f"{thing} that depends on the position{where} {way}, {size}"
    if shape.variable == "velocity" and not part.oil:
        if shape.parity == "odd":
            less, more = "less friction than the model has", "friction that the model lacks"
            form = "like dry friction" if shape.saturating else "growing with speed"
            return f"{less if shape.rising else more}, {form}{where}, {size}"
        if shape.one_sided:
            side = "forward" if shape.one_sided == "positive" else "backward"
            return f"{thing} that acts in {side} motion only{where}, {size}"
        if shape.parity == "even":
            return f"{thing} that depends on speed in either direction alike{where}, {size}"
        return f"{thing} of the velocity that differs by direction{where}, {size}"
    name = "speed" if shape.variable == "velocity" else shape.variable
    form = {"odd": ", odd", "even": ", alike for both signs"}.get(shape.parity or "", "")
    if shape.one_sided:
        form = f", for {shape.one_sided} {name} only"
    flat = ", flat at both ends" if shape.saturating else ""
    return f"{thing} that depends on the {name}{where}{form}{flat}, {size}"
