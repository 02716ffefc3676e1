"""Common plain style of all figures and films: few colours, safe for colour-blind readers."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# Okabe and Ito 2008, Color Universal Design: distinct with all common kinds of colour blindness.
BLUE = "#0072B2"
ORANGE = "#E69F00"
VERMILION = "#D55E00"
BLACK = "#000000"
LIGHT_GREY = "#B8B8B8"
DARK_GREY = "#4D4D4D"
GRID = "#E6E6E6"
# Colours of the runs or controllers in a figure, in this order; vermilion marks changes.
SERIES = (BLACK, BLUE, ORANGE, "#009E73", "#CC79A7", "#56B4E9")

_STYLE: dict[Any, Any] = {
    **dict.fromkeys(("font.size", "axes.labelsize", "legend.fontsize"), 9.0),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize"), 8.0),
    **dict.fromkeys(("axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), DARK_GREY),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right", "legend.frameon"), False),
    **dict.fromkeys(("axes.linewidth", "grid.linewidth"), 0.6),
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.axisbelow": True,
    "axes.xmargin": 0.0,
    "grid.color": GRID,
    "lines.linewidth": 1.0,
    "figure.dpi": 100.0,
    "savefig.dpi": 160.0,
    # Number of vertices drawn at a time: without this limit dense lines took 70 MB per picture.
    "agg.path.chunksize": 1000,
    "savefig.facecolor": "white",
    # Names are drawn as they are: a "$" in them starts no formula.
    "text.parse_math": False,
}


# Matplotlib's settings are global to the process: one thread at a time may change them.
_SETTINGS = threading.RLock()


@contextmanager
def style() -> Iterator[None]:
    """Applies the style to figures made inside the context, then restores the caller's settings.

    Other threads wait until the context ends.
    """
    import matplotlib as mpl  # slow; films need only the colours above

    with _SETTINGS, mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield
