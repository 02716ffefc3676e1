"""Layout of a table in text: encoding, separator, decimal sign, lines before the first row.

It is detected from the last rows. DuckDB's sniffer starts at the first line instead and fails for
heads of several lines (dSPACE, LabVIEW, oscilloscopes) and for blanks as separators.
"""

import codecs
import csv
import gzip
import re
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice, zip_longest
from pathlib import Path
from typing import NamedTuple

from leglab.base.errors import FileError
from leglab.data.column_map import MapSettings
from leglab.data.time_text import TIME
from leglab.data.units_in_names import split

MISSING = ["", "-", "--", "nan", "NaN", "NAN", "null", "NULL", "Null", "None", "NA", "N/A", "n/a"]
"""Cells that stand for a missing sample; all other text is refused."""

_BLANKS = " "
_SEPARATORS = ",;\t|" + _BLANKS
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*|\s*[+-]?(?i:inf|infinity)\s*")
# Samples that are not numbers: Booleans and lists; also dates and times of day (see `TIME`).
_SAMPLE = re.compile(r"(?i:true|false|on|off|yes|no)|[\[(]\s*[-+.]?\d.*[\])]")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
_COMMENT = re.compile(r"\s*[#%;!]+\s?")
# `_HEAD`: maximum length of a head [characters]. `_ROWS`: number of rows that show the separator.
_HEAD, _ROWS = 1_000_000, 100


@dataclass(frozen=True)
class Dialect:
    """Layout of the rows of a text."""

    separator: str  #: One character; a blank stands for any number of blanks
    decimal: str  #: "." or ","
    names: tuple[str, ...]  #: Names of the columns, with units from the line below them
    body: str  #: The text from the first row on, without comments


def decoded(content: bytes, encoding: str | None) -> str:
    """Decodes a file's text: UTF-8, UTF-16 with a byte order mark, else Windows-1252."""
    if content.startswith(b"\x1f\x8b"):
        content = gzip.decompress(content)
    if encoding:
        return content.decode(encoding)
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16", "replace")
    with suppress(UnicodeDecodeError):
        return content.decode("utf-8-sig")
    return content.decode("cp1252", "replace")


def dialect(text: str, settings: MapSettings, path: Path) -> Dialect:
    """Detects separator, decimal sign, names and first row, unless the settings give them.

    Raises:
        FileError: The text is empty, the names do not fit the rows, or it is ambiguous whether
            commas are decimal signs or group thousands.
    """
    end = len(text) if len(text) <= _HEAD else max(text.rfind("\n", 0, _HEAD), 0)
    lines = [line.rstrip("\r") for line in text[:end].split("\n")[settings.skip :]]
    filled = [line for line in lines if _COMMENT.sub("", line, count=1).strip()]
    filled = [line for line in filled if not _is_comment(line)] or [
        _COMMENT.sub("", line, count=1) for line in filled[-1:]
    ]
    if not filled:
        raise FileError(f"{path}: not a CSV file: it is empty", given=path)
    rows = filled[-min(_ROWS, max(2, len(filled) // 2)) :]
    fits = [
        (*_fit(rows, separator, decimal), separator, decimal)
        for decimal in settings.decimal or ".,"
        for separator in settings.separator or _SEPARATORS
    ]
    _, width, table, separator, decimal = max(fits, key=lambda fit: fit[:2])
    if not settings.decimal:
        _check_thousands([cell for row in table for cell in row], path)
    head, first = _head(lines, separator, decimal, [row for row in table if len(row) == width])
    at, names = _names(head, width)
    if head and at is None and len(head[-1].cells) > 1 and not head[-1].numbers:
        number, cells, *_ = head[-1]
        raise FileError(
            f"{path}: rows have {width} cells, the line above them has {len(cells)}: "
            f"{lines[number][:60]!r}; a column map by --columns FILE says the separator, or "
            f"leaves the head out: skip = {settings.skip + number + 1}",
            given=path,
        )
    if at is not None:  # A data row with a broken cell does not belong to the head.
        first = next((line.number for line in head[at + 1 :] if line.numbers), first)
    return Dialect(separator, decimal, names, _body(text, settings.skip + first, separator))


class _Line(NamedTuple):
    """A line of the head."""

    number: int
    cells: list[str]
    numbers: bool  # whether one of the cells is a number
    fits: bool  # whether it can be the line of column names


def _head(
    lines: list[str], separator: str, decimal: str, rows: list[list[str]]
) -> tuple[list[_Line], int]:
    """Returns non-empty lines before the first row, including comments, and that row's number."""
    width = len(rows[0])
    samples = [[_is_sample(cell, decimal) for cell in column] for column in zip(*rows, strict=True)]
    solid = [i for i, column in enumerate(samples) if 2 * sum(column) >= len(rows)]
    # A separator at the end of each row, or of the names alone, adds an empty cell.
    ends = not any(row[-1].strip() for row in rows)
    head: list[_Line] = []
    for number, line in enumerate(lines):
        comment = _is_comment(line)
        cells = _cells(_COMMENT.sub("", line, count=1) if comment else line, separator)
        full = solid and len(cells) == width and not comment
        if full and all(_is_sample(cells[i], decimal) for i in solid):
            return head, number
        if line.strip():
            long = "".join(cells[-1:]).strip().lower() in ("", "comment")  # as LabVIEW writes
            fits = len(cells) in (width, width - ends, width + long)
            numbers = any(_is_number(cell, decimal) for cell in cells)
            head.append(_Line(number, cells, numbers, fits))
    return head, len(lines)


def _names(head: list[_Line], width: int) -> tuple[int | None, tuple[str, ...]]:
    """Returns the head's last line with names or units (None if it has neither), and full names."""
    fits = [k for k, line in enumerate(head) if line.fits]
    named = [k for k in fits if not head[k].numbers] or fits[-1:]
    if not named:
        return None, tuple(f"column{i}" for i in range(width))
    names, units = head[named[-1]].cells, [""]
    if named[-1] - 1 in named and _are_units(names):
        names, units = head[named[-1] - 1].cells, names
    found = []
    for i, name, unit in islice(zip_longest(range(width), names, units, fillvalue=""), width):
        unit = unit.strip().strip("[]()")
        bare = unit in ("", "-") or split(name.strip()).unit
        found.append((name.strip() or f"Unnamed: {i}") + ("" if bare else f" [{unit}]"))
    return named[-1], tuple(found)


def _body(text: str, first: int, separator: str) -> str:
    """Returns the text from a line on without comments, with tabs for separating blanks."""
    body = "".join(text.split("\n", first)[first:])
    if re.search(r"^\s*[#%]", body, re.MULTILINE):
        body = "\n".join(line for line in body.splitlines() if not _is_comment(line))
    if separator == _BLANKS:
        body = "\n".join("\t".join(line.split()) for line in body.splitlines())
    return body


def _fit(rows: list[str], separator: str, decimal: str) -> tuple[float, int, list[list[str]]]:
    """Returns the share of well-split rows, the usual number of cells in a row, and all cells."""
    table = [_cells(row, separator) for row in rows]
    width, count = Counter(map(len, table)).most_common(1)[0]
    cells = [cell for row in table if len(row) == width for cell in row]
    good = sum(_is_sample(cell, decimal) or cell.strip() in MISSING for cell in cells)
    return round(good / max(len(cells), 1) * count / len(rows), 3), width, table


def _check_thousands(cells: list[str], path: Path) -> None:
    commas = [cell.strip() for cell in cells if "," in cell and not cell.strip().startswith("[")]
    grouped = [cell for cell in commas if _THOUSANDS.fullmatch(cell)]
    if grouped and len(grouped) == len(commas):
        raise FileError(
            f"{path}: {grouped[0]!r} may have a decimal comma or group thousands; which says a "
            'column map by --columns FILE: decimal = "," (thousands are not read)',
            given=grouped[0],
        )


def _cells(line: str, separator: str) -> list[str]:
    if separator == _BLANKS:
        return line.split()
    with suppress(csv.Error):
        return next(csv.reader([line], delimiter=separator), [])
    return line.split(separator)


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(("#", "%"))


def _is_number(cell: str, decimal: str) -> bool:
    return bool(_NUMBER.fullmatch(cell.replace(",", ".", 1) if decimal == "," else cell))


def _is_sample(cell: str, decimal: str) -> bool:
    cell = cell.strip()
    return _is_number(cell, decimal) or bool(_SAMPLE.fullmatch(cell) or TIME.fullmatch(cell))


def _are_units(cells: list[str]) -> bool:
    """Tests whether the first cell and at least half of all cells are known units."""
    bare = [cell.strip().strip("[]()") for cell in cells]
    known = [unit in ("", "-") or bool(split(f"x [{unit}]").unit) for unit in bare]
    return known[0] and 2 * sum(known) >= len(known)
