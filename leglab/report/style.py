"""One look for all figures: few inks, safe for colour-blind readers, no decoration."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl

from leglab.report.palette import (
    BLACK,
    BLUE,
    DARK_GREY,
    LIGHT_GREY,
    ORANGE,
    SERIES,
    VERMILION,
)

__all__ = [
    "BLACK",
    "BLUE",
    "DARK_GREY",
    "LIGHT_GREY",
    "ORANGE",
    "SERIES",
    "VERMILION",
    "style",
]

_STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.labelcolor": DARK_GREY,
    "axes.edgecolor": DARK_GREY,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.axisbelow": True,
    "axes.xmargin": 0.0,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.6,
    "xtick.color": DARK_GREY,
    "ytick.color": DARK_GREY,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "lines.linewidth": 1.0,
    "figure.dpi": 100.0,
    "savefig.dpi": 160.0,
    "savefig.facecolor": "white",
}


@contextmanager
def style() -> Iterator[None]:
    """Applies the look to figures made inside, and leaves other figures alone."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield
