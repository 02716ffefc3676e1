"""Small instruments in the panel of a run: supply, oil, seals, and pressures of every cylinder."""

import numpy as np
from PIL import ImageDraw

from leglab.report.film.layout import GAUGES, PRESSURES, Rect, has_pressures
from leglab.report.film.look import ALARM, FAINT, INK, SOFT, TIMES, fitted, pressure_color, write
from leglab.report.film.track import Track

BAR = 1e5  # Pa
_MOST_LEAKAGE = 100.0
_HOTTEST = 100.0  # degC
_STEP = 46  # from one gauge to the next [px]
_ROW = 44  # from one cylinder to the next [px]
_CARD = (255, 255, 255, 195)
_BAR_LENGTH = 104  # px


class Gauges:
    """Instruments of one run.

    Args:
        track: The run.
        panel: Its place.
        scale: Pressure at the end of the colour bar [Pa].
    """

    def __init__(self, track: Track, panel: Rect, scale: float) -> None:
        self._panel, self._scale = panel, scale
        self._leakage = track.seal_leakage()
        self._oil = track.oil_temperature()
        self._supply = track.column("supply_pressure")
        self._pressures = []
        if has_pressures(panel):
            for joint in track.joints:
                sides = [track.column(f"{joint}_pressure_{side}") for side in "ab"]
                if sides[0] is not None and sides[1] is not None:
                    self._pressures.append((joint, sides[0], sides[1]))
        most = (panel.height - 60) // _ROW
        self._pressures = self._pressures[:most]

    def draw(self, draw: ImageDraw.ImageDraw, row: int) -> None:
        """Draws what they show at a row of the recording."""
        readings = self._readings(row)
        left, width = self._panel.left + 14, GAUGES - 14
        top = self._panel.bottom - 12 - _STEP * len(readings)
        if readings:
            box = (left - 8, top - 4, left + width + 8, self._panel.bottom - 8)
            draw.rounded_rectangle(box, 6, fill=_CARD)
        for name, text, share, alarm in readings:
            ink = ALARM if alarm else INK
            write(draw, (left, top + 2), name, 13, SOFT)
            write(draw, (left, top + 17), text, 16, ink, bold=True)
            end = left + width * float(np.clip(np.nan_to_num(share), 0.0, 1.0))
            draw.rectangle((left, top + 36, left + width, top + 39), fill=FAINT)
            draw.rectangle((left, top + 36, end, top + 39), fill=ink)
            top += _STEP
        if self._pressures:
            self._draw_pressures(draw, row)

    def _readings(self, row: int) -> list[tuple[str, str, float, bool]]:
        """Name, value, share of the bar and whether it is a cause for alarm."""
        found = []
        if self._supply is not None:
            value = float(self._supply[row])
            found.append(("supply", f"{value / BAR:.0f} bar", value / self._scale, False))
        if self._oil is not None:
            value = float(self._oil[row])
            found.append(("oil", f"{value:.0f} °C", value / _HOTTEST, False))
        if self._leakage is not None:
            worst = float(self._leakage[row].max())
            share = float(np.log10(max(worst, 1.0)) / np.log10(_MOST_LEAKAGE))
            text = f"{worst:.{1 if worst < 9.95 else 0}f}{TIMES} new"
            found.append(("seal leakage", text, share, worst > 1.05))
        return found

    def _draw_pressures(self, draw: ImageDraw.ImageDraw, row: int) -> None:
        panel = self._panel
        left, right = panel.right - PRESSURES, panel.right - 14
        top = panel.bottom - 40 - _ROW * len(self._pressures)
        draw.rounded_rectangle((left - 8, top - 8, right + 6, panel.bottom - 8), 6, fill=_CARD)
        write(draw, (left, top), "cylinder", 13, SOFT)
        write(draw, (right, top), "cap, rod [bar]", 13, SOFT, anchor="rt")
        top += 22
        for joint, cap, rod in self._pressures:
            name = fitted(joint.replace("_", " "), 14, PRESSURES - 20)
            write(draw, (left, top), name, 14, INK)
            for i, value in enumerate((float(cap[row]), float(rod[row]))):
                y = top + 17 + 12 * i
                level = float(np.clip(np.nan_to_num(value / self._scale), 0.0, 1.0))
                color = tuple(int(255 * c) for c in pressure_color(level))
                draw.rectangle((left, y, left + _BAR_LENGTH, y + 8), fill=FAINT)
                draw.rectangle((left, y, left + _BAR_LENGTH * level, y + 8), fill=color)
                text = f"{value / BAR:.0f}" if np.isfinite(value) else "-"
                write(draw, (right, y + 4), text, 13, INK, anchor="rm")
            top += _ROW
