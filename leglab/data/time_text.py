"""Dates and times of day that are written as text."""

import re

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

_PATTERN = (
    r"(?:(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})|"
    r"(?P<day>\d{1,2})\.(?P<month>\d{1,2})\.(?P<year>\d{4})|"
    r"(?P<first>\d{1,2})/(?P<second>\d{1,2})/(?P<last>\d{4}))?[T_ ]*"
    r"(?:(?P<H>\d{1,2}):(?P<M>\d{2})(?::(?P<S>\d{2})(?:[.,:](?P<f>\d{1,9})\d*)?)?)?"
    r" *(?P<half>[AaPp][Mm])? *(?P<zone>Z|UTC|[+-]\d{2}:?\d{2})?"
)
_BASIC = r"^(\d{4})(\d\d)(\d\d)T(\d\d)(\d\d)(\d\d)", r"\1-\2-\3T\4:\5:\6"
TIME = re.compile(r"(?=\s*\d+[:./-]\d+[:./-]|\s*\d+:\d)\s*" + _PATTERN + r"\s*")
"""What one cell may be."""


def times_of(column: pa.ChunkedArray) -> np.ndarray | None:
    """Reads dates and times of day, ISO 8601 and as they are written elsewhere.

    Of 03/04/2026 the part that is above 12, or that changes, is the day; where neither tells, the
    date is left away and the time of day stays.

    Args:
        column: Text of shape (n,), null where it is missing.

    Returns:
        datetime64[ns], of UTC where a zone is given, or for times of day timedelta64[ns], of which
        a smaller one after a larger one is the next day's; None where a cell is something else.
    """
    column = pc.utf8_trim_whitespace(column.cast(pa.string()))
    column = pc.replace_substring_regex(column, *_BASIC)
    known = column.drop_null()
    if not len(known) or not TIME.fullmatch(known[0].as_py()):
        return None
    parts = pc.extract_regex(column, f"^{_PATTERN}$")
    if parts.null_count > column.null_count:
        return None
    part = {name: pc.struct_field(parts, name) for name in TIME.groupindex}
    one, two = part["first"], part["second"]
    if not _is_day(one):
        one, two = two, one
    no_order = not _is_day(one) and part["last"].unique().to_pylist() != [""]
    date = [
        _first((part["y"], part["year"], part["last"]), "1970"),
        _first((part["m"], part["month"], two), "01"),
        _first((part["d"], part["day"], one), "01"),
    ]
    if no_order:
        date = [pa.scalar(text) for text in ("1970", "01", "01")]
    hour = pc.cast(_first((part["H"],), "0"), pa.int64())
    late = pc.starts_with(pc.utf8_lower(part["half"]), "p")
    noon = pc.and_(pc.not_equal(part["half"], ""), pc.equal(hour, 12))
    hour = pc.if_else(noon, 0, hour)
    hour = pc.cast(pc.if_else(late, pc.add(hour, 12), hour), pa.string())
    clock = [hour, _first((part["M"],), "00"), _first((part["S"],), "00")]
    text = pc.binary_join_element_wise(
        pc.binary_join_element_wise(*(pc.utf8_lpad(p, 2, "0") for p in date), "-"),
        " ",
        pc.binary_join_element_wise(*(pc.utf8_lpad(p, 2, "0") for p in clock), ":"),
        ".",
        pc.utf8_rpad(part["f"], 9, "0"),
        pc.replace_substring(part["zone"], "UTC", "Z"),
        "",
    )
    zones = set(part["zone"].unique().to_pylist()) - {None}
    try:
        found = text.cast(pa.timestamp("ns", None if zones == {""} else "UTC")).to_numpy()
    except pa.ArrowException:  # such as the 31st of a short month, or a zone in some cells alone
        return None
    days = set(pc.binary_join_element_wise(part["y"], part["year"], part["last"], "").to_pylist())
    return (
        past_midnight(found - np.datetime64(0, "ns")) if no_order or days <= {"", None} else found
    )


def past_midnight(times: np.ndarray) -> np.ndarray:
    """Adds a day wherever a clock, timedelta64 of shape (n,), begins anew."""
    day, half = np.timedelta64(24, "h"), np.timedelta64(12, "h")
    begins = np.concatenate([[False], np.diff(times) < -half])[: times.size]
    return times + np.cumsum(begins) * day.astype(times.dtype)


def _first(parts: tuple, otherwise: str) -> pa.ChunkedArray:
    """Per row, the first part that is not empty."""
    found = pa.scalar(otherwise)
    for part in reversed(parts):
        found = pc.if_else(pc.equal(part, ""), found, part)
    return found


def _is_day(part: pa.ChunkedArray) -> bool:
    values = set(part.unique().to_pylist()) - {None, ""}
    return len(values) > 1 or any(int(value) > 12 for value in values)
