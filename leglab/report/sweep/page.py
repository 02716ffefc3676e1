"""The page of a sweep: tables, heat maps, distributions, and the runs that went worst."""

import base64
import json
import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from markupsafe import Markup

from leglab.base.output import write_atomically
from leglab.machine.changes import parameter_units
from leglab.report.film.encoder import film_bytes, still_bytes
from leglab.report.page.shell import Section, Table, render
from leglab.report.page.wording import listed, number, readable, readable_unit
from leglab.report.run.page import PAGE
from leglab.report.style import SERIES
from leglab.runs.sweeps.outcome import recording_folder
from leglab.runs.sweeps.plan import SweepPlan
from leglab.runs.sweeps.query import Answer, questions
from leglab.runs.sweeps.rows import column
from leglab.runs.sweeps.store import SWEEP, SweepRecord, read_record
from leglab.runs.sweeps.tuning import tuned

# Rows and columns of a heat map, bars of a distribution, runs of the list of the worst.
_MOST_ROWS, _MOST_COLUMNS, _BARS, MOST_FILMS = 120, 20, 24, 12
# Most that a film takes on the page [byte].
_FILM = 3_000_000
# Controllers that the headline tells of.
_TOLD = 4
# Sizes and settings that are drawn, not listed, are shown in so many classes.
_CLASSES, _LISTED = 6, 8
# Shade of the worst value that a run reached, where others never reached any.
_REACHED = 0.6
# Values of a table that differ by no larger share than this have no shade.
_ALIKE = 0.02
# No value: the page says elsewhere why.
_NONE = "\u2013"
# Stands for a time that a run never reaches, in medians [s].
_NEVER = 1e9
# Axes that the heat maps show.
_MAPPED = ("scenario", "controller", "severity", "seed")


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Quantity shown by a heat map or a distribution.

    Attributes:
        name: Column of the dataset.
        title: What it is, with the unit.
        factor: To the unit.
        bad: +1 where more is worse, -1 where less is.
        never: What stands for runs that have none though one could be told.
    """

    name: str
    title: str
    factor: float
    bad: int
    never: str = ""


T90 = Quantity(name="t90_s", title="90 % undone after, s", factor=1.0, bad=1, never="never")
RECOVERED = Quantity(name="recovered", title="undone at the end, %", factor=100.0, bad=-1)
END = Quantity(name="end_rad", title="error at the end, mrad", factor=1e3, bad=1)
WHOLE = Quantity(name="rms_rad", title="error of the whole run, mrad", factor=1e3, bad=1)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One field of a heat map: its text, and how bad it is from 0 to 1; None for nothing there."""

    text: str
    shade: float | None


@dataclass(frozen=True, kw_only=True)
class HeatMap:
    """A table whose fields are shaded the more the worse they are."""

    caption: str
    head: Sequence[str]
    rows: Sequence[tuple[str, Sequence[Cell]]]
    folded: bool = False


@dataclass(frozen=True, kw_only=True)
class Effect:
    """Medians of a quantity over the values of a setting, as a table and as curves.

    Attributes:
        table: A row a value.
        alt: The curves in words.
        values: Places of the values along the axis, and the values as text.
        curves: Names with points, both coordinates from 0 to 100, high up 0.
        low: Lower end of the vertical axis as text.
        high: Its upper end.
    """

    table: HeatMap
    alt: str
    values: Sequence[tuple[float, str]]
    curves: Sequence[tuple[str, Sequence[tuple[float, float]]]]
    low: str
    high: str


@dataclass(frozen=True, kw_only=True)
class Distribution:
    """How many runs have which value, as bars from low to high: heights from 0 to 1."""

    name: str
    told: str
    bars: Sequence[float]


@dataclass(frozen=True, kw_only=True)
class Distributions:
    """Distributions of one quantity with one axis."""

    title: str
    low: str
    high: str
    rows: Sequence[Distribution]


@dataclass(frozen=True, kw_only=True)
class Film:
    """A film as the page shows it: its data, a still, its file's name, and what it is of."""

    data: Markup
    still: str
    file: str
    text: str


def write_sweep_page(
    folder: Path, path: Path | None = None, *, films: Mapping[int, Path] | None = None
) -> Path:
    """Writes the page of a sweep, also of one that is not whole yet.

    Args:
        folder: Of the sweep.
        path: The page; None for report.html in the folder. An earlier one is replaced.
        films: By the numbers of the runs that they show.

    Raises:
        LeglabError: The folder holds no sweep, one of its files is damaged, or the page cannot be
            written.
    """
    path = path or folder / PAGE
    text = page(folder, films)
    write_atomically(path, lambda stream: stream.write(text.encode()))
    return path


def worst_runs(folder: Path, most: int) -> tuple[int, ...]:
    """Numbers of the runs that went worst, as the page lists them.

    Args:
        folder: Of the sweep.
        most: How many, `MOST_FILMS` at most.

    Raises:
        LeglabError: The folder holds no sweep, or one of its files is damaged.
    """
    record = read_record(folder)
    with questions(folder) as answered:
        return tuple(row[0] for row in _worst_runs(_Facts(folder, record, answered))[:most])


def page(folder: Path, films: Mapping[int, Path] | None = None) -> str:
    """The page as one file that needs no other and runs no script."""
    record = read_record(folder)
    with questions(folder) as answered:
        return _render(_Facts(folder, record, answered), films or {})


def _render(facts: "_Facts", films: Mapping[int, Path]) -> str:
    effects = _effects(facts)
    links = [
        ("summary", "Summary"),
        ("numbers", "Numbers"),
        ("maps", "Heat maps"),
        *[("varied", "Settings that were varied")] * bool(effects),
        ("distributions", "Distributions"),
        ("worst", "Worst runs"),
        ("settings", "Settings"),
    ]
    return render(
        "sweep.html",
        kind="sweep",
        title=f"Sweep {facts.folder.resolve().name}",
        headline=_headline(facts),
        sections=_sections(facts),
        table=_groups(facts),
        maps=_maps(facts),
        effects=effects,
        links=links,
        distributions=_distributions(facts),
        worst=_worst(facts),
        films=_films(facts, films),
        commands=_commands(facts),
        failed=_failed(facts),
        settings=_settings(facts.record),
    )


def _tuned(facts: "_Facts") -> Section:
    """Results of tuned blocks; the titles of their settings are columns."""
    plan = SweepPlan(facts.record.plan, SWEEP)
    names = ["run", "status", *dict.fromkeys(points.tune.metric for points in plan.tuned)]
    names += dict.fromkeys(column(name) for points in plan.tuned for name in points.ranges)
    columns = ", ".join(f'"{name}"' for name in names)
    rows = [dict(zip(names, row, strict=True)) for row in facts.rows(f"SELECT {columns} FROM runs")]
    lines = tuple(str(found) for found in tuned(plan, rows))
    return Section(title="What did tuning find?", lines=lines)


class _Facts:
    """Answers of the dataset that several parts of the page need."""

    def __init__(
        self, folder: Path, record: SweepRecord, answered: Callable[[str], Answer]
    ) -> None:
        self.folder, self.record, self._answered = folder, record, answered
        self.columns = set(answered("SELECT * FROM runs LIMIT 0").names)
        first = self.rows(
            "SELECT count(*), count(*) FILTER (status = 'failed'), count(t90_s),"
            " count(recovered), count(end_rad), count(DISTINCT severity), count(DISTINCT seed)"
            " FROM runs"
        )[0]
        self.done, self.failed, _, told, ends, self.sizes, self.seeds = first
        # Short runs have no strides to take errors over.
        self.told, self.error = bool(told), END if ends else WHOLE
        self.judged = told

    def rows(self, sql: str) -> tuple[tuple[Any, ...], ...]:
        return self._answered(sql).rows

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return (T90, RECOVERED, self.error) if self.told else (self.error,)


def _headline(facts: _Facts) -> str:
    total = facts.record.runs
    parts = [
        f"{facts.done:,} of {total:,} runs are made" if facts.done < total else f"{total:,} runs"
    ]
    if facts.failed:
        parts.append(f"{facts.failed:,} of them failed")
    if facts.told:
        found = facts.rows(
            f"SELECT controller, {_median(T90)} AS t90,"
            " count(*) FILTER (t90_s IS NULL), count(*), median(recovered) FROM runs"
            " WHERE recovered IS NOT NULL GROUP BY 1 ORDER BY t90, 5 DESC, 1"
        )
        # Controllers have nothing in common that a median over all of them could tell.
        told = []
        for controller, t90, never, count, recovered in found[:_TOLD]:
            when = "never" if t90 >= _NEVER else f"after {number(t90)} s"
            line = (
                f"{controller} undoes {number(100 * recovered)} % of the damage, nine tenths {when}"
            )
            told.append(line + (f" ({never:,} of {count:,} never)" if never else ""))
        of = f" of the {facts.judged:,} with damage" if facts.judged < facts.done else ""
        parts.append(f"in the median{of} " + ", ".join(told))
        if len(found) > _TOLD:
            parts.append(f"{len(found) - _TOLD} controllers more stand in the table")
    return "; ".join(parts)


def _sections(facts: _Facts) -> list[Section]:
    axes = []
    for axis in facts.record.axes:
        name = column(axis)
        if name not in facts.columns:
            continue
        (count, low, high) = facts.rows(
            f'SELECT count(DISTINCT "{name}"), min("{name}"), max("{name}") FROM runs'
        )[0]
        if count <= _LISTED:
            found = facts.rows(
                f'SELECT DISTINCT "{name}" FROM runs WHERE "{name}" IS NOT NULL ORDER BY 1'
            )
            axes.append((_axis_words(axis), listed(tuple(_text(row[0]) for row in found))))
        else:
            axes.append((_axis_words(axis), f"{count:,} values, {_text(low)} to {_text(high)}"))
    sections = [
        Section(
            title="What was varied?",
            lines=tuple(told for _, told in axes) or ("Nothing: it is one run.",),
            names=tuple(name for name, _ in axes),
        )
    ]
    best = facts.rows(
        f"SELECT controller, median({facts.error.name}) AS e, count(*) FROM runs"
        f" WHERE status = 'ok' AND {facts.error.name} IS NOT NULL GROUP BY 1 ORDER BY e"
    )
    if len(best) > 1:
        lines = tuple(
            f"{number(1e3 * error)} mrad in the median of {count:,} runs"
            for _, error, count in best
        )
        sections.append(
            Section(
                title=f"Who follows most closely ({facts.error.title.partition(',')[0]})?",
                lines=lines,
                names=tuple(name for name, _, _ in best),
            )
        )
    if untold := _untold(facts):
        sections.append(untold)
    if any("tune" in block for block in facts.record.plan.get("block", ())):
        sections.append(_tuned(facts))
    return sections


def _untold(facts: _Facts) -> Section | None:
    """Why runs have no figures of damage and of what was undone; None where all have."""
    if "not_told" not in facts.columns:
        return None
    found = facts.rows(
        "SELECT coalesce(not_told, 'it failed'), count(*),"
        " string_agg(DISTINCT scenario || ', ' || controller, '; ' ORDER BY"
        " scenario || ', ' || controller) FROM runs WHERE recovered IS NULL"
        f" GROUP BY 1 ORDER BY 2 DESC LIMIT {_MOST_ROWS}"
    )
    lines = tuple(f"{count:,} runs ({who}): {reason}." for reason, count, who in found)
    title = "Why do runs have no damage and nothing undone?"
    return Section(title=title, lines=lines) if lines else None


def _groups(facts: _Facts) -> Table:
    """One line a scenario and controller."""
    found = facts.rows(
        "SELECT scenario, controller, count(*), count(*) FILTER (status = 'failed'),"
        " median(before_rad), median(rms_rad), median(end_rad), median(damage_rad),"
        " median(recovered), min(recovered),"
        f" {_median(T90)}, max(t90_s),"
        " count(*) FILTER (t90_s IS NULL AND recovered IS NOT NULL), max(worst_2s_rad),"
        " median(valve_travel / came_to_s), median(energy_j / came_to_s)"
        f" FROM runs GROUP BY ALL ORDER BY 1, 2 LIMIT {_MOST_ROWS}"
    )
    rows = []
    for scenario, controller, count, failed, *values in found:
        before, whole, end, damage, undone, least, t90, last, never, worst, travel, power = values
        rows.append(
            (
                scenario,
                controller,
                f"{count:,}",
                f"{failed:,}" if failed else "",
                *(_scaled(value, 1e3) for value in (before, whole, end, damage)),
                *(_scaled(value, 100.0) for value in (undone, least)),
                "never" if t90 is not None and t90 >= _NEVER else _scaled(t90),
                _scaled(last),
                f"{never:,}" if never else "",
                _scaled(worst, 1e3),
                _scaled(travel),
                _scaled(power),
            )
        )
    head = [
        *("scenario", "controller", "runs", "failed", "before, mrad", "whole run", "end", "damage"),
        *("undone, %", "least", "90 % after, s", "last", "never", "worst 2 s, mrad"),
        *("valve travel, 1/s", "power, W"),
    ]
    return _filled(
        Table(
            caption="Medians over runs; errors are RMS over joints and time, of slides in mm. "
            "least, last and worst are of single runs; never: runs that did not undo nine tenths",
            head=head,
            rows=rows,
            words=2,
        )
    )


def _filled(table: Table) -> Table:
    """The table without columns of numbers that hold nothing, which its caption names."""
    places = range(len(table.head))
    kept = [i for i in places if i < table.words or any(row[i] for row in table.rows)]
    names = [table.head[i].partition(",")[0] for i in places if i not in kept]
    empty = tuple(name for name in names if name != "failed")
    why = ": the summary says why" if empty else ""
    told = f". No run has a value of {listed(empty, 'or')}{why}" if empty else ""
    return replace(
        table,
        caption=f"{table.caption}{told}",
        head=[table.head[i] for i in kept],
        rows=[[row[i] or _NONE for i in kept] for row in table.rows],
    )


def _maps(facts: _Facts) -> list[HeatMap]:
    classes = facts.sizes > 3 * _CLASSES
    sized = (
        "SELECT *, median(severity) OVER (PARTITION BY scenario, class) AS size FROM (SELECT *,"
        f" ntile({_CLASSES}) OVER (PARTITION BY scenario ORDER BY severity) AS class FROM runs)"
        if classes
        else "SELECT *, severity AS size FROM runs"
    )
    maps = []
    for quantity in facts.quantities:
        maps += _map(facts, quantity, sized, "controller", "median", folded=False)
        if facts.seeds > 1:
            controllers = facts.rows("SELECT DISTINCT controller FROM runs ORDER BY 1")
            for (controller,) in controllers[:_MOST_COLUMNS]:
                own = f"SELECT * FROM ({sized}) WHERE controller = {_quoted(controller)}"
                maps += _map(facts, quantity, own, "seed", controller, folded=True)
    return maps


def _map(
    facts: _Facts, quantity: Quantity, source: str, across: str, label: str, *, folded: bool
) -> list[HeatMap]:
    """Medians by scenario and size, over something; none where there is no value at all."""
    found = facts.rows(
        f"SELECT scenario, size, {across} AS across, {_median(quantity)} AS m FROM ({source})"
        " WHERE status = 'ok' GROUP BY ALL HAVING m IS NOT NULL ORDER BY scenario, size, across"
    )
    if not found:
        return []
    columns = list(dict.fromkeys(sorted(row[2] for row in found)))[:_MOST_COLUMNS]
    places = list(dict.fromkeys((row[0], row[1]) for row in found))[:_MOST_ROWS]
    values = {((row[0], row[1]), row[2]): row[3] for row in found}
    names = [f"{s}, {number(size)}" if size is not None else s for s, size in places]
    over = "specimen (seed)" if across == "seed" else across
    caption = f"{quantity.title}, by scenario with size and {over}"
    if folded:
        caption += f": {label}"
    head = ("scenario, size", *(str(x) for x in columns))
    rows = _shaded(quantity, places, columns, values)
    shown = list(zip(names, rows, strict=True))
    return [HeatMap(caption=caption, head=head, rows=shown, folded=folded)]


def _median(quantity: Quantity) -> str:
    """Median in SQL; of a time that some runs never reach, `_NEVER` where most do not."""
    value = quantity.name
    if quantity.never:
        value = f"CASE WHEN recovered IS NULL THEN NULL ELSE coalesce({value}, {_NEVER}) END"
    return f"median({value})"


def _shaded(
    quantity: Quantity,
    rows: Sequence[Any],
    columns: Sequence[Any],
    values: Mapping[tuple[Any, Any], float],
) -> list[list[Cell]]:
    """Fields of a heat map: the worst has the strongest shade, values that are alike have none."""
    known = [v for v in values.values() if v < _NEVER]
    low, high = (min(known), max(known)) if known else (0.0, 0.0)
    # A value that was reached, however late, is not as bad as none.
    most = _REACHED if len(known) < len(values) else 1.0

    def field(value: float | None) -> Cell:
        if value is None:
            return Cell(text=_NONE, shade=None)
        if value >= _NEVER:
            return Cell(text=quantity.never, shade=1.0)
        text = number(quantity.factor * value)
        if high - low <= _ALIKE * max(abs(low), abs(high)):
            return Cell(text=text, shade=None)
        share = (value - low) / (high - low)
        return Cell(text=text, shade=round(most * (share if quantity.bad > 0 else 1 - share), 3))

    return [[field(values.get((row, column))) for column in columns] for row in rows]


def _effects(facts: _Facts) -> list[tuple[str, list[Effect]]]:
    """What every setting does that the heat maps do not show, by its name."""
    found = []
    for axis in facts.record.axes:
        if axis in _MAPPED or column(axis) not in facts.columns:
            continue
        effects = [e for quantity in facts.quantities if (e := _effect(facts, axis, quantity))]
        if effects:
            found.append((_axis_words(axis), effects))
    return found


def _effect(facts: _Facts, axis: str, quantity: Quantity) -> Effect | None:
    """Medians by the values of a setting, of every scenario and controller that it varies for."""
    name = f'"{column(axis)}"'
    ((kind, count),) = facts.rows(
        f"SELECT any_value(typeof({name})), count(DISTINCT {name}) FROM runs"
    )
    numeric, source = kind == "DOUBLE", f"SELECT *, {name} AS value FROM runs"
    if numeric and count > _LISTED:
        source = (
            f"SELECT *, median({name}) OVER (PARTITION BY class) AS value FROM (SELECT *,"
            f" ntile({_CLASSES}) OVER (ORDER BY {name}) AS class FROM runs"
            f" WHERE {name} IS NOT NULL)"
        )
    found = facts.rows(
        f"SELECT value, scenario || ', ' || controller AS who, {_median(quantity)} AS m FROM"
        f" ({source}) WHERE status = 'ok' AND value IS NOT NULL GROUP BY ALL HAVING m IS NOT NULL"
        " ORDER BY value, who"
    )
    values = list(dict.fromkeys(row[0] for row in found))[:_MOST_ROWS]
    if len(values) < 2:
        return None
    columns = list(dict.fromkeys(sorted(row[1] for row in found)))[:_MOST_COLUMNS]
    medians = {(row[0], row[1]): row[2] for row in found}
    shown = [_text(value) for value in values]
    rows = list(zip(shown, _shaded(quantity, values, columns, medians), strict=True))
    title = f"{quantity.title}, by {_axis_words(axis)}"
    head = (_axis_words(axis), *columns)
    across = _places(values if numeric else list(range(len(values))))
    known = [v for v in medians.values() if v < _NEVER]
    if not known:
        return None
    low, high = min(0.0, *known), max(known)
    span = (high - low) or 1.0
    curves = [
        (
            name,
            [
                (x, round(100.0 * (1.0 - (medians[value, name] - low) / span), 2))
                for x, value in zip(across, values, strict=True)
                if medians.get((value, name), _NEVER) < _NEVER
            ],
        )
        for name in columns
    ]
    told = "; ".join(
        f"{name}: "
        + ", ".join(
            f"{cell.text} at {value}" for value, cells in rows if (cell := cells[i]).text != _NONE
        )
        for i, name in enumerate(columns)
    )
    return Effect(
        table=HeatMap(caption=title, head=head, rows=rows),
        alt=f"{title}. {told}.",
        values=list(zip(across, shown, strict=True)),
        curves=curves[: len(SERIES)],
        low=number(quantity.factor * low),
        high=number(quantity.factor * high),
    )


def _places(values: Sequence[float]) -> list[float]:
    """Places along an axis from 0 to 100, logarithmic where values span more than a decade."""
    low, high = min(values), max(values)
    scale = math.log if low > 0 and high / low > 10.0 else float
    ends = scale(low), scale(high)
    return [round(100.0 * (scale(v) - ends[0]) / (ends[1] - ends[0]), 2) for v in values]


def _axis_words(axis: str) -> str:
    """A setting as one reads it: "internal leakage", "memory of the controller"."""
    table, _, name = axis.rpartition(".")
    owner = {
        "controller_config": " of the controller",
        "reference_config": " of the reference",
        "sensors": " of the sensors",
    }
    first, _, rest = table.partition(".")
    if first == "parameters":
        unit = readable_unit(parameter_units().get(name, ""))
        return readable(name) + (f" of {rest}" if rest else "") + (f" [{unit}]" if unit else "")
    return readable(name) + owner.get(table, "")


def _distributions(facts: _Facts) -> list[Distributions]:
    return [found for quantity in facts.quantities if (found := _distribution(facts, quantity))]


def _distribution(facts: _Facts, quantity: Quantity) -> Distributions | None:
    name = quantity.name
    # A few far ones would press all others into the first bar.
    ends = facts.rows(
        f"SELECT quantile_cont({name}, 0.01), quantile_cont({name}, 0.99) FROM runs"
        f" WHERE status = 'ok' AND {name} IS NOT NULL"
    )[0]
    if ends[0] is None or not ends[1] > ends[0]:
        return None
    low, high = ends
    step = (high - low) / _BARS
    found = facts.rows(
        f"SELECT controller, least({_BARS - 1}, greatest(0, floor(({name} - {low!r}) / {step!r})))"
        f" AS bar, count(*) FROM runs WHERE status = 'ok' AND {name} IS NOT NULL GROUP BY ALL"
    )
    told = facts.rows(
        f"SELECT controller, quantile_cont({name}, [0.05, 0.5, 0.95]) FROM runs"
        f" WHERE status = 'ok' AND {name} IS NOT NULL GROUP BY 1 ORDER BY 1"
    )
    rows = []
    for controller, quantiles in told[:_MOST_COLUMNS]:
        counts = [0] * _BARS
        for other, bar, count in found:
            if other == controller:
                counts[int(bar)] = count
        most = max(counts)
        middle = " · ".join(number(quantity.factor * q) for q in quantiles)
        rows.append(
            Distribution(name=controller, told=middle, bars=[round(c / most, 3) for c in counts])
        )
    return Distributions(
        title=quantity.title,
        low=number(quantity.factor * low),
        high=number(quantity.factor * high),
        rows=rows,
    )


def _worst_runs(facts: _Facts) -> tuple[tuple[Any, ...], ...]:
    """Number, scenario, controller, size, seed, element, error, t90, share undone."""
    if facts.told:
        rule = "WHERE recovered IS NOT NULL ORDER BY recovered, run"
    else:
        rule = f"WHERE {facts.error.name} IS NOT NULL ORDER BY {facts.error.name} DESC, run"
    return facts.rows(
        f"SELECT run, scenario, controller, severity, seed, element, {facts.error.name}, t90_s,"
        f" recovered FROM runs {rule} LIMIT {MOST_FILMS}"
    )


def _worst(facts: _Facts) -> Table:
    by = "by the share of the damage that is undone" if facts.told else f"by {facts.error.title}"
    found = _worst_runs(facts)
    rows = [
        (
            str(run),
            scenario,
            controller,
            element or "",
            _scaled(severity),
            str(seed),
            _scaled(error, 1e3),
            "" if recovered is None else _scaled(t90) or "never",
            _scaled(recovered, 100.0),
        )
        for run, scenario, controller, severity, seed, element, error, t90, recovered in found
    ]
    head = ("run", "scenario", "controller", "element", "size", "seed", facts.error.title)
    return _filled(
        Table(
            caption=f"The worst runs, {by}",
            head=(*head, "90 % undone after, s", "undone, %"),
            rows=rows,
            words=4,
        )
    )


def _films(facts: _Facts, films: Mapping[int, Path]) -> list[Film]:
    """The films that there are, in the order of the table."""
    return [
        Film(
            data=Markup(base64.b64encode(film_bytes(films[run], _FILM)).decode()),
            still=base64.b64encode(still_bytes(films[run])).decode(),
            file=films[run].name,
            text=f"Run {run}: {scenario} {_scaled(severity)}, {controller}, seed {seed}"
            + (f", of the {element} alone" if element else ""),
        )
        for run, scenario, controller, severity, seed, element, *_ in _worst_runs(facts)
        if run in films
    ]


def _commands(facts: _Facts) -> list[str]:
    """How to film the worst runs."""
    place = shlex.quote(str(facts.folder))
    load = "".join(f" --load {shlex.quote(source)}" for source in facts.record.load)
    return [
        f"leglab sweep {place}/{SWEEP} --out {place} --record {row[0]}{load} && "
        f"leglab video {shlex.quote(str(recording_folder(facts.folder, row[0])))}{load}"
        for row in _worst_runs(facts)
    ]


def _failed(facts: _Facts) -> Table:
    found = facts.rows(
        "SELECT failure, count(*), min(run), min_by(error, run) FROM runs WHERE status = 'failed'"
        f" GROUP BY 1 ORDER BY 2 DESC LIMIT {_MOST_ROWS}"
    )
    rows = [(failure, error, str(first), f"{count:,}") for failure, count, first, error in found]
    return Table(
        caption="Runs that failed, by kind, with the error of the first of each",
        head=("kind", "error", "run", "runs"),
        rows=rows,
        words=2,
    )


def _settings(record: SweepRecord) -> Table:
    plan = record.plan
    shared = plan.get("settings", {})
    rows = [(name, _text(value)) for name, value in shared.items()]
    rows += [(f"block {i + 1}", json.dumps(block)) for i, block in enumerate(plan.get("block", []))]
    rows += [("leglab", record.version), ("digest of the code", record.code[:12])]
    return Table(
        caption="What all runs share, and the blocks", head=("setting", "value"), rows=rows, words=2
    )


def _scaled(value: float | None, factor: float = 1.0) -> str:
    return "" if value is None or not math.isfinite(value) else number(factor * value)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return number(value)
    return "none" if value is None else str(value)


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
