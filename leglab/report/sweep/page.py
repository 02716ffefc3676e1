"""The page of a sweep: tables, heat maps, distributions, and the worst runs."""

import json
import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from leglab.report.film.encoder import film_bytes, still_bytes
from leglab.report.page.shell import Section, Table, inlined, render, write_page
from leglab.report.page.wording import figure, listed, number
from leglab.report.run.page import PAGE
from leglab.report.sweep.charts import LISTED, NONE, distributions, effects, heat_maps
from leglab.report.sweep.facts import NEVER, T90, Facts, axis_words, value_words
from leglab.runs.sweeps.outcome import recording_folder
from leglab.runs.sweeps.plan import SweepPlan
from leglab.runs.sweeps.query import questions
from leglab.runs.sweeps.rows import column
from leglab.runs.sweeps.store import SWEEP, SweepRecord, read_record
from leglab.runs.sweeps.tuning import tuned

# Maximum number of rows of a table.
_MOST_ROWS = 120
# Maximum size of a film in the page [bytes].
_FILM = 3_000_000
# Maximum number of controllers in the headline.
_TOLD = 4
# Columns of the table of medians: heading, SQL expression, factor to the shown unit (0: a count).
_COLUMNS = (
    ("runs", "count(*)", 0),
    ("failed", "count(*) FILTER (status = 'failed')", 0),
    ("before, mrad", "median(before_rad)", 1e3),
    ("whole run", "median(rms_rad)", 1e3),
    ("end", "median(end_rad)", 1e3),
    ("damage", "median(damage_rad)", 1e3),
    ("undone, %", "median(recovered)", 100.0),
    ("least", "min(recovered)", 100.0),
    ("90 % after, s", T90.median, 1.0),
    ("last", "max(t90_s)", 1.0),
    ("never", "count(*) FILTER (t90_s IS NULL AND recovered IS NOT NULL)", 0),
    ("worst 2 s, mrad", "max(worst_2s_rad)", 1e3),
    ("valve travel, 1/s", "median(valve_travel / came_to_s)", 1.0),
    ("power, W", "median(energy_j / came_to_s)", 1.0),
)


def write_sweep_page(
    folder: Path, path: Path | None = None, *, films: Mapping[int, Path] | None = None
) -> Path:
    """Writes the page of a sweep, which may be unfinished.

    Args:
        folder: Folder of the sweep.
        path: Path of the page; None for report.html in the folder. An earlier page is replaced.
        films: Films by the numbers of the runs.

    Raises:
        LeglabError: The folder holds no sweep, one of its files is damaged, or the page cannot be
            written.
    """
    return write_page(page(folder, films), path or folder / PAGE)


def worst_runs(folder: Path, most: int) -> tuple[int, ...]:
    """Returns the numbers of the worst runs, in the order of the page.

    Args:
        folder: Folder of the sweep.
        most: Maximum number of runs; never more than `MOST_FILMS`.

    Raises:
        LeglabError: The folder holds no sweep, or one of its files is damaged.
    """
    with _facts(folder) as facts:
        return tuple(row[0] for row in facts.worst_runs[:most])


def page(folder: Path, films: Mapping[int, Path] | None = None) -> str:
    """Returns the page as one file that loads no other and runs no script."""
    with _facts(folder) as facts:
        varied = effects(facts)
        links = [
            ("summary", "Summary"),
            ("numbers", "Numbers"),
            ("maps", "Heat maps"),
            *[("varied", "Settings that were varied")] * bool(varied),
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
            maps=heat_maps(facts),
            effects=varied,
            links=links,
            distributions=distributions(facts),
            worst=_worst(facts),
            films=_films(facts, films or {}),
            commands=_commands(facts),
            failed=_failed(facts),
            settings=_settings(facts.record),
        )


@contextmanager
def _facts(folder: Path) -> Iterator[Facts]:
    record = read_record(folder)
    with questions(folder) as answered:
        yield Facts(folder, record, answered)


def _headline(facts: Facts) -> str:
    total = facts.record.runs
    parts = [
        f"{facts.done:,} of {total:,} runs are made" if facts.done < total else f"{total:,} runs"
    ]
    if facts.failed:
        parts.append(f"{facts.failed:,} of them failed")
    if facts.judged:
        found = facts.rows(
            f"SELECT controller, {T90.median} AS t90,"
            " count(*) FILTER (t90_s IS NULL), count(*), median(recovered) FROM runs"
            " WHERE recovered IS NOT NULL GROUP BY 1 ORDER BY t90, 5 DESC, 1"
        )
        # Medians are by controller: a median over different controllers would mean nothing.
        told = []
        for controller, t90, never, count, recovered in found[:_TOLD]:
            when = "never" if t90 >= NEVER else f"after {number(t90)} s"
            line = (
                f"{controller} undoes {number(100 * recovered)} % of the damage, nine tenths {when}"
            )
            told.append(line + (f" ({never:,} of {count:,} never)" if never else ""))
        of = f" of the {facts.judged:,} with damage" if facts.judged < facts.done else ""
        parts.append(f"in the median{of} " + ", ".join(told))
        if len(found) > _TOLD:
            parts.append(f"{len(found) - _TOLD} controllers more stand in the table")
    return "; ".join(parts)


def _sections(facts: Facts) -> list[Section]:
    axes, names = [], []
    for axis in facts.record.axes:
        name = column(axis)
        if name in facts.columns:
            found = facts.rows(
                f'SELECT DISTINCT "{name}" FROM runs WHERE "{name}" IS NOT NULL ORDER BY 1'
            )
            told = tuple(value_words(value) for (value,) in found)
            many = len(told) > LISTED
            axes.append(f"{len(told):,} values, {told[0]} to {told[-1]}" if many else listed(told))
            names.append(axis_words(axis))
    lines = tuple(axes) or ("Nothing: it is one run.",)
    sections = [Section(title="What was varied?", lines=lines, names=tuple(names))]
    error = facts.error
    best = facts.rows(
        f"SELECT controller, median({error.name}) AS e, count(*) FROM runs"
        f" WHERE status = 'ok' AND {error.name} IS NOT NULL GROUP BY 1 ORDER BY e"
    )
    if len(best) > 1:
        sections.append(
            Section(
                title=f"Who follows most closely ({error.title.partition(',')[0]})?",
                lines=tuple(
                    f"{number(1e3 * middle)} mrad in the median of {count:,} runs"
                    for _, middle, count in best
                ),
                names=tuple(name for name, _, _ in best),
            )
        )
    sections.append(_untold(facts))
    if any("tune" in block for block in facts.record.plan.get("block", ())):
        sections.append(_tuned(facts))
    return sections


def _untold(facts: Facts) -> Section:
    """Returns the reasons, one per line, why runs have no values of damage and recovery."""
    found: tuple[tuple[Any, ...], ...] = ()
    if "not_told" in facts.columns:
        found = facts.rows(
            "SELECT coalesce(not_told, 'it failed'), count(*),"
            " string_agg(DISTINCT scenario || ', ' || controller, '; ' ORDER BY"
            " scenario || ', ' || controller) FROM runs WHERE recovered IS NULL"
            f" GROUP BY 1 ORDER BY 2 DESC LIMIT {_MOST_ROWS}"
        )
    lines = tuple(f"{count:,} runs ({who}): {reason}." for reason, count, who in found)
    return Section(title="Why do runs have no damage and nothing undone?", lines=lines)


def _tuned(facts: Facts) -> Section:
    """Returns the results of the plan's blocks that tune settings, from columns of the dataset."""
    plan = SweepPlan(facts.record.plan, SWEEP)
    names = ["run", "status", *dict.fromkeys(points.tune.metric for points in plan.tuned)]
    names += dict.fromkeys(column(name) for points in plan.tuned for name in points.ranges)
    columns = ", ".join(f'"{name}"' for name in names)
    rows = [dict(zip(names, row, strict=True)) for row in facts.rows(f"SELECT {columns} FROM runs")]
    lines = tuple(str(found) for found in tuned(plan, rows))
    return Section(title="What did tuning find?", lines=lines)


def _groups(facts: Facts) -> Table:
    """Returns the table of medians, one row per scenario and controller."""
    columns = ", ".join(sql for _, sql, _ in _COLUMNS)
    found = facts.rows(
        f"SELECT scenario, controller, {columns}"
        f" FROM runs GROUP BY ALL ORDER BY 1, 2 LIMIT {_MOST_ROWS}"
    )

    def cell(value: float | None, factor: float) -> str:
        if not factor:
            return f"{value:,}" if value else ""
        return "never" if value == NEVER else figure(value, factor)

    factors = [factor for *_, factor in _COLUMNS]
    return _filled(
        Table(
            caption="Medians over runs; errors are RMS over joints and time, of slides in mm. "
            "least, last and worst are of single runs; never: runs that did not undo nine tenths",
            head=["scenario", "controller", *(head for head, *_ in _COLUMNS)],
            rows=[[*row[:2], *map(cell, row[2:], factors)] for row in found],
            words=2,
        )
    )


def _filled(table: Table) -> Table:
    """Removes columns without any number from a table, and names these columns in its caption."""
    places = range(len(table.head))
    kept = [i for i in places if i < table.words or any(row[i] for row in table.rows)]
    names = [table.head[i].partition(",")[0] for i in places if i not in kept]
    empty = tuple(name for name in names if name != "failed")
    text = f". No run has a value of {listed(empty, 'or')}: the summary says why" if empty else ""
    return replace(
        table,
        caption=f"{table.caption}{text}",
        head=[table.head[i] for i in kept],
        rows=[[row[i] or NONE for i in kept] for row in table.rows],
    )


def _worst(facts: Facts) -> Table:
    title = facts.error.title
    rows = [
        (
            *(str(run), scenario, controller, element or "", figure(severity), str(seed)),
            figure(error, 1e3),
            "" if recovered is None else figure(t90, missing="never"),
            figure(recovered, 100.0),
        )
        for run, scenario, controller, element, severity, seed, error, t90, recovered in (
            facts.worst_runs
        )
    ]
    by = "by the share of the damage that is undone" if facts.judged else f"by {title}"
    head = ("run", "scenario", "controller", "element", "size", "seed", title, T90.title)
    caption = f"The worst runs, {by}"
    return _filled(Table(caption=caption, head=(*head, "undone, %"), rows=rows, words=4))


def _films(facts: Facts, films: Mapping[int, Path]) -> list[dict[str, str]]:
    """Returns data, still, file name and text of each film, in the order of the worst runs."""
    return [
        {
            "data": inlined(film_bytes(films[run], _FILM)),
            "still": inlined(still_bytes(films[run])),
            "file": films[run].name,
            "text": f"Run {run}: {scenario} {figure(severity)}, {controller}, seed {seed}"
            + (f", of the {element} alone" if element else ""),
        }
        for run, scenario, controller, element, severity, seed, *_ in facts.worst_runs
        if run in films
    ]


def _commands(facts: Facts) -> list[str]:
    """Returns commands that film the worst runs."""
    place = shlex.quote(str(facts.folder))
    load = "".join(f" --load {shlex.quote(source)}" for source in facts.record.load)
    return [
        f"leglab sweep {place}/{SWEEP} --out {place} --record {run}{load} && "
        f"leglab video {shlex.quote(str(recording_folder(facts.folder, run)))}{load}"
        for run, *_ in facts.worst_runs
    ]


def _failed(facts: Facts) -> Table:
    found = facts.rows(
        "SELECT failure, min_by(error, run), min(run), count(*) FROM runs WHERE status = 'failed'"
        f" GROUP BY 1 ORDER BY 4 DESC LIMIT {_MOST_ROWS}"
    )
    return Table(
        caption="Runs that failed, by kind, with the error of the first of each",
        head=("kind", "error", "run", "runs"),
        rows=[(kind, error, str(run), f"{count:,}") for kind, error, run, count in found],
        words=2,
    )


def _settings(record: SweepRecord) -> Table:
    plan = record.plan
    rows = [(name, value_words(value)) for name, value in plan.get("settings", {}).items()]
    rows += [(f"block {i + 1}", json.dumps(block)) for i, block in enumerate(plan.get("block", []))]
    rows += [("leglab", record.version), ("digest of the code", record.code[:12])]
    caption = "What all runs share, and the blocks"
    return Table(caption=caption, head=("setting", "value"), rows=rows, words=2)
