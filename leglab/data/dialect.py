"""How a text holds its table: encoding, separator, decimal sign, the lines before the first row.

DuckDB's sniffer takes the longest uniform run from the first line on, which a head of several lines
(dSPACE, LabVIEW, oscilloscopes) or blanks as separators defeat; here the rows tell, from their end.
"""

import codecs
import csv
import gzip
import re
import zlib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from leglab.base.errors import FileError
from leglab.data.column_map import TextSettings
from leglab.data.time_text import TIME
from leglab.data.units_in_names import split

MISSING = ["", "-", "--", "nan", "NaN", "NAN", "null", "NULL", "Null", "None", "NA", "N/A", "n/a"]
"""Cells that stand for a missing sample; all other text is refused."""

_BLANKS = " "
_SEPARATORS = (",", ";", "\t", "|", _BLANKS)
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*|\s*[+-]?(?i:inf|infinity)\s*")
# Booleans and lists are samples, too, as are dates and times of day.
_SAMPLE = re.compile(r"(?i:true|false)|\[\s*[-+.]?\d.*\]")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
_COMMENT = re.compile(r"\s*[#%;!]+\s?")
# A head is no longer, and the rows that tell the separator are no more.
_HEAD, _ROWS = 1_000_000, 100


@dataclass(frozen=True)
class Dialect:
    """How to read the rows of a text."""

    separator: str  #: One letter; a blank for any number of blanks
    decimal: str  #: "." or ","
    names: tuple[str, ...]  #: Of the columns, with units that stand below them
    body: str  #: The text from the first row on, without comments


def decoded(content: bytes, path: Path, encoding: str | None) -> str:
    """Returns a file's text: UTF-8, UTF-16 with its mark, else Windows' Latin letters.

    Raises:
        FileError: It is packed and damaged, or of another encoding than the one given.
    """
    try:
        if content.startswith(b"\x1f\x8b"):
            content = gzip.decompress(content)
        if encoding is None:
            wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
            encoding = "utf-16" if wide else "utf-8-sig"
            try:
                return content.decode(encoding)
            except UnicodeDecodeError:
                return content.decode("utf-16" if wide else "cp1252", "replace")
        return content.decode(encoding)
    except (OSError, EOFError, zlib.error, LookupError, UnicodeDecodeError) as error:
        raise FileError(f"{path}: not a CSV file: {error}", given=path) from error


def dialect(text: str, settings: TextSettings, path: Path) -> Dialect:
    """Finds how a text holds its table.

    Args:
        text: The file's.
        settings: What a column map says of it goes first.
        path: The file, for messages.

    Raises:
        FileError: Nothing is there, or commas may be decimal signs or group thousands.
    """
    lines = [line.rstrip("\r") for line in text[:_HEAD].split("\n")]
    if len(text) > _HEAD:
        del lines[-1]  # Cut.
    lines = lines[settings.skip :]
    filled = [line for line in lines if line.strip() and not _is_comment(line)]
    if not filled:
        filled = [_COMMENT.sub("", line, count=1) for line in lines if line.strip()][-1:]
    if not filled:
        raise FileError(f"{path}: not a CSV file: it is empty", given=path)
    rows = filled[-min(_ROWS, max(2, len(filled) // 2)) :]
    if settings.separator:
        separators: tuple[str, ...] = (settings.separator,)
    else:
        separators = _SEPARATORS
    decimals = (settings.decimal,) if settings.decimal else (".", ",")
    fits = [(*_fit(rows, s, d), s, d) for d in decimals for s in separators]
    _, width, separator, decimal = max(fits, key=lambda fit: fit[:2])
    table = [_cells(line, separator) for line in rows]
    if not settings.decimal:
        _check_thousands([cell for row in table for cell in row], separator, path)
    sampled = [row for row in table if len(row) == width]
    solid = [
        i
        for i in range(width)
        if 2 * sum(_is_sample(row[i], decimal) for row in sampled) >= len(sampled)
    ]
    return _cut(text, settings.skip, lines, (separator, decimal, width), solid)


def _cut(
    text: str, skip: int, lines: list[str], form: tuple[str, str, int], solid: list[int]
) -> Dialect:
    """Cuts names and units off; `solid` are the columns that hold samples in most rows."""
    separator, decimal, width = form
    head: list[tuple[int, list[str]]] = []
    first = len(lines)
    for number, line in enumerate(lines):
        comment = _is_comment(line)
        cells = _cells(_COMMENT.sub("", line, count=1) if comment else line, separator)
        full = solid and len(cells) == width and not comment
        if full and all(_is_sample(cells[i], decimal) for i in solid):
            first = number
            break
        if line.strip():
            head.append((number, cells))
    # Names may lack the cell that a separator at the rows' end opens, or have one for no cell.
    wide = [k for k, (_, cells) in enumerate(head) if abs(len(cells) - width) <= 1]
    named = [k for k in wide if not any(map(_is_plain, head[k][1]))] or wide[-1:]
    names, units = [f"column{i}" for i in range(width)], [""] * width
    if named:
        at = named[-1]
        # A row with a broken cell is no head.
        later = (number for number, cells in head[at + 1 :] if any(map(_is_plain, cells)))
        first = next(later, first)
        names = head[at][1]
        if at > 0 and at - 1 in named and all(map(_is_unit, names)):
            names, units = head[at - 1][1], names
    names = [name.strip() or f"Unnamed: {i}" for i, name in enumerate(names)][:width]
    names += [f"Unnamed: {i}" for i in range(len(names), width)]
    bare = [unit.strip().strip("[]()") for unit in (*units, *[""] * width)]
    full_names = [
        f"{name} [{unit}]" if unit not in ("", "-") and not split(name).unit else name
        for name, unit in zip(names, bare, strict=False)
    ]
    place = 0
    for _ in range(skip + first):
        place = text.find("\n", place) + 1 or len(text)
    body = text[place:]
    if re.search(r"^\s*[#%]", body, re.MULTILINE):
        body = "\n".join(line for line in body.splitlines() if not _is_comment(line))
    if separator == _BLANKS:
        body = "\n".join("\t".join(line.split()) for line in body.splitlines())
    return Dialect(separator, decimal, tuple(full_names), body)


def _fit(rows: list[str], separator: str, decimal: str) -> tuple[float, int]:
    """How well rows fall into samples, and the usual number of cells."""
    table = [_cells(row, separator) for row in rows]
    width, count = Counter(map(len, table)).most_common(1)[0]
    cells = [cell for row in table if len(row) == width for cell in row]
    good = sum(_is_sample(cell, decimal) or cell.strip() in MISSING for cell in cells)
    return round(good / max(len(cells), 1) * count / len(rows), 3), width


def _check_thousands(cells: list[str], separator: str, path: Path) -> None:
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
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return line.split(separator)


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(("#", "%"))


def _is_number(cell: str, decimal: str) -> bool:
    return bool(_NUMBER.fullmatch(cell.replace(",", ".", 1) if decimal == "," else cell))


def _is_plain(cell: str) -> bool:
    return bool(_NUMBER.fullmatch(cell))


def _is_sample(cell: str, decimal: str) -> bool:
    cell = cell.strip()
    return _is_number(cell, decimal) or bool(_SAMPLE.fullmatch(cell) or TIME.fullmatch(cell))


def _is_unit(cell: str) -> bool:
    bare = cell.strip().strip("[]()")
    return bare in ("", "-") or bool(split(f"x [{bare}]").unit)
