"""Layout, colours and fonts of a frame, and the colour scale of pressures."""

import functools
import importlib.util
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from leglab.report.style import BLUE, SERIES, VERMILION

SIZE = (1280, 720)  # width and height of a frame; all lengths in px
HEAD = 52  # height of the title above the panels
HEADING = 36  # height of the heading of a panel, above its picture
TRACES = 232  # height of the traces below the panels
GAP = 4  # distance between panels
GAUGES = 132  # width of the gauges at the left of a panel
PRESSURES = 168  # width of the pressures at the right of a wide panel
MAX_RUNS = 4


@dataclass(frozen=True)
class Rect:
    """A rectangle of the picture [px]; the edges right and bottom are not included."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.right - self.left, self.bottom - self.top

    @property
    def width(self) -> int:
        """Width [px]."""
        return self.size[0]

    @property
    def height(self) -> int:
        """Height [px]."""
        return self.size[1]


def panels(count: int) -> list[Rect]:
    """Returns the panels of the machines, side by side and of equal size."""
    width = (SIZE[0] - GAP * (count - 1)) // count
    bottom = SIZE[1] - TRACES
    lefts = [round(i * (SIZE[0] - width) / max(count - 1, 1)) for i in range(count)]
    return [Rect(left, HEAD + HEADING, left + width, bottom) for left in lefts]


def has_pressures(panel: Rect) -> bool:
    """Tests whether a panel has room for the pressures of every cylinder on its right."""
    return panel.width >= 600


def leg_region(panel: Rect) -> tuple[float, float, float, float]:
    """Returns left, right, bottom, top of a panel's region for the leg, from -1 to 1.

    Changes and gauges are left of the region, pressures right of it.
    """
    left = 2.0 * (GAUGES + 16) / panel.width - 1.0
    right = 1.0 - 2.0 * (PRESSURES + 16) / panel.width if has_pressures(panel) else 0.94
    if panel.width < 400:  # partly behind the gauges, which hide little of a leg
        left = -0.25
    return left, right, -0.93, 0.93


def traces() -> tuple[Rect, Rect]:
    """Returns the rectangles of the axes of error and command, without their labels."""
    top, bottom = SIZE[1] - TRACES + 40, SIZE[1] - 34
    return Rect(64, top, 700, bottom), Rect(796, top, SIZE[0] - 24, bottom)


Rgb = tuple[int, int, int]


def rgb(color: str) -> Rgb:
    """Returns red, green, blue in 0..255 of a colour such as "#0072B2"."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


INK, SOFT, FAINT, PAPER = (24, 28, 34), (92, 100, 110), (222, 226, 231), (255, 255, 255)
ALARM = rgb(VERMILION)
NAMED = rgb(BLUE)  # changes named by a controller
TIMES = "\N{MULTIPLICATION SIGN}"
RUNS = tuple(rgb(color) for color in SERIES)  # one colour per run
GHOST = (0.02, 0.62, 0.80, 0.42)
UNKNOWN = (0.55, 0.57, 0.60)

# Colours of pressures: blue, pink, yellow. They are visible on light and on dark ground, and their
# lightness increases with the pressure, so that colour-blind readers see the order.
_STOPS = np.array([0.0, 0.5, 1.0])
_COLORS = np.array([[0.09, 0.27, 0.86], [0.88, 0.28, 0.55], [1.0, 0.85, 0.10]])


def pressure_color(level: float | np.ndarray) -> np.ndarray:
    """Returns the colour of a pressure.

    Args:
        level: Pressure divided by the end of the colour bar, any shape; clipped to [0, 1].

    Returns:
        Red, green, blue in 0..1, shape `(*level.shape, 3)`.
    """
    level = np.clip(np.asarray(level, dtype=float), 0.0, 1.0)
    return np.stack([np.interp(level, _STOPS, _COLORS[:, i]) for i in range(3)], axis=-1)


@functools.cache
def font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Returns the font of Matplotlib, on which leglab depends, in a size [px]."""
    # The package is located, not imported: importing it takes longer than rendering some films.
    spec = importlib.util.find_spec("matplotlib")
    assert spec is not None
    assert spec.origin is not None
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    folder = Path(spec.origin).parent / "mpl-data" / "fonts" / "ttf"
    return ImageFont.truetype(str(folder / name), size)


@functools.lru_cache(maxsize=512)
def fitted(text: str, size: int, width: float, bold: bool = False) -> str:
    """Cuts a text off with an ellipsis if it is wider than `width` [px]."""
    face = font(size, bold)
    if face.getlength(text) <= width:
        return text
    while text and face.getlength(text + "…") > width:
        text = text[:-1]
    return text.rstrip() + "…"


def write(
    draw: ImageDraw.ImageDraw,
    place: tuple[float, float],
    text: str,
    size: int,
    fill: Rgb,
    *,
    bold: bool = False,
    anchor: str = "lt",
) -> None:
    """Writes a line of text; see Pillow for `anchor`. Rendered texts are cached for reuse."""
    shape, left, top = _shape(text, size, bold, anchor)
    draw.bitmap((int(place[0]) + left, int(place[1]) + top), shape, fill=fill)


@functools.lru_cache(maxsize=512)
def _shape(text: str, size: int, bold: bool, anchor: str) -> tuple[Image.Image, int, int]:
    """Returns the coverage of each pixel by a text, and the offset of the text [px]."""
    face = font(size, bold)
    left, top, right, bottom = (int(edge) for edge in face.getbbox(text, anchor=anchor))
    shape = Image.new("L", (max(right - left, 1), max(bottom - top, 1)))
    ImageDraw.Draw(shape).text((-left, -top), text, font=face, fill=255, anchor=anchor)
    return shape, left, top
