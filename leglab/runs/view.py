"""Plots of a run for notebooks."""

from collections.abc import Sequence
from typing import Any

from leglab.base.notebook import panels
from leglab.base.recording import Recording
from leglab.runs.record import ChangeRecord


def draw(recording: Recording, changes: Sequence[ChangeRecord]) -> list[Any]:
    """Draws true tracking error [mrad or mm] and command of every joint; changes are dashed lines.

    Returns:
        The vertically stacked axes of a new `matplotlib.pyplot` figure.
    """
    axes, unit = panels(2), recording.error_unit(recording.tracked)
    for joint in recording.tracked:
        position = f"{joint}_truth" if f"{joint}_truth" in recording else f"{joint}_position"
        error = 1e3 * (recording[position] - recording[f"{joint}_reference"])
        axes[0].plot(recording.time, error, label=joint, linewidth=0.8)
    for joint in recording.tracked:
        command = recording.command_of(joint)
        if command is not None:
            name = recording.actuator_of(joint)
            axes[1].plot(recording.time, command, label=name, linewidth=0.8)
    for axis, label in zip(axes, (f"tracking error [{unit}]", "command"), strict=True):
        axis.set_ylabel(label)
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")
        for start in sorted({change.start for change in changes if change.start > 0}):
            axis.axvline(start, color="0.4", linestyle="--", linewidth=0.8)
    axes[-1].set_xlabel("time [s]")
    return axes
