"""Frames of a film: one panel per run with heading, gauges and changes, and traces below."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from leglab.report.film import framing, look
from leglab.report.film.look import ALARM, INK, NAMED, PAPER, SOFT, Rect, Rgb, fitted, font, write
from leglab.report.film.machine import DrawnMachine, DrawnRun
from leglab.report.film.traces import CommandTrace, ErrorTrace
from leglab.report.film.track import Track, details, load_track
from leglab.report.page.wording import readable

_BAR = 1e5  # Pa
_POSES = 24  # number of times of the film at which the machine must lie within the camera's view
_BAR_STEP = 20e5  # the colour bar ends at a multiple of this [Pa]
_VEIL = (255, 255, 255, 200)  # colour laid over the panel of a run that has ended
_TAG_CARD, _GAUGE_CARD = (255, 255, 255, 205), (255, 255, 255, 195)  # backgrounds of texts
_FLASH = 1.2  # time after a change during which the panel's border is thicker [s]
_MOST_CHANGES = 3  # maximum number of changes named in a panel: the latest ones
_MOST_LEAKAGE = 100.0  # leakage at the end of the gauge's bar, relative to new seals
_HOTTEST = 100.0  # oil temperature at the end of the gauge's bar [degC]
_STEP = 46  # vertical distance between gauges [px]
_ROW = 44  # vertical distance between the pressures of two cylinders [px]
_LEVEL_LENGTH = 104  # length of a pressure's bar [px]


class Picture:
    """Draws the frames of a film. It holds OpenGL contexts: call `close` after use.

    Args:
        folders: Folders of the runs, shown side by side.
        span: First and last time of the film [s].
        camera: Name of a camera of the models.

    Raises:
        LeglabError: A run, a model or a camera is missing or damaged.
    """

    def __init__(self, folders: Sequence[Path], span: tuple[float, float], camera: str) -> None:
        tracks = [load_track(folder) for folder in folders]
        colors = look.RUNS[: len(tracks)]
        self._panels = look.panels(len(tracks))
        size = self._panels[0].size
        supplies = [track.column("supply_pressure") for track in tracks]
        supplies_known = any(supply is not None for supply in supplies)
        highest = max((float(np.nanmax(s)) for s in supplies if s is not None), default=160e5)
        scale = _BAR_STEP * np.ceil(highest / _BAR_STEP - 0.05)
        drawn = {track.machine: (track.model, track.machine[1]) for track in tracks}
        self._machines = {key: DrawnMachine(*model, size) for key, model in drawn.items()}
        machines = [self._machines[track.machine] for track in tracks]
        self._stages = [DrawnRun(m, t, scale) for m, t in zip(machines, tracks, strict=True)]
        self._frame(machines, np.linspace(*span, _POSES), camera, size)
        left, right = look.traces()
        self._error = ErrorTrace(tracks, colors, left, span)
        self._command = CommandTrace(tracks, colors, right, span)
        columns = (tracks, details(tracks), colors, self._panels, self._error.errors)
        self._writers = [_PanelWriter(*row, scale) for row in zip(*columns, strict=True)]
        self._base = Image.new("RGB", look.SIZE, PAPER)
        _draw_title(self._base, *_title_of(tracks), scale if supplies_known else None)
        self._error.draw_static(self._base)
        self._command.draw_static(self._base)

    def close(self) -> None:
        """Frees the OpenGL contexts."""
        for machine in self._machines.values():
            machine.close()

    def draw(self, time: float) -> Image.Image:
        """Returns the frame at a time [s], RGB."""
        image = self._base.copy()
        for stage, writer, panel in zip(self._stages, self._writers, self._panels, strict=True):
            image.paste(stage.draw(time), (panel.left, panel.top))
            writer.draw(image, time)
        self._error.draw(image, time)
        self._command.draw(image, time)
        place = (look.SIZE[0] - 16, look.HEAD // 2)
        face = font(22, True)
        ImageDraw.Draw(image).text(place, f"{time:.2f} s", font=face, fill=INK, anchor="rm")
        return image

    def _frame(
        self, machines: list[DrawnMachine], times: np.ndarray, camera: str, size: tuple[int, int]
    ) -> None:
        """Sets one camera for all runs of a model, so that their pictures can be compared."""
        for machine in self._machines.values():
            stages = [s for s, m in zip(self._stages, machines, strict=True) if m is machine]
            points = np.concatenate([stage.extent(times) for stage in stages])
            region = look.leg_region(self._panels[0])
            view = stages[0].direction(camera)
            machine.look(framing.frame(points, view, size[0] / size[1], region))


def _draw_title(image: Image.Image, title: str, subtitle: str, scale: float | None) -> None:
    """Draws title, legend of the ghost, and the colour bar of pressures up to `scale` [Pa].

    If no pressures were recorded, `scale` is None and no bar is drawn.
    """
    draw = ImageDraw.Draw(image)
    text = fitted(title, 22, 390, bold=True)
    write(draw, (16, 23), text, 22, INK, bold=True, anchor="lm")
    write(draw, (16, 42), fitted(subtitle, 13, 390), 13, SOFT, anchor="lm")
    tint = tuple(round(255 * (0.45 + 0.55 * c)) for c in look.GHOST[:3])
    edge = tuple(round(200 * c) for c in look.GHOST[:3])
    draw.rounded_rectangle((424, 17, 450, 35), 5, fill=tint, outline=edge)
    write(draw, (458, 26), "see-through: the reference", 15, INK, anchor="lm")
    if scale is None:
        return
    left, width = 872, 150
    write(draw, (left - 10, 26), "cylinder pressure", 15, INK, anchor="rm")
    colors = (255 * look.pressure_color(np.linspace(0, 1, width))).astype(np.uint8)
    image.paste(Image.fromarray(np.repeat(colors[None], 14, axis=0)), (left, 11))
    for value in (0.0, 0.5, 1.0):
        place = left + value * width
        draw.line((place, 25, place, 29), fill=SOFT, width=1)
        label = f"{value * scale / _BAR:.0f}" + (" bar" if value == 1.0 else "")
        write(draw, (place, 31), label, 14, SOFT, anchor="mt")


class _PanelWriter:
    """Writer of one run's panel: heading, changes, gauges, and a text after the end of the run.

    `detail` distinguishes runs with the same controller, `color` is the colour of the run's traces,
    `error` its moving RMS error [mrad or mm], `scale` the pressure at the colour bar's end [Pa].
    """

    def __init__(
        self, track: Track, detail: str, color: Rgb, panel: Rect, error: np.ndarray, scale: float
    ) -> None:
        self._track, self._detail, self._color, self._panel = track, detail, color, panel
        self._unit = track.recording.error_unit(track.joints)
        self._error, self._gauges = error, _Gauges(track, panel, scale)

    def draw(self, image: Image.Image, time: float) -> None:
        """Draws the panel's texts and gauges at a time [s]."""
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
        panel, middle = self._panel, self._panel.top - look.HEADING // 2 + 3
        top = panel.top - look.HEADING
        draw.rectangle((panel.left, top, panel.right - 1, top + 5), fill=self._color)
        value, narrow = self._error[self._track.row(time)], panel.width < 400
        if np.isfinite(value):
            shown = f"{value:.{0 if value >= 100 else 1 if value >= 10 else 2}f} {self._unit}"
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

        def tag(text: str, size: int, ink: Rgb, card: tuple[int, ...]) -> None:
            nonlocal top
            bold = size == 15
            text = fitted(text, size, panel.width - 44, bold=bold)
            width = font(size, bold).getlength(text)
            draw.rounded_rectangle((left, top, left + width + 16, top + 25), 5, fill=card)
            write(draw, (left + 8, top + 13), text, size, ink, bold=bold, anchor="lm")
            top += 29

        if self._detail:
            tag(self._detail, 14, INK, _TAG_CARD)
        for change in past[-_MOST_CHANGES:]:
            text = change.text
            if change.start <= time < change.end:
                text += f", {100 * (time - change.start) / (change.end - change.start):.0f} %"
            tag(text, 15, PAPER, (*ALARM, 255))
        for name in self._track.named:
            if name.start <= time < name.end:
                tag(name.text, 15, PAPER, (*NAMED, 255))
        if self._track.undone and time >= self._track.undone[0]:
            tag(self._track.undone[1], 14, INK, _TAG_CARD)

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


def _title_of(tracks: Sequence[Track]) -> tuple[str, str]:
    """Returns title and subtitle: scenarios, models and references of all runs."""
    scenarios, models, references = (
        list(dict.fromkeys(str(track.settings.get(name, "")) for track in tracks))
        for name in ("scenario", "model", "reference")
    )
    parts = [", ".join(Path(model).stem for model in models), ", ".join(filter(None, references))]
    return readable(" / ".join(scenarios)), readable(" · ".join(filter(None, parts)))


def _wrapped(text: str, width: float) -> list[str]:
    """Wraps a text into at most four lines of `width` [px]; words that are wider are not split."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else ""
        if lines and font(14).getlength(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines[:4]


class _Gauges:
    """Gauges of supply, oil, seals and cylinders; the bars of pressures end at `scale` [Pa]."""

    def __init__(self, track: Track, panel: Rect, scale: float) -> None:
        self._panel, self._scale = panel, scale
        self._leakage = track.seal_leakage()
        self._oil = track.oil_temperature()
        self._supply = track.column("supply_pressure")
        self._pressures = []
        for joint in track.joints if look.has_pressures(panel) else ():
            cap, rod = (track.column(f"{joint}_pressure_{side}") for side in "ab")
            if cap is not None and rod is not None:
                self._pressures.append((joint, cap, rod))
        del self._pressures[(panel.height - 60) // _ROW :]

    def draw(self, draw: ImageDraw.ImageDraw, row: int) -> None:
        """Draws the gauges with the values of sample `row` of the recording."""
        readings = self._readings(row)
        left, width = self._panel.left + 14, look.GAUGES - 14
        top = self._panel.bottom - 12 - _STEP * len(readings)
        if readings:
            box = (left - 8, top - 4, left + width + 8, self._panel.bottom - 8)
            draw.rounded_rectangle(box, 6, fill=_GAUGE_CARD)
        for name, text, share, alarm in readings:
            ink = ALARM if alarm else INK
            write(draw, (left, top + 2), name, 13, SOFT)
            write(draw, (left, top + 17), text, 16, ink, bold=True)
            end = left + width * float(np.clip(np.nan_to_num(share), 0.0, 1.0))
            draw.rectangle((left, top + 36, left + width, top + 39), fill=look.FAINT)
            draw.rectangle((left, top + 36, end, top + 39), fill=ink)
            top += _STEP
        if self._pressures:
            self._draw_pressures(draw, row)

    def _readings(self, row: int) -> list[tuple[str, str, float, bool]]:
        """Returns each gauge's name, value as text, filled share of its bar, and alarm."""
        found = []
        if self._supply is not None:
            value = float(self._supply[row])
            found.append(("supply", f"{value / _BAR:.0f} bar", value / self._scale, False))
        if self._oil is not None:
            value = float(self._oil[row])
            found.append(("oil", f"{value:.0f} °C", value / _HOTTEST, False))
        if self._leakage is not None:
            worst = float(self._leakage[row].max())
            share = float(np.log10(max(worst, 1.0)) / np.log10(_MOST_LEAKAGE))
            text = f"{worst:.{1 if worst < 9.95 else 0}f}{look.TIMES} new"
            found.append(("seal leakage", text, share, worst > 1.05))
        return found

    def _draw_pressures(self, draw: ImageDraw.ImageDraw, row: int) -> None:
        panel = self._panel
        left, right = panel.right - look.PRESSURES, panel.right - 14
        top = panel.bottom - 40 - _ROW * len(self._pressures)
        box = (left - 8, top - 8, right + 6, panel.bottom - 8)
        draw.rounded_rectangle(box, 6, fill=_GAUGE_CARD)
        write(draw, (left, top), "cylinder", 13, SOFT)
        write(draw, (right, top), "cap, rod [bar]", 13, SOFT, anchor="rt")
        top += 22
        for joint, cap, rod in self._pressures:
            name = fitted(readable(joint), 14, look.PRESSURES - 20)
            write(draw, (left, top), name, 14, INK)
            for i, value in enumerate((float(cap[row]), float(rod[row]))):
                y = top + 17 + 12 * i
                level = float(np.clip(np.nan_to_num(value / self._scale), 0.0, 1.0))
                color = tuple(int(255 * c) for c in look.pressure_color(level))
                draw.rectangle((left, y, left + _LEVEL_LENGTH, y + 8), fill=look.FAINT)
                draw.rectangle((left, y, left + _LEVEL_LENGTH * level, y + 8), fill=color)
                text = f"{value / _BAR:.0f}" if np.isfinite(value) else "-"
                write(draw, (right, y + 4), text, 13, INK, anchor="rm")
            top += _ROW
