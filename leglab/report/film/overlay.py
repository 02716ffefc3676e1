"""What is written into the picture: title, headings, gauges, changes, the end of a run."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from leglab.report.film.gauges import BAR, Gauges
from leglab.report.film.layout import HEAD, HEADING, SIZE, Rect
from leglab.report.film.look import (
    ALARM,
    GHOST,
    INK,
    PAPER,
    SOFT,
    Rgb,
    fitted,
    font,
    pressure_color,
    write,
)
from leglab.report.film.track import Track

_VEIL = (255, 255, 255, 200)
_CARD = (255, 255, 255, 205)
_FLASH = 1.2  # s
_MOST_CHANGES = 3


def draw_title(image: Image.Image, title: str, subtitle: str, scale: float) -> None:
    """Title, what the ghost is, and the colour bar of the pressures up to `scale` [Pa]."""
    draw = ImageDraw.Draw(image)
    text = fitted(title, 22, 390, bold=True)
    write(draw, (16, 23), text, 22, INK, bold=True, anchor="lm")
    write(draw, (16, 42), fitted(subtitle, 13, 390), 13, SOFT, anchor="lm")
    x = 424
    tint = tuple(round(255 * (0.45 + 0.55 * c)) for c in GHOST[:3])
    draw.rounded_rectangle(
        (x, 17, x + 26, 35), 5, fill=tint, outline=tuple(round(200 * c) for c in GHOST[:3])
    )
    write(draw, (x + 34, 26), "see-through leg: the reference", 15, INK, anchor="lm")
    left, width = 872, 150
    write(draw, (left - 10, 26), "cylinder pressure", 15, INK, anchor="rm")
    colors = (255 * pressure_color(np.linspace(0, 1, width))).astype(np.uint8)
    image.paste(Image.fromarray(np.repeat(colors[None], 14, axis=0)), (left, 11))
    for value in (0.0, 0.5, 1.0):
        place = left + value * width
        draw.line((place, 25, place, 29), fill=SOFT, width=1)
        label = f"{value * scale / BAR:.0f}" + (" bar" if value == 1.0 else "")
        write(draw, (place, 31), label, 14, SOFT, anchor="mt")


def draw_clock(image: Image.Image, time: float) -> None:
    """The time [s], at the right of the title."""
    draw = ImageDraw.Draw(image)
    draw.text(
        (SIZE[0] - 16, HEAD // 2), f"{time:.2f} s", font=font(22, True), fill=INK, anchor="rm"
    )


class PanelWriter:
    """Writes into the panel of one run.

    Args:
        track: The run.
        detail: What tells it from runs with the same controller.
        color: Its colour in the traces.
        panel: Its place.
        error: Moving error [mrad], (n,).
        scale: Pressure at the end of the colour bar [Pa].
    """

    def __init__(
        self, track: Track, detail: str, color: Rgb, panel: Rect, error: np.ndarray, scale: float
    ) -> None:
        self._track, self._detail, self._color, self._panel = track, detail, color, panel
        self._error, self._gauges = error, Gauges(track, panel, scale)

    def draw(self, image: Image.Image, time: float) -> None:
        """Everything that belongs to a time [s]."""
        draw, track, panel = ImageDraw.Draw(image, "RGBA"), self._track, self._panel
        over = time > track.end + 1e-6
        if over:
            draw.rectangle((panel.left, panel.top, panel.right - 1, panel.bottom - 1), fill=_VEIL)
        self._heading(draw, time)
        self._gauges.draw(draw, track.row(time))
        self._changes(draw, time)
        if over:
            self._end(draw)

    def _heading(self, draw: ImageDraw.ImageDraw, time: float) -> None:
        panel, middle = self._panel, self._panel.top - HEADING // 2 + 3
        top = panel.top - HEADING
        draw.rectangle((panel.left, top, panel.right - 1, top + 5), fill=self._color)
        value, narrow = self._error[self._track.row(time)], panel.width < 400
        if np.isfinite(value):
            shown = f"{value:.{0 if value >= 100 else 1 if value >= 10 else 2}f} mrad"
            shown = shown if narrow else f"error {shown}"
            write(draw, (panel.right - 10, middle), shown, 17, INK, anchor="rm")
        name, room = str(self._track.settings["controller"]), panel.width - (125 if narrow else 175)
        size = next((n for n in (19, 17, 15) if font(n, True).getlength(name) <= room), 14)
        text = fitted(name, size, room, bold=True)
        write(draw, (panel.left + 10, middle), text, size, INK, bold=True, anchor="lm")

    def _changes(self, draw: ImageDraw.ImageDraw, time: float) -> None:
        panel, left, top = self._panel, self._panel.left + 14, self._panel.top + 16
        past = [change for change in self._track.changes if change.start <= time + 1e-9]
        moving = [change for change in past if change.start > 0]
        if moving:
            width = 3 + round(7 * max(0.0, 1.0 - (time - moving[-1].start) / _FLASH))
            box = (panel.left, panel.top, panel.right - 1, panel.bottom - 1)
            draw.rectangle(box, outline=ALARM, width=width)
        if self._detail:
            _tag(
                draw, left, top, fitted(self._detail, 14, panel.width - 44), INK, _CARD, bold=False
            )
            top += 29
        for change in past[-_MOST_CHANGES:]:
            text = change.text
            if change.start <= time < change.end:
                text += f", {100 * (time - change.start) / (change.end - change.start):.0f} %"
            text = fitted(text, 15, panel.width - 44, bold=True)
            _tag(draw, left, top, text, PAPER, (*ALARM, 255), bold=True)
            top += 29

    def _end(self, draw: ImageDraw.ImageDraw) -> None:
        track, panel = self._track, self._panel
        x, y = (panel.left + panel.right) // 2, (panel.top + panel.bottom) // 2 - 20
        if track.stopped:
            lines = [(f"stopped at {track.end:.2f} s", 20, ALARM)]
            if track.planned_end > track.end:
                lines.append((f"of {track.planned_end:g} s", 16, INK))
            lines += [(line, 14, INK) for line in _wrapped(track.failure, panel.width - 40)]
        else:
            lines = [(f"run ends at {track.end:.2f} s", 20, INK)]
        for text, size, ink in lines:
            text = fitted(text, size, panel.width - 20, bold=size == 20)
            write(draw, (x, y), text, size, ink, bold=size == 20, anchor="mm")
            y += size + 10


def _tag(
    draw: ImageDraw.ImageDraw,
    left: int,
    top: int,
    text: str,
    ink: Rgb,
    card: tuple[int, int, int, int],
    *,
    bold: bool,
) -> None:
    size = 15 if bold else 14
    width = font(size, bold).getlength(text)
    draw.rounded_rectangle((left, top, left + width + 16, top + 25), 5, fill=card)
    write(draw, (left + 8, top + 13), text, size, ink, bold=bold, anchor="lm")


def title_of(tracks: Sequence[Track]) -> tuple[str, str]:
    """Title and subtitle: what all runs share."""
    scenarios = list(dict.fromkeys(str(t.settings["scenario"]) for t in tracks))
    models = list(dict.fromkeys(str(t.settings["model"]) for t in tracks))
    references = list(dict.fromkeys(str(t.settings.get("reference", "")) for t in tracks))
    parts = [", ".join(Path(model).stem for model in models), ", ".join(filter(None, references))]
    title = " / ".join(name.replace("_", " ") for name in scenarios)
    return title, " · ".join(part.replace("_", " ") for part in parts if part)


def _wrapped(text: str, width: float, most: int = 4) -> list[str]:
    lines, line = [], ""
    for word in text.split():
        longer = f"{line} {word}".strip()
        if line and font(14).getlength(longer) > width:
            lines.append(line)
            line = word
        else:
            line = longer
    return [*lines, *([line] if line else [])][:most]
