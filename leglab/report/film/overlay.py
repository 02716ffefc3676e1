"""What is written into the picture: title, headings, gauges, changes, the end of a run."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from leglab.report.film.layout import GAUGES, HEAD, HEADING, SIZE, Rect
from leglab.report.film.look import (
    ALARM,
    FAINT,
    GHOST,
    INK,
    PAPER,
    SOFT,
    TIMES,
    Rgb,
    fitted,
    font,
    pressure_color,
)
from leglab.report.film.track import Track

_BAR = 1e5  # Pa
_VEIL = (255, 255, 255, 200)
_FLASH = 1.2  # s
_MOST_LEAKAGE = 100.0
_HOTTEST = 100.0  # degC


def draw_title(image: Image.Image, title: str, subtitle: str, scale: float) -> None:
    """Title, what the ghost is, and the colour bar of the pressures up to `scale` [Pa]."""
    draw = ImageDraw.Draw(image)
    text = fitted(title, 22, 380, bold=True)
    draw.text((16, 23), text, font=font(22, True), fill=INK, anchor="lm")
    draw.text((16, 42), fitted(subtitle, 13, 420), font=font(13), fill=SOFT, anchor="lm")
    x = 470
    tint = tuple(round(255 * (0.45 + 0.55 * c)) for c in GHOST[:3])
    draw.rounded_rectangle(
        (x, 17, x + 26, 35), 5, fill=tint, outline=tuple(round(200 * c) for c in GHOST[:3])
    )
    draw.text((x + 34, 26), "see-through leg: the reference", font=font(15), fill=INK, anchor="lm")
    left, width = 852, 150
    draw.text((left - 10, 26), "pressure", font=font(15), fill=INK, anchor="rm")
    colors = (255 * pressure_color(np.linspace(0, 1, width))).astype(np.uint8)
    image.paste(Image.fromarray(np.repeat(colors[None], 14, axis=0)), (left, 11))
    for value in (0.0, 0.5, 1.0):
        place = left + value * width
        draw.line((place, 25, place, 29), fill=SOFT, width=1)
        label = f"{value * scale / _BAR:.0f}" + (" bar" if value == 1.0 else "")
        draw.text((place, 31), label, font=font(14), fill=SOFT, anchor="mt")


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
        label: Its heading.
        color: Its colour in the traces.
        panel: Its place.
        error: Moving error [mrad], (n,).
        scale: Pressure at the end of the colour bar [Pa].
    """

    def __init__(
        self, track: Track, label: str, color: Rgb, panel: Rect, error: np.ndarray, scale: float
    ) -> None:
        self._track, self._label, self._color, self._panel = track, label, color, panel
        self._error, self._scale = error, scale
        self._leakage = track.seal_leakage()
        self._oil = track.oil_temperature()
        self._supply = track.column("supply_pressure")

    def draw(self, image: Image.Image, time: float) -> None:
        """Everything that belongs to a time [s]."""
        draw, track, panel = ImageDraw.Draw(image, "RGBA"), self._track, self._panel
        over = time > track.end + 1e-6
        if over:
            draw.rectangle((panel.left, panel.top, panel.right - 1, panel.bottom - 1), fill=_VEIL)
        self._heading(draw, time)
        self._gauges(draw, time)
        self._changes(draw, time)
        if over:
            self._end(draw)

    def _heading(self, draw: ImageDraw.ImageDraw, time: float) -> None:
        panel, middle = self._panel, self._panel.top - HEADING // 2 + 3
        top = panel.top - HEADING
        draw.rectangle((panel.left, top, panel.right - 1, top + 5), fill=self._color)
        value = self._error[self._track.row(time)]
        if np.isfinite(value):
            shown = f"{value:.{0 if value >= 100 else 1 if value >= 10 else 2}f} mrad"
            draw.text((panel.right - 10, middle), shown, font=font(17), fill=INK, anchor="rm")
        text = fitted(self._label, 19, panel.width - 130, bold=True)
        draw.text((panel.left + 10, middle), text, font=font(19, True), fill=INK, anchor="lm")

    def _gauges(self, draw: ImageDraw.ImageDraw, time: float) -> None:
        row = self._track.row(time)
        gauges: list[tuple[str, str, float, bool]] = []
        if self._supply is not None:
            value = self._supply[row]
            gauges.append(("supply", f"{value / _BAR:.0f} bar", value / self._scale, False))
        if self._oil is not None:
            value = self._oil[row]
            gauges.append(("oil", f"{value:.0f} °C", value / _HOTTEST, False))
        if self._leakage is not None:
            worst = float(self._leakage[row].max())
            share = np.log10(max(worst, 1.0)) / np.log10(_MOST_LEAKAGE)
            text = f"{worst:.{1 if worst < 9.95 else 0}f}{TIMES} new"
            gauges.append(("seal leakage", text, share, worst > 1.05))
        left, step = self._panel.left + 14, 46
        top = self._panel.bottom - 12 - step * len(gauges)
        width = GAUGES - 14
        if gauges:
            box = (left - 8, top - 4, left + width + 8, self._panel.bottom - 8)
            draw.rounded_rectangle(box, 6, fill=(255, 255, 255, 190))
        for name, text, share, alarm in gauges:
            ink = ALARM if alarm else INK
            draw.text((left, top + 2), name, font=font(13), fill=SOFT, anchor="lt")
            draw.text((left, top + 17), text, font=font(16, True), fill=ink, anchor="lt")
            end = left + width * float(np.clip(np.nan_to_num(share), 0.0, 1.0))
            draw.rectangle((left, top + 36, left + width, top + 39), fill=FAINT)
            draw.rectangle((left, top + 36, end, top + 39), fill=ink)
            top += step

    def _changes(self, draw: ImageDraw.ImageDraw, time: float) -> None:
        panel = self._panel
        past = [change for change in self._track.changes if change.start <= time + 1e-9]
        if not past:
            return
        moving = [c for c in past if c.start > 0]
        age = time - moving[-1].start if moving else np.inf
        if moving:
            width = 3 + round(7 * max(0.0, 1.0 - age / _FLASH))
            box = (panel.left, panel.top, panel.right - 1, panel.bottom - 1)
            draw.rectangle(box, outline=ALARM, width=width)
        top = panel.top + 16
        for change in past[-2:]:
            text = change.text
            if change.start <= time < change.end:
                text += f", {100 * (time - change.start) / (change.end - change.start):.0f} %"
            text = fitted(text, 15, panel.width - 44, bold=True)
            left = panel.left + 14
            end = left + font(15, True).getlength(text) + 16
            draw.rounded_rectangle((left, top, end, top + 25), 5, fill=ALARM)
            draw.text((left + 8, top + 13), text, font=font(15, True), fill=PAPER, anchor="lm")
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
            draw.text((x, y), text, font=font(size, size == 20), fill=ink, anchor="mm")
            y += size + 10


def title_of(tracks: Sequence[Track]) -> tuple[str, str]:
    """Title and subtitle: what all runs share."""
    scenarios = list(dict.fromkeys(str(t.settings["scenario"]) for t in tracks))
    models = list(dict.fromkeys(str(t.settings["model"]) for t in tracks))
    references = list(dict.fromkeys(str(t.settings.get("reference", "")) for t in tracks))
    from pathlib import Path

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
