"""Axes of the traces: scales, ticks, and lines that are drawn smoothly."""

import math
from collections.abc import Callable

import numpy as np
from PIL import Image, ImageDraw

from leglab.report.film.layout import Rect
from leglab.report.film.look import FAINT, INK, SOFT, Rgb, font

_SMOOTH = 3  # lines are drawn this many times larger
_LABEL = 14
_LINE_WIDTH = 2.2


def nice_ticks(low: float, high: float, most: int) -> np.ndarray:
    """At most `most` round values between two bounds, 1, 2 or 5 times a power of ten apart."""
    span = max(high - low, 1e-12)
    step = 10.0 ** math.floor(math.log10(span / most))
    for factor in (1, 2, 5, 10, 20):
        if span / (factor * step) <= most:
            step *= factor
            break
    first = math.ceil(low / step - 1e-9)
    return step * np.arange(first, math.floor(high / step + 1e-9) + 1)


def draw_frame(
    draw: ImageDraw.ImageDraw,
    rect: Rect,
    title: str,
    ticks: list[tuple[float, str]],
    note: str = "",
) -> None:
    """Title, horizontal grid lines with their labels, and the base line.

    Args:
        draw: Of the picture.
        rect: The axes.
        title: Above them.
        ticks: Height [px] and label of each grid line.
        note: Behind the title, in grey.
    """
    draw.text((rect.left, rect.top - 17), title, font=font(15, True), fill=INK, anchor="ls")
    if note:
        x = rect.left + font(15, True).getlength(title) + 10
        draw.text((x, rect.top - 17), note, font=font(_LABEL), fill=SOFT, anchor="ls")
    for y, label in ticks:
        draw.line((rect.left, y, rect.right, y), fill=FAINT, width=1)
        if label:
            draw.text((rect.left - 8, y), label, font=font(_LABEL), fill=SOFT, anchor="rm")
    draw.line((rect.left, rect.bottom, rect.right, rect.bottom), fill=SOFT, width=1)


def draw_time_labels(draw: ImageDraw.ImageDraw, rect: Rect, ticks: list[tuple[float, str]]) -> None:
    """Labels of the time axis, at x [px], below the axes."""
    for x, label in ticks:
        draw.line((x, rect.bottom, x, rect.bottom + 4), fill=SOFT, width=1)
        draw.text((x, rect.bottom + 7), label, font=font(_LABEL), fill=SOFT, anchor="mt")


def smooth_lines(
    size: tuple[int, int], paint: Callable[[ImageDraw.ImageDraw, int], None]
) -> Image.Image:
    """A layer with smooth lines.

    Args:
        size: Width and height [px].
        paint: Draws onto a larger layer; its second argument says how much larger.
    """
    width, height = size
    layer = Image.new("RGBA", (width * _SMOOTH, height * _SMOOTH), (255, 255, 255, 0))
    paint(ImageDraw.Draw(layer), _SMOOTH)
    # Premultiplied, so that the white of the empty layer does not show at the edges.
    return layer.convert("RGBa").reduce(_SMOOTH).convert("RGBA")


def polyline(
    draw: ImageDraw.ImageDraw, x: np.ndarray, y: np.ndarray, color: Rgb, scale: int
) -> None:
    """Draws a line through points [px], broken where y is not finite.

    Points that share a column are thinned to its first, lowest, highest and last one.
    """
    finite = np.isfinite(y)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], finite.view(np.int8), [0]])))
    for start, stop in edges.reshape(-1, 2):
        keep = _thinned(x[start:stop], y[start:stop])
        points = np.column_stack([x[start:stop][keep], y[start:stop][keep]]) * scale
        if len(points) > 1:
            draw.line(
                [tuple(p) for p in points.tolist()],
                fill=(*color, 255),
                width=round(_LINE_WIDTH * scale),
                joint="curve",
            )


def _thinned(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    columns = np.floor(x).astype(int)
    starts = np.flatnonzero(np.diff(columns, prepend=columns[0] - 1))
    kept = []
    for a, b in zip(starts, [*starts[1:], len(x)], strict=True):
        part = y[a:b]
        kept += sorted({a, a + int(part.argmin()), a + int(part.argmax()), b - 1})
    return np.array(kept, dtype=int)
