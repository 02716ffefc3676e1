"""Heat maps, curves over varied settings, and histograms of a sweep.

Charts are dicts for the template of the page: texts, and positions along axes from 0 to 100.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from leglab.report.page.wording import number
from leglab.report.style import SERIES
from leglab.report.sweep.facts import NEVER, Facts, Quantity, axis_words, value_words
from leglab.runs.sweeps.rows import column

# Maximum number of rows and columns of a heat map, and number of bars of a histogram.
_MOST_ROWS, _MOST_COLUMNS, _BARS = 120, 20, 24
# Settings with many values are grouped into _CLASSES quantile classes; up to LISTED are listed.
_CLASSES, LISTED = 6, 8
# Shade of the worst finite value in a heat map that also has cells "never", whose shade is 1.
_REACHED = 0.6
# A heat map has no shades if its values differ by at most this share of the largest one.
_ALIKE = 0.02
# Width of a letter of a tick label, in hundredths of the axis on a wide screen.
_LETTER = 1.8
# Text for a missing value; a section of the page gives the reason.
NONE = "\u2013"
# Varied settings that the heat maps show.
_MAPPED = ("scenario", "controller", "severity", "seed")


def heat_maps(facts: Facts) -> list[dict[str, Any]]:
    """Returns heat maps of medians: rows are scenario and severity, columns controller or seed."""
    sized = (
        "SELECT *, median(severity) OVER (PARTITION BY scenario, class) AS size FROM (SELECT *,"
        f" ntile({_CLASSES}) OVER (PARTITION BY scenario ORDER BY severity) AS class FROM runs)"
        if facts.sizes > 3 * _CLASSES
        else "SELECT *, severity AS size FROM runs"
    )
    maps = []
    for quantity in facts.quantities:
        maps.append(_by_size(facts, quantity, sized, ""))
        if facts.seeds > 1:
            controllers = facts.rows("SELECT DISTINCT controller FROM runs ORDER BY 1")
            for (controller,) in controllers[:_MOST_COLUMNS]:
                maps.append(_by_size(facts, quantity, sized, controller))
    return [found for found in maps if found["rows"]]


def _by_size(facts: Facts, quantity: Quantity, source: str, controller: str) -> dict[str, Any]:
    """Returns medians over controllers or, for a `controller`, over its specimens (seeds)."""
    across, named = ("seed", "specimen (seed)") if controller else ("controller", "controller")
    own = "AND controller = '{}'".format(controller.replace("'", "''")) if controller else ""
    found = facts.rows(
        f"SELECT scenario, size, {across} AS across, {quantity.median} AS m FROM ({source})"
        f" WHERE status = 'ok' {own} GROUP BY ALL HAVING m IS NOT NULL"
        " ORDER BY scenario, size, across"
    )
    caption = f"{quantity.title}, by scenario with size and {named}"

    def told(place: tuple[str, float | None]) -> str:
        scenario, size = place
        return scenario if size is None else f"{scenario}, {number(size)}"

    medians = [((scenario, size), other, m) for scenario, size, other, m in found]
    shown = _heat_map(quantity, caption, "scenario, size", medians, told)
    if controller:
        shown["caption"] += f": {controller}"
    return {**shown, "folded": bool(controller)}


def _heat_map(
    quantity: Quantity,
    caption: str,
    corner: str,
    medians: Iterable[tuple[Any, Any, float]],
    told: Callable[[Any], str],
) -> dict[str, Any]:
    """Returns a heat map of medians, in which worse values have darker shades.

    Args:
        quantity: Quantity of the medians.
        caption: Caption of the heat map.
        corner: Heading of the first column.
        medians: Row, column and value of each cell; the order of the rows is kept.
        told: Function that returns the name of a row.

    Returns:
        Caption, headings, and named rows of cells (text, shade); a shade is in [0, 1] or None.
    """
    values = {(row, column): value for row, column, value in medians}
    columns = sorted({column for _, column in values})[:_MOST_COLUMNS]
    rows = list(dict.fromkeys(row for row, _ in values))[:_MOST_ROWS]
    known = [value for value in values.values() if value < NEVER]
    low, high = (min(known), max(known)) if known else (0.0, 0.0)
    # A finite time, however long, is better than "never", so its shade is at most _REACHED.
    most = _REACHED if len(known) < len(values) else 1.0

    def field(value: float | None) -> tuple[str, float | None]:
        if value is None:
            return NONE, None
        if value >= NEVER:
            return "never", 1.0
        text = number(quantity.factor * value)
        if high - low <= _ALIKE * max(abs(low), abs(high)):
            return text, None
        share = (value - low) / (high - low)
        return text, round(most * (share if quantity.bad > 0 else 1 - share), 3)

    return {
        "caption": caption,
        "head": (corner, *map(str, columns)),
        "rows": [(told(row), [field(values.get((row, name))) for name in columns]) for row in rows],
    }


def effects(facts: Facts) -> list[tuple[str, list[dict[str, Any]]]]:
    """Returns the name and the charts of each varied setting that heat maps do not show."""
    found = []
    for axis in facts.record.axes:
        if axis not in _MAPPED and column(axis) in facts.columns:
            shown = [_effect(facts, axis, quantity) for quantity in facts.quantities]
            found.append((axis_words(axis), [one for one in shown if one is not None]))
    return [(name, shown) for name, shown in found if shown]


def _effect(facts: Facts, axis: str, quantity: Quantity) -> dict[str, Any] | None:
    """Returns table and curves of medians over a setting; None if it has a single value."""
    name = f'"{column(axis)}"'
    ((kind, count),) = facts.rows(
        f"SELECT any_value(typeof({name})), count(DISTINCT {name}) FROM runs"
    )
    numeric, source = kind == "DOUBLE", f"SELECT *, {name} AS value FROM runs"
    if numeric and count > LISTED:
        source = (
            f"SELECT *, median({name}) OVER (PARTITION BY class) AS value FROM (SELECT *,"
            f" ntile({_CLASSES}) OVER (ORDER BY {name}) AS class FROM runs"
            f" WHERE {name} IS NOT NULL)"
        )
    found = facts.rows(
        f"SELECT value, scenario || ', ' || controller AS who, {quantity.median} AS m FROM"
        f" ({source}) WHERE status = 'ok' AND value IS NOT NULL GROUP BY ALL HAVING m IS NOT NULL"
        " ORDER BY value, who"
    )
    medians = {(value, who): m for value, who, m in found}
    known = [m for m in medians.values() if m < NEVER]
    title = f"{quantity.title}, by {axis_words(axis)}"
    table = _heat_map(quantity, title, axis_words(axis), found, value_words)
    _, *columns = table["head"]
    values = list(dict.fromkeys(value for value, _ in medians))[:_MOST_ROWS]
    if len(values) < 2 or not known:
        return None
    across = _places(values if numeric else list(range(len(values))))
    low, high = min(0.0, *known), max(known)
    span = (high - low) or 1.0
    curves = [
        (
            who,
            [
                (x, round(100.0 * (1.0 - (medians[value, who] - low) / span), 2))
                for x, value in zip(across, values, strict=True)
                if medians.get((value, who), NEVER) < NEVER
            ],
        )
        for who in columns[: len(SERIES)]
    ]
    told = "; ".join(
        f"{who}: "
        + ", ".join(f"{c[i][0]} at {value}" for value, c in table["rows"] if c[i][0] != NONE)
        for i, who in enumerate(columns)
    )
    return {
        "table": table,
        "alt": f"{title}. {told}.",
        "ticks": _ticks([(x, value) for x, (value, _) in zip(across, table["rows"], strict=True)]),
        "curves": curves,
        "low": number(quantity.factor * low),
        "high": number(quantity.factor * high),
    }


def _places(values: Sequence[float]) -> list[float]:
    """Returns positions, 0 to 100, of values on an axis; logarithmic beyond one decade."""
    low, high = min(values), max(values)
    scale = math.log if low > 0 and high / low > 10.0 else float
    ends = scale(low), scale(high)
    return [round(100.0 * (scale(v) - ends[0]) / (ends[1] - ends[0]), 2) for v in values]


def _ticks(places: Sequence[tuple[float, str]]) -> list[tuple[float, str]]:
    """Returns positions and labels of ticks, without labels that overlap the previous label."""
    kept: list[tuple[float, str]] = []
    for x, text in places:
        if not kept or x - kept[-1][0] > _LETTER * (len(text) + len(kept[-1][1]) + 2) / 2:
            kept.append((x, text))
    return kept


def distributions(facts: Facts) -> list[dict[str, Any]]:
    """Returns a histogram per quantity and controller, scaled to a tallest bar of height 1."""
    found = []
    for quantity in facts.quantities:
        name = quantity.name
        known = f"FROM runs WHERE status = 'ok' AND {name} IS NOT NULL"
        # Quantiles end the axis: with the outliers on it most runs would be in the first bar.
        ((low, high),) = facts.rows(
            f"SELECT quantile_cont({name}, 0.01), quantile_cont({name}, 0.99) {known}"
        )
        if low is None or not high > low:
            continue
        step = (high - low) / _BARS
        place = f"least({_BARS - 1}, greatest(0, floor(({name} - {low!r}) / {step!r})))"
        rows = []
        for controller, quantiles, bars in facts.rows(
            f"SELECT controller, quantile_cont({name}, [0.05, 0.5, 0.95]), list({place}) {known}"
            f" GROUP BY 1 ORDER BY 1 LIMIT {_MOST_COLUMNS}"
        ):
            counts = Counter(bars)
            most = max(counts.values())
            told = " · ".join(number(quantity.factor * value) for value in quantiles)
            shares = [round(counts[bar] / most, 3) for bar in range(_BARS)]
            rows.append({"name": controller, "told": told, "bars": shares})
        ends = {"low": number(quantity.factor * low), "high": number(quantity.factor * high)}
        found.append({"title": quantity.title, **ends, "rows": rows})
    return found
