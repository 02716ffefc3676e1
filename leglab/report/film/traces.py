"""Traces below the panels of a film: tracking error and feed-forward command over time."""

import functools
import math
from collections.abc import Callable, Sequence

import numpy as np
from PIL import Image, ImageDraw

from leglab.base.units import shared_unit
from leglab.report.film.look import ALARM, FAINT, INK, SOFT, Rect, Rgb, font
from leglab.report.film.track import Track
from leglab.report.page.wording import readable

_MILLI = 1e3
_TILE = 512  # width of the cached pictures of which the command trace is composed [px]
_ALARM_LIGHT = tuple(round(255 - 0.35 * (255 - c)) for c in ALARM)
_SMOOTH = 3  # factor by which lines are drawn larger and then averaged, for smooth edges
_LABEL = 14  # font size of labels [px]
_LINE_WIDTH = 2.2  # px


class ErrorTrace:
    """Trace of the moving RMS error of all runs over the whole film, on a logarithmic axis.

    The axes are at `rect`; `span` is the first and last time of the film [s].
    """

    def __init__(
        self, tracks: Sequence[Track], colors: Sequence[Rgb], rect: Rect, span: tuple[float, float]
    ) -> None:
        self._rect, self._span, self._colors, self._tracks = rect, span, colors, tracks
        self.errors = [_MILLI * track.moving_error() for track in tracks]
        shown = [
            error[(track.recording.time >= span[0]) & (track.recording.time <= span[1])]
            for track, error in zip(tracks, self.errors, strict=True)
        ]
        values = np.concatenate(shown)
        values = values[np.isfinite(values) & (values > 0)]
        low, high = (values.min(), values.max()) if values.size else (1.0, 10.0)
        # Decimal exponents at the ends of the axis, with a margin, at least a decade apart.
        low, high = np.log10(float(low)) - 0.08, np.log10(float(high)) + 0.08
        missing = max(1.0 - (high - low), 0.0)
        self._low, self._high = low - 0.5 * missing, high + 0.5 * missing
        unit = shared_unit(track.recording.error_unit(track.joints) for track in tracks)
        windows = sorted({f"{track.window:.3g}" for track in tracks})
        self._note = f"RMS of all joints over {' / '.join(windows)} s, {unit}"
        self._lines = _smooth_lines((rect.width + 6, rect.height + 6), self._paint)

    def x(self, time: float | np.ndarray) -> np.ndarray:
        """Returns the distance of a time from the left edge of the axes [px]."""
        first, last = self._span
        return self._rect.width * (np.asarray(time) - first) / (last - first)

    def y(self, error: float | np.ndarray) -> np.ndarray:
        """Returns the distance of an error [mrad or mm] from the top of the axes [px]."""
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (np.log10(error) - self._low) / (self._high - self._low)
        return self._rect.height * (1.0 - np.clip(share, -0.02, 1.02))

    def draw_static(self, image: Image.Image) -> None:
        """Draws the axes, and faint vertical lines at the changes of the machine."""
        rect, draw = self._rect, ImageDraw.Draw(image)
        ticks = []
        for exponent in range(int(np.floor(self._low)), int(np.ceil(self._high)) + 1):
            for factor in (1, 2, 5):
                value = factor * 10.0**exponent
                if self._low - 1e-9 <= np.log10(value) <= self._high + 1e-9:
                    # An axis below two decades may have one power of ten only: label all ticks.
                    wide = factor == 1 or self._high - self._low < 2.0
                    ticks.append((rect.top + float(self.y(value)), f"{value:g}" if wide else ""))
        _draw_frame(draw, rect, "tracking error", ticks, self._note)
        for time in _nice_ticks(*self._span, 9):
            _draw_time(draw, rect, rect.left + float(self.x(time)), time)
        for start in _change_starts(self._tracks, self._span):
            x = rect.left + float(self.x(start))
            draw.line((x, rect.top, x, rect.bottom), fill=_ALARM_LIGHT, width=1)

    def draw(self, image: Image.Image, time: float) -> None:
        """Draws the traces up to a time [s]."""
        rect = self._rect
        now = int(np.clip(round(float(self.x(time))), 0, rect.width))
        lines = self._lines.crop((0, 0, now + 1, self._lines.height))
        image.paste(lines, (rect.left, rect.top), lines)
        draw = ImageDraw.Draw(image)
        _mark_changes(draw, rect, self._tracks, self._span, time, self.x)
        x = rect.left + now
        draw.line((x, rect.top, x, rect.bottom), fill=SOFT, width=1)
        for track, error, color in zip(self._tracks, self.errors, self._colors, strict=True):
            value = error[track.row(time)]
            if np.isfinite(value) and value > 0:
                place = min(float(self.x(min(time, track.end))), rect.width)
                _dot(image, rect.left + place, rect.top + float(self.y(value)), color)

    def _paint(self, draw: ImageDraw.ImageDraw, scale: int) -> None:
        for track, error, color in zip(self._tracks, self.errors, self._colors, strict=True):
            times = track.recording.time
            inside = (times >= self._span[0]) & (times <= self._span[1])
            y = np.where(error > 0, self.y(error), np.nan)
            _polyline(draw, self.x(times)[inside], y[inside], color, scale)


class CommandTrace:
    """Trace of the feed-forward command of one joint in the last seconds, which moves with time.

    If no run has a feed-forward, the trace shows the command. For `rect` and `span` see
    `ErrorTrace`.
    """

    def __init__(
        self, tracks: Sequence[Track], colors: Sequence[Rgb], rect: Rect, span: tuple[float, float]
    ) -> None:
        self._rect, self._tracks, self._colors = rect, tracks, colors
        window = float(np.clip(2.5 * max(track.window for track in tracks), 1.0, 4.0))
        self._window = min(window, max(span[1] - span[0], 0.2))
        self._origin = span[0] - self._window
        self._first = min(float(track.recording.time[0]) for track in tracks)
        shared = [j for j in tracks[0].joints if all(j in track.joints for track in tracks)]
        joint = "knee" if "knee" in shared else (shared or tracks[0].joints)[0]
        self._signals = [track.column(f"{joint}_feedforward") for track in tracks]
        self._title, self._note = "feed-forward command", readable(joint)
        pairs = zip(tracks, self._signals, strict=True)
        without = [str(track.settings["controller"]) for track, signal in pairs if signal is None]
        if len(without) == len(tracks):
            valves = all(track.recording.actuators_are_valves for track in tracks)
            self._title, without = "valve command" if valves else "command", []
            self._signals = [track.command(joint) for track in tracks]
        if without:
            self._note += f"; {', '.join(without)}: none"
        top = 0.0
        for track, signal in zip(tracks, self._signals, strict=True):
            if signal is not None:
                shown = signal[track.row(span[0]) : track.row(span[1]) + 1]
                top = max(top, float(np.abs(shown[np.isfinite(shown)]).max(initial=0.0)))
        self._limit = 1.1 * (top or 1.0)
        self._tile = functools.lru_cache(maxsize=8)(self._drawn_tile)

    def draw_static(self, image: Image.Image) -> None:
        """Draws the axes."""
        rect = self._rect
        values = _nice_ticks(-self._limit, self._limit, 5)
        ticks = [(rect.top + float(self._y(v)), f"{v:.3g}") for v in values]
        _draw_frame(ImageDraw.Draw(image), rect, self._title, ticks, self._note)

    def draw(self, image: Image.Image, time: float) -> None:
        """Draws the last seconds before a time [s], which is at the right end of the axes."""
        rect = self._rect
        per_second = rect.width / self._window
        shift = round((time - self._window - self._origin) * per_second)
        for index in range(shift // _TILE, (shift + rect.width) // _TILE + 1):
            tile = self._tile(index)
            left = index * _TILE - shift
            start, stop = max(0, -left), min(_TILE, rect.width - left)
            if start < stop:
                part = tile.crop((start, 0, stop, tile.height))
                image.paste(part, (rect.left + left + start, rect.top), part)
        draw = ImageDraw.Draw(image)

        def x(t: float | np.ndarray) -> np.ndarray:
            return rect.width - (time - np.asarray(t)) * per_second

        span = (time - self._window, time)
        for tick in _nice_ticks(*span, 5):
            place = rect.left + float(x(tick))
            if tick > self._first - 1e-9 and rect.left + 14 < place < rect.right - 10:
                _draw_time(draw, rect, place, tick)
        _mark_changes(draw, rect, self._tracks, span, time, x)
        for track, signal, color in zip(self._tracks, self._signals, self._colors, strict=True):
            if signal is not None and time <= track.end + 1e-9:
                value = signal[track.row(time)]
                if np.isfinite(value):
                    _dot(image, rect.right, rect.top + float(self._y(value)), color)

    def _y(self, value: float | np.ndarray) -> np.ndarray:
        share = np.clip(np.asarray(value) / self._limit, -1.02, 1.02)
        return self._rect.height * 0.5 * (1.0 - share)

    def _drawn_tile(self, index: int) -> Image.Image:
        """Draws tile `index`; tile 0 begins at the film's start minus the trace's duration."""
        return _smooth_lines((_TILE, self._rect.height), functools.partial(self._paint, index))

    def _paint(self, index: int, draw: ImageDraw.ImageDraw, scale: int) -> None:
        per_second = self._rect.width / self._window
        for track, signal, color in zip(self._tracks, self._signals, self._colors, strict=True):
            if signal is not None:
                x = (track.recording.time - self._origin) * per_second - index * _TILE
                near = np.flatnonzero((x > -20) & (x < _TILE + 20))
                if near.size > 1:
                    _polyline(draw, x[near], self._y(signal[near]), color, scale)


def _change_starts(tracks: Sequence[Track], span: tuple[float, float]) -> list[float]:
    """Returns start times [s] of changes that begin during a run and overlap a time span [s]."""
    changes = (change for track in tracks for change in track.changes if change.start > 0)
    return sorted({c.start for c in changes if c.end >= span[0] and c.start <= span[1]})


def _mark_changes(
    draw: ImageDraw.ImageDraw,
    rect: Rect,
    tracks: Sequence[Track],
    span: tuple[float, float],
    now: float,
    x: Callable[[float], np.ndarray],
) -> None:
    for start in _change_starts(tracks, span):
        if span[0] <= start <= now:
            place = rect.left + round(float(x(start)))
            draw.line((place, rect.top - 6, place, rect.bottom), fill=ALARM, width=2)
            top = rect.top - 12
            draw.polygon([(place - 5, top), (place + 6, top), (place, top + 8)], fill=ALARM)


def _dot(image: Image.Image, x: float, y: float, color: Rgb) -> None:
    dot = _smooth_dot(color)
    image.paste(dot, (round(x) - 6, round(y) - 6), dot)


@functools.cache
def _smooth_dot(color: Rgb) -> Image.Image:
    def paint(draw: ImageDraw.ImageDraw, scale: int) -> None:
        for edge, ink in ((1, (255, 255, 255)), (2, color)):
            low, high = edge * scale, (13 - edge) * scale
            draw.ellipse((low, low, high, high), fill=(*ink, 255))

    return _smooth_lines((13, 13), paint)


def _nice_ticks(low: float, high: float, most: int) -> np.ndarray:
    """Returns up to `most` + 1 values between bounds, 1, 2 or 5 times a power of ten apart."""
    span = max(high - low, 1e-12)
    step = 10.0 ** math.floor(math.log10(span / most))
    for factor in (1, 2, 5, 10, 20):
        if span / (factor * step) <= most:
            step *= factor
            break
    first = math.ceil(low / step - 1e-9)
    return step * np.arange(first, math.floor(high / step + 1e-9) + 1)


def _draw_frame(
    draw: ImageDraw.ImageDraw, rect: Rect, title: str, ticks: list[tuple[float, str]], note: str
) -> None:
    """Draws title, note in grey, grid lines at heights [px] with labels, and the base line."""
    draw.text((rect.left, rect.top - 17), title, font=font(15, True), fill=INK, anchor="ls")
    x = rect.left + font(15, True).getlength(title) + 10
    draw.text((x, rect.top - 17), note, font=font(_LABEL), fill=SOFT, anchor="ls")
    for y, label in ticks:
        draw.line((rect.left, y, rect.right, y), fill=FAINT, width=1)
        if label:
            draw.text((rect.left - 8, y), label, font=font(_LABEL), fill=SOFT, anchor="rm")
    draw.line((rect.left, rect.bottom, rect.right, rect.bottom), fill=SOFT, width=1)


def _draw_time(draw: ImageDraw.ImageDraw, rect: Rect, x: float, time: float) -> None:
    """Writes a time [s] below the axes at x [px]."""
    draw.line((x, rect.bottom, x, rect.bottom + 4), fill=SOFT, width=1)
    draw.text((x, rect.bottom + 7), f"{time:g} s", font=font(_LABEL), fill=SOFT, anchor="mt")


def _smooth_lines(
    size: tuple[int, int], paint: Callable[[ImageDraw.ImageDraw, int], None]
) -> Image.Image:
    """Returns an antialiased layer of `size` [px]; `paint` takes a drawing and its enlargement."""
    width, height = size
    layer = Image.new("RGBA", (width * _SMOOTH, height * _SMOOTH), (255, 255, 255, 0))
    paint(ImageDraw.Draw(layer), _SMOOTH)
    # Averaged with premultiplied alpha: otherwise the layer's white would show at edges of lines.
    return layer.convert("RGBa").reduce(_SMOOTH).convert("RGBA")


def _polyline(
    draw: ImageDraw.ImageDraw, x: np.ndarray, y: np.ndarray, color: Rgb, scale: int
) -> None:
    """Draws a line through points [px], broken where y is not finite.

    Of the points in one column of pixels only the first, lowest, highest and last are drawn.
    """
    finite = np.isfinite(y)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], finite.view(np.int8), [0]])))
    for start, stop in edges.reshape(-1, 2):
        keep = _thinned(x[start:stop], y[start:stop])
        points = np.column_stack([x[start:stop][keep], y[start:stop][keep]]) * scale
        if len(points) > 1:
            corners, width = [tuple(p) for p in points.tolist()], round(_LINE_WIDTH * scale)
            draw.line(corners, fill=(*color, 255), width=width, joint="curve")


def _thinned(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    columns = np.floor(x).astype(int)
    starts = np.flatnonzero(np.diff(columns, prepend=columns[0] - 1))
    kept = []
    for a, b in zip(starts, [*starts[1:], len(x)], strict=True):
        part = y[a:b]
        kept += sorted({a, a + int(part.argmin()), a + int(part.argmax()), b - 1})
    return np.array(kept, dtype=int)
