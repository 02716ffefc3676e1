"""Words from the shape of what was learned."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from leglab.diagnosis.remainder.part import Part, Period

Parity = Literal["odd", "even", "mixed"]

# Share of a curve's squares that must be odd, even or on one side of zero to be called so.
_CLEARLY = 0.85
# A curve saturates if it changes by less than this share of the whole in its outer quarters.
_FLAT = 0.12
# Quantiles of the data between which sizes are told.
_USUAL = (0.01, 0.99)
# Terms below this share of the largest are not told.
_TOLD = 0.1


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Shape of one additive term.

    Attributes:
        variable: "position", "velocity", "load" or "command".
        size: Half the difference of its largest and smallest value on the data [N m, N or 1].
        interval: Range of the data [unit of the variable].
        parity: Of a curve through zero input; None for positions and where one sign is missing.
        one_sided: Sign of the inputs on which it changes; None for both.
        saturating: Whether it is nearly flat in the outer halves of its range.
        rising: Whether it grows with the variable on the whole: against motion it falls.
        period: Of a position.
    """

    variable: str
    size: float
    interval: tuple[float, float]
    parity: Parity | None
    one_sided: Literal["positive", "negative"] | None
    saturating: bool
    rising: bool
    period: Period | None


@dataclass(frozen=True, kw_only=True)
class Described:
    """A learned part in words.

    Attributes:
        element: Joint or cylinder.
        unit: Of its sizes.
        shapes: Of its terms, the largest first.
        constant: Mean over the data.
        text: One sentence.
    """

    element: str
    unit: str
    shapes: tuple[Shape, ...]
    constant: float
    text: str

    def to_json(self) -> dict[str, Any]:
        """Returns it as JSON can hold it."""
        return asdict(self)


def describe(part: Part, inputs: Mapping[str, np.ndarray], unit: str) -> Described:
    """Words for a part.

    Args:
        part: Learned.
        inputs: Data that it was learned from, by variable.
        unit: Of the joint's position, "rad" or "m".
    """
    shapes = []
    constant = 0.0
    for variable, spline in part.terms.items():
        x = inputs[variable].ravel()
        constant += float(spline(x).mean())
        low, high = np.quantile(x, _USUAL).tolist()
        period = part.period if variable == "position" else None
        shapes.append(_shape(variable, spline, low, high, period))
    shapes.sort(key=lambda s: -s.size)
    force = "1" if part.oil else ("N m" if unit == "rad" else "N")
    told = [s for s in shapes if s.size >= _TOLD * shapes[0].size]
    flat = shapes[0].size < 0.2 * abs(constant)
    text = _constant(part, constant, force) if flat else ""
    if not flat:
        text = ", and ".join(_sentence(part, shape, force, unit) for shape in told)
    return Described(
        element=part.element, unit=force, shapes=tuple(shapes), constant=constant, text=text
    )


def _shape(variable: str, spline: Any, low: float, high: float, period: Period | None) -> Shape:
    x = np.linspace(low, high, 401)
    y = spline(x)
    parity: Parity | None = None
    one_sided: Literal["positive", "negative"] | None = None
    reach = min(-low, high)
    if variable != "position" and reach > 0.2 * max(-low, high):
        arm = np.linspace(0.0, reach, 201)
        zero = float(spline(np.zeros(1))[0])
        forth, back = spline(arm) - zero, spline(-arm) - zero
        odd, even = np.mean((0.5 * (forth - back)) ** 2), np.mean((0.5 * (forth + back)) ** 2)
        share = float(odd / (odd + even + 1e-300))
        parity = "odd" if share > _CLEARLY else "even" if share < 1.0 - _CLEARLY else "mixed"
        ahead = float(np.mean(forth**2) / (np.mean(forth**2) + np.mean(back**2) + 1e-300))
        if ahead > 0.95 or ahead < 0.05:
            one_sided = "positive" if ahead > 0.5 else "negative"
    size = 0.5 * float(np.ptp(y))
    outer = [np.ptp(y[: x.size // 4]), np.ptp(y[-(x.size // 4) :])]
    inner = abs(y[3 * x.size // 4] - y[x.size // 4])
    return Shape(
        variable=variable,
        size=size,
        interval=(low, high),
        parity=parity,
        one_sided=one_sided,
        saturating=bool(max(outer) < _FLAT * 2.0 * size and inner > size),
        rising=bool(np.corrcoef(x, y)[0, 1] > 0.0) if size > 0.0 else False,
        period=period,
    )


def _constant(part: Part, value: float, force: str) -> str:
    if part.oil:
        return f"a constant opening of {part.element}, {100 * value:.2g} % of full travel"
    kind = "torque" if force == "N m" else "force"
    return f"a constant {kind} on the {part.element}, {value:.3g} {force}"


def _sentence(part: Part, shape: Shape, force: str, unit: str) -> str:
    size = f"{100 * shape.size:.2g} % of full travel" if part.oil else f"{shape.size:.3g} {force}"
    kind = "torque" if force == "N m" else "force"
    thing = f"an opening of {part.element}" if part.oil else f"a {kind}"
    where = "" if part.oil else f" of the {part.element}"
    if shape.period is not None:
        period = shape.period
        seen = (shape.interval[1] - shape.interval[0]) / period.length
        size = f"{period.amplitudes[0]:.2g} {force}"
        if len(period.amplitudes) > 1:
            size += f" with {len(period.amplitudes) - 1} overtones"
        once = f" (the recordings show {seen:.1f} of it)" if seen < 1.5 else ""
        return f"{thing} that repeats every {period.length:.3g} {unit}{where}, {size}{once}"
    if shape.variable == "position":
        low, high = shape.interval
        way = f"between {low:.2g} and {high:.2g} {'m' if part.oil else unit}"
        return f"{thing} that depends on the position{where} {way}, {size}"
    side = {"positive": "forward", "negative": "backward"}.get(shape.one_sided or "")
    if shape.variable == "velocity" and not part.oil:
        if shape.parity == "odd":
            form = "like dry friction" if shape.saturating else "growing with speed"
            more = f"friction that the model lacks, {form}"
            less = f"less friction than the model has, {form}"
            return f"{less if shape.rising else more}{where}, {size}"
        if side:
            return f"{thing} that acts in {side} motion only{where}, {size}"
        if shape.parity == "even":
            return f"{thing} that depends on speed in either direction alike{where}, {size}"
        return f"{thing} of the velocity that differs by direction{where}, {size}"
    name = {"velocity": "speed", "load": "load", "command": "command"}[shape.variable]
    form = {"odd": ", odd", "even": ", alike for both signs", "mixed": ""}[shape.parity or "mixed"]
    if shape.one_sided:
        form = f", for {shape.one_sided} {name} only"
    flat = ", flat at both ends" if shape.saturating else ""
    return f"{thing} that depends on the {name}{where}{form}{flat}, {size}"
