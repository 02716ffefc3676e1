"""History of a closed loop, one row per control period: blocks of rows, and the whole history."""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from leglab.control import ReferencePoint


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Recorded quantities of a closed loop, one row per control period."""

    time: np.ndarray  #: [s], shape (n,)
    position: np.ndarray  #: True positions of the driven joints [rad], (n, joints)
    velocity: np.ndarray  #: True velocities of the driven joints [rad/s], (n, joints)
    #: True positions of passive joints, by joint [rad or m], each (n,).
    passive: dict[str, np.ndarray]
    command: np.ndarray  #: Commands in [-1, 1] held for one period from `time`, (n, joints)
    #: Actuator inputs for these commands: the command of a valve, or the control input of a native
    #: actuator in its unit, (n, joints).
    control: np.ndarray
    #: Position [rad], velocity [rad/s] and acceleration [rad/s^2], each (n, joints).
    reference: ReferencePoint
    #: Values of the recorded plugin states, by column name, each (n,).
    states: dict[str, np.ndarray]
    encoder_shift: np.ndarray  #: Offset of positions by encoder faults [rad], (n, joints)
    encoder_lost: np.ndarray  #: True where an encoder repeated its last reading, (n, joints)
    diagnostics: dict[str, np.ndarray]  #: Reports of the controller by name, each (n, joints)

    @property
    def error(self) -> np.ndarray:
        """True tracking error, position less reference [rad], (n, joints)."""
        return self.position - self.reference.position


@dataclass(frozen=True, kw_only=True)
class Ending:
    """Length, wall time and possible failure of a closed loop."""

    rows: int  #: Number of recorded periods
    wall_time: float  #: Wall time of the loop only [s]
    failure: str = ""  #: Reason of an early end; empty if the loop did not end early


@dataclass(frozen=True, kw_only=True)
class History(Rows, Ending):
    """All rows of a closed loop, and how it ended."""

    def __repr__(self) -> str:
        rows, joints = self.position.shape
        failed = f", failed: {self.failure}" if self.failure else ""
        return f"History({rows} periods of {joints} joints, {self.time[-1]:g} s{failed})"


class Whole:
    """Concatenation of blocks of rows.

    Args:
        count: Maximum number of rows.
    """

    def __init__(self, count: int) -> None:
        self._count, self._rows = count, 0
        self._values: dict[tuple[str, str], np.ndarray] = {}

    def keep(self, rows: Rows) -> None:
        """Appends a copy of the next rows."""
        start = self._rows
        self._rows = start + len(rows.time)
        for place, values in _parts(rows):
            if place not in self._values:
                # Keeps the memory order of the block, on which the rounding of sums depends.
                whole = np.empty_like(values, shape=(self._count, *values.shape[1:]))
                whole[:start] = np.nan  # rows before the first report of this quantity
                self._values[place] = whole
            self._values[place][start : self._rows] = values

    def history(self, ending: Ending) -> History:
        """Returns all rows; `keep` must not be called afterwards."""
        found: dict[str, Any] = {"passive": {}, "states": {}, "diagnostics": {}, "reference": {}}
        for (field, key), values in self._values.items():
            kept = values[: self._rows]
            if values.ndim == 1:  # Read-only: a recording uses it without a copy.
                values.resize(self._rows, refcheck=False)
                values.setflags(write=False)
                kept = values
            if key:
                found[field][key] = kept
            else:
                found[field] = kept
        found["reference"] = ReferencePoint(**found["reference"])
        return History(**found, **vars(ending))


def _parts(rows: Rows) -> Iterator[tuple[tuple[str, str], np.ndarray]]:
    """Yields each array with its place: the field's name, and the key if the field is a dict."""
    for field in fields(rows):
        value = getattr(rows, field.name)
        if isinstance(value, np.ndarray):
            yield (field.name, ""), value
        else:
            named = value if isinstance(value, dict) else value._asdict()
            yield from (((field.name, key), values) for key, values in named.items())
