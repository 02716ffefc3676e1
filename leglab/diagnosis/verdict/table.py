"""Table of all sets of effects of a search, from which a verdict follows without any replay."""

import json
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from leglab.base.errors import FileError
from leglab.base.output import write_json
from leglab.diagnosis.effects.hypothesis import Key


@dataclass(frozen=True, kw_only=True)
class Action:
    """Influence of an effect of a set on the errors of a group of windows.

    Errors are medians over windows of squared whitened errors, by recording and channel.
    """

    numbers: tuple[int, ...]  #: Number of errors of a channel, by recording
    left: tuple[tuple[float, ...], ...]  #: Errors that the set leaves
    without: tuple[tuple[float, ...], ...]  #: Errors without the effect
    change: tuple[tuple[float, ...], ...]  #: Difference of both errors

    @cached_property
    def explained(self) -> tuple[float, float]:
        """Share of the errors beyond noise that the effect explains, and the effect's action.

        The action c/(c + e), with the effect's change c of errors and the remaining errors e,
        weights the share: an effect that changes much but explains little is wrong, whereas an
        effect that changes little is not tested.
        """
        left, without, change = (np.array(a) for a in (self.left, self.without, self.change))
        left = np.maximum(left - 1.0, 0.0)
        left = left + np.sqrt(2.0 / np.array(self.numbers))[:, None]
        gain = np.maximum(without - np.array(self.left), 0.0)
        act = change / (change + left)
        share = gain / (gain + left)
        return float((share * act).sum() / max(float(act.sum()), 1e-9)), float(act.mean())


@dataclass(frozen=True, kw_only=True)
class Member:
    """An effect of a set."""

    key: Key  #: Effect and element
    #: Probability that directions differ noticeably; 1 for a symmetric effect.
    differs: float
    fitted: Action  #: Influence in the windows of the search
    held_out: Action | None  #: In held-out windows; None without these, or if effects have onsets

    @property
    def share(self) -> float:
        """Share of the errors that the effect explains; less if held-out windows show less."""
        share, _ = self.fitted.explained
        if self.held_out is not None:
            explains, acts = self.held_out.explained
            share -= acts * max(share - explains, 0.0)
        return share


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A set of effects with its evidence."""

    keys: tuple[Key, ...]  #: Effects of the set, sorted
    ended: tuple[Key, ...]  #: Effects with a parameter that ended at a bound
    log: float  #: Log evidence [nats]
    fit: float  #: Log evidence without the prior odds of the set [nats]
    #: Log evidence without each part of the recordings, then without each recording [nats].
    apart: tuple[float, ...]
    drive: float  #: Change of log evidence by dividing errors by commanded motion [nats], <= 0
    numbers: int  #: Number of parameters
    #: Its effects' influence, if it is the most probable set of one of them; otherwise empty.
    members: tuple[Member, ...] = ()
    #: Whether the empty set's errors are noise or, with healthy recordings, as small as theirs.
    quiet: bool = False
    quiet_held_out: bool = False  #: Whether `quiet` also holds for held-out recordings

    @cached_property
    def names(self) -> frozenset[Key]:
        """Effects of the set."""
        return frozenset(self.keys)


@dataclass(frozen=True, kw_only=True)
class Table:
    """All sets of a search, most probable first, and quantities that are common to all."""

    sets: tuple[Entry, ...]
    level: float  #: Median error of the unchanged model, in noise levels
    #: Mean and standard deviation of the logit of the share of errors that an effect explains if
    #: another effect is the cause, see `leglab.diagnosis.verdict.tabulation.impostors`.
    impostor: tuple[float, float]
    #: Pairs of effects of which the first contains the second as a special case.
    contains: tuple[tuple[Key, Key], ...]
    #: Whether errors of the unchanged specimen are as small as in its healthy recordings; None
    #: without healthy recordings.
    as_it_was: bool | None = None

    @cached_property
    def effects(self) -> tuple[Key, ...]:
        """All effects of the sets."""
        return tuple(sorted({key for one in self.sets for key in one.keys}))

    def to_json(self) -> dict[str, Any]:
        """Returns the table as JSON holds it."""
        return asdict(self)

    @classmethod
    def from_json(cls, content: Any) -> "Table":
        """Returns the table of the content of a file.

        Raises:
            pydantic.ValidationError: It is no table.
        """
        return TypeAdapter(cls).validate_python(content)

    def write(self, path: Path) -> None:
        """Writes the table as JSON."""
        write_json(path, self.to_json(), indent=1, ascii_only=False)

    @classmethod
    def read(cls, path: Path) -> "Table":
        """Reads a table.

        Raises:
            FileError: The file cannot be read, or holds no table.
        """
        try:
            return cls.from_json(json.loads(path.read_text()))
        except (OSError, ValueError) as error:
            reason = str(error)
            if isinstance(error, ValidationError):
                first = error.errors()[0]
                reason = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
            text = f"{path} is no table of sets ({reason}); allowed: "
            allowed = "sets.json of `leglab diagnose --keep`"
            raise FileError(text, given=path, allowed=allowed) from error
