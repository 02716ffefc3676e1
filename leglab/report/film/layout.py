"""Where everything is in the picture [px]."""

from dataclasses import dataclass

SIZE = (1280, 720)
HEAD = 52  # height of the title above the panels
HEADING = 36  # height of the heading of a panel, above its picture
TRACES = 232  # height of the traces below them
GAP = 4  # between panels
GAUGES = 132  # width of the gauges at the left of a panel
PRESSURES = 168  # width of the pressures at the right of a wide panel
MAX_RUNS = 4


@dataclass(frozen=True)
class Rect:
    """A part of the picture, right and bottom not included [px]."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def width(self) -> int:
        """[px]."""
        return self.right - self.left

    @property
    def height(self) -> int:
        """[px]."""
        return self.bottom - self.top


def panels(count: int) -> list[Rect]:
    """Places of the machines, side by side and of one size."""
    width = (SIZE[0] - GAP * (count - 1)) // count
    bottom = SIZE[1] - TRACES
    lefts = [round(i * (SIZE[0] - width) / max(count - 1, 1)) for i in range(count)]
    return [Rect(left, HEAD + HEADING, left + width, bottom) for left in lefts]


def has_pressures(panel: Rect) -> bool:
    """Whether there is room for the pressures of every cylinder at the right of a panel."""
    return panel.width >= 600


def leg_region(panel: Rect) -> tuple[float, float, float, float]:
    """Left, right, bottom, top of what the leg may fill of a panel, from -1 to 1.

    Changes and gauges keep to the left of it, pressures to the right.
    """
    left = 2.0 * (GAUGES + 16) / panel.width - 1.0
    right = 1.0 - 2.0 * (PRESSURES + 16) / panel.width if has_pressures(panel) else 0.94
    if panel.width < 400:  # behind the gauges, which hide little of a leg's height
        left = -0.25
    return left, right, -0.93, 0.93


def traces() -> tuple[Rect, Rect]:
    """Places of the axes of error and command, their labels outside."""
    top, bottom = SIZE[1] - TRACES + 40, SIZE[1] - 34
    return Rect(64, top, 700, bottom), Rect(796, top, SIZE[0] - 24, bottom)
