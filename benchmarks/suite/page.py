"""The page of the benchmark: ratios beside what is asked, tables of the parts, the history."""

from collections.abc import Collection, Sequence
from typing import Any

from benchmarks.suite.history import Entry, change, kept_value
from benchmarks.suite.sections import Group, tables_page
from benchmarks.suite.suite import (
    RATIOS,
    ROOT,
    Measured,
    Ratio,
    Value,
    kept_tables,
    machine,
)
from leglab.base.errors import LeglabError
from leglab.base.input import read_json
from leglab.report.page.shell import Table
from leglab.report.page.wording import number

_ENTRIES = 10  # of the history that are shown
HEAD = ("ratio", "median", "range", "asked", "", "kept before", "better by")


def page(
    measured: Sequence[Measured], found: Sequence[Value], entries: Sequence[Entry], here: str
) -> str:
    """The page as one file that needs no other and runs no script.

    Args:
        measured: What the parts gave.
        found: Their ratios.
        entries: The history, without what is shown.
        here: This machine, as the history names it.
    """
    wanted = {r.name for r in RATIOS if r.part in {m.part for m in measured} and r.asked}
    asked = [v for v in found if v.ratio.name in wanted]
    met = sum(bool(v.ratio.met(v.median)) for v in asked)
    failed = [m for m in measured if m.problem]
    headline = f"{met} of {len(wanted)} ratios reach what is asked"
    if len(asked) < len(wanted):
        headline += f"; {len(wanted) - len(asked)} of them not measured"
    parts = {one.part: (one, markdown_tables(one.tables)) for one in measured if one.record}
    failures = Table(
        caption="Not measured",
        head=("part", "why"),
        rows=sorted({(m.part, m.problem) for m in failed}),
        words=2,
    )
    sections = (
        Group(
            name="ratios",
            title="Ratios",
            text="Each ratio is of figures that one process measured in turns. The last columns "
            "compare with the median of the last five that were kept.",
            tables=(_ratios(found, entries, here, {m.part for m in measured}), failures),
        ),
        Group(
            name="measured",
            title="Measured",
            folds=[(n, _origin(one.record), tables) for n, (one, tables) in parts.items()],
        ),
        Group(
            name="kept",
            title="Kept results",
            text="What takes hours or other people's data is measured by make results and kept; "
            "these are the tables that say what is asked.",
            folds=_kept({m.part for m in measured}),
        ),
        Group(name="history", title="History", tables=(_history(found, entries),)),
        Group(name="machine", title="Machine", tables=(_machine(),)),
    )
    return tables_page("bench", "python -m benchmarks bench", headline, sections)


def _machine() -> Table:
    found = machine()
    rows = [(name, str(found[name])) for name in ("processor", "cores", "system", "python")]
    rows += list(found["versions"].items())
    return Table(caption="Machine and versions", head=("", "value"), rows=rows, words=2)


def _ratios(
    found: Sequence[Value], entries: Sequence[Entry], here: str, parts: Collection[str] = ()
) -> Table:
    rows = []
    for value in found:
        ratio, before = value.ratio, kept_value(value.ratio, entries, here)
        changed = change(value, before)
        reached = ratio.met(value.median)
        rows.append(
            (
                ratio.title,
                number(value.median),
                f"{number(min(value.values))} to {number(max(value.values))}"
                if len(value.values) > 1
                else "",
                _asked(ratio),
                "" if reached is None else "reached" if reached else "missed",
                "" if before is None else number(before),
                ""
                if changed is None
                else f"{100 * changed:+.0f} %".replace("-0 %", "0 %").replace("+0 %", "0 %"),
            )
        )
    known = {value.ratio.name for value in found}
    for ratio in RATIOS:
        if ratio.part in parts and ratio.name not in known:
            rows.append((ratio.title, "", "", _asked(ratio), "not measured", "", ""))
    return Table(caption="Ratios, each measured side by side in one process", head=HEAD, rows=rows)


def _asked(ratio: Ratio) -> str:
    if ratio.asked is None:
        return ""
    return f"{'at most' if ratio.better == 'low' else 'at least'} {ratio.asked:g}"


def _history(found: Sequence[Value], entries: Sequence[Entry]) -> Table:
    shown = list(entries)[-_ENTRIES:]
    rows = [
        (v.ratio.name, *(_number(e.ratios.get(v.ratio.name)) for e in shown), number(v.median))
        for v in found
    ]
    head = ("ratio", *(f"{e.commit} {e.date}" for e in shown), "now")
    return Table(caption="Kept ratios by commit, the newest last", head=head, rows=rows)


def _origin(record: dict[str, Any]) -> str:
    return f"{record['command']}, {record['date']}, commit {record['commit']}; {record['machine']}"


def _kept(left_out: set[str]) -> list[tuple[str, str, list[Table]]]:
    """Tables of docs/data that say what is asked: what takes hours is not measured here."""
    shown, found = kept_tables(), []
    for file in sorted((ROOT / "docs" / "data").glob("*.json")):
        if file.stem in left_out or file.stem not in shown:
            continue
        try:
            record = read_json(file)
        except LeglabError:
            continue
        if not isinstance(record, dict) or "command" not in record:
            continue
        tables = [
            table
            for table in markdown_tables(shown[file.stem])
            if "asked" in " ".join((*table.head, *(row[0] for row in table.rows))).lower()
        ]
        if tables:
            found.append((file.stem, _origin({"commit": "", "machine": "", **record}), tables))
    return found


def markdown_tables(text: str) -> list[Table]:
    """The tables of a Markdown text, without marks of code."""
    found: list[list[list[str]]] = []
    inside = False
    for line in text.splitlines():
        if not line.startswith("|"):
            inside = False
            continue
        cells = [cell.strip().replace("`", "") for cell in line.strip().strip("|").split("|")]
        if not inside:
            found.append([])
        elif set("".join(cells)) <= set("-: "):
            continue
        inside = True
        found[-1].append(cells)
    return [
        Table(
            caption=rows[0][0], head=rows[0], rows=[r for r in rows[1:] if len(r) == len(rows[0])]
        )
        for rows in found
        if len(rows) > 1
    ]


def summary(found: Sequence[Value], entries: Sequence[Entry], here: str) -> list[list[str]]:
    """Rows of the ratios for the terminal."""
    return [list(row) for row in _ratios(found, entries, here).rows]


def _number(value: float | None) -> str:
    return "" if value is None else number(value)
