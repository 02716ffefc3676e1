"""Parsing of dates and times of day in text, with DuckDB."""

import re

import numpy as np
import pyarrow as pa

TIME = re.compile(
    r"\s*([\d./-]*[T ]\s*)?\d{1,2}:\d\d(:\d\d([.,]\d+)?)? *(?i:[AP]M)? *(Z|UTC|[+-][\d:]+)?\s*"
    r"|\s*\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}\s*|\d{8}T\d{6}\S*"
)
"""Pattern of a cell with a date or a time of day."""

_CLOCKS = ("%H:%M:%S.%n", "%H:%M:%S", "%H:%M", "%I:%M:%S.%n %p", "%I:%M:%S %p")
_BASIC = ("%Y%m%dT%H%M%S.%n", "%Y%m%dT%H%M%S", "%Y%m%dT%H%M%S.%nZ", "%Y%m%dT%H%M%SZ")
# DuckDB's TIMESTAMP_NS ignores time zones; a time of day becomes a time on 1900-01-01.
_READ = r"""
with texts as (select replace(trim(c), ',', '.') as c from given),
iso as (select c, epoch_ns(try_cast(c as timestamp_ns)) - if(
    regexp_matches(c, ':\d\d(\.\d+)? ?(Z|UTC|[+-]\d\d(:?\d\d)?)$'),
    1000 * (epoch_us(try_cast(c as timestamp)) - epoch_us(try_cast(c as timestamptz))), 0) as t
    from texts)
select coalesce(t, epoch_ns(try_strptime(c, $month))) as month,
    coalesce(t, epoch_ns(try_strptime(c, $day))) as day from iso
"""
_FIRST_DAY = np.datetime64("1900-01-01", "ns")


def times_of(column: pa.ChunkedArray) -> np.ndarray | None:
    """Parses dates and times of day in ISO 8601 and other common formats.

    Dates such as 03/04/2026 are ambiguous (day or month first); only their times of day are used.

    Args:
        column: Text of shape (n,), null where it is missing.

    Returns:
        datetime64[ns], in UTC if a time zone is given; for times of day timedelta64[ns], where a
        jump back by more than half a day starts the next day; None if a cell is something else.
    """
    known = column.drop_null()
    if not len(known) or not TIME.fullmatch(known[0].as_py()):
        return None
    import duckdb

    forms = {}
    for order, days in {"month": "%m/%d/%Y", "day": "%d/%m/%Y"}.items():
        dates = ("", "%d.%m.%Y ", f"{days} ")
        forms[order] = [f"{date}{clock}".strip() for date in dates for clock in ("", *_CLOCKS)][1:]
        forms[order] += _BASIC
    try:
        with duckdb.connect() as connection:
            connection.register("given", pa.table({"c": column}))
            found = connection.sql(_READ, params=forms).to_arrow_table()
    except duckdb.Error:  # for instance because of an infinite date
        return None
    whole = [c for c in found.columns if c.null_count == column.null_count]
    if not whole:
        return None
    stamps = whole[0].cast(pa.timestamp("ns")).to_numpy()
    dated = stamps[~np.isnat(stamps)].max() >= _FIRST_DAY + np.timedelta64(1, "D")
    if dated and (len(whole) == 1 or whole[0].equals(whole[1])):
        return stamps
    return past_midnight((stamps - _FIRST_DAY) % np.timedelta64(86_400 * 10**9, "ns"))


def past_midnight(times: np.ndarray) -> np.ndarray:
    """Adds a day at each midnight of a clock, timedelta64 (n,): a step back by over 12 h."""
    day, half = np.timedelta64(24, "h"), np.timedelta64(12, "h")
    begins = np.concatenate([[False], np.diff(times) < -half])[: times.size]
    return times + np.cumsum(begins) * day.astype(times.dtype)
