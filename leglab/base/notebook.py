"""Display of results in a notebook: tables in HTML, plots, data frames."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from leglab.base.errors import LeglabError


def html_table(caption: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Returns a table as HTML with all text escaped."""
    names = "".join(f"<th>{escape(name)}</th>" for name in head)
    lines = "".join(
        f"<tr>{''.join(f'<td>{escape(str(cell))}</td>' for cell in row)}</tr>" for row in rows
    )
    return (
        f"<table><caption>{escape(caption)}</caption>"
        f"<thead><tr>{names}</tr></thead><tbody>{lines}</tbody></table>"
    )


def panels(count: int, *, height: float = 2.0, share: bool = True) -> list[Any]:
    """Returns vertically stacked matplotlib axes in a new pyplot figure.

    Args:
        count: Number of axes.
        height: Height of each axes [inch].
        share: Whether the axes share the horizontal axis.
    """
    import matplotlib.pyplot as plt

    size = (8.0, 0.6 + height * count)
    figure = plt.figure(figsize=size, layout="constrained")
    return list(figure.subplots(count, 1, sharex=share, squeeze=False)[:, 0])


def data_frame(content: Any, **options: Any) -> Any:
    """Returns a `pandas.DataFrame`.

    Raises:
        LeglabError: pandas is missing.
    """
    return _pandas().DataFrame(content, **options)


def data_index(keys: Iterable[tuple[str, ...]], names: Sequence[str]) -> Any:
    """Returns a `pandas.MultiIndex` of tuples.

    Raises:
        LeglabError: pandas is missing.
    """
    return _pandas().MultiIndex.from_tuples(list(keys), names=names)


def _pandas() -> Any:
    try:
        import pandas as pd
    except ImportError as error:
        raise LeglabError("to_pandas needs pandas: pip install pandas") from error
    return pd
