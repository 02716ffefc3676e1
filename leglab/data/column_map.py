"""A column map: how the columns of somebody else's recordings are called here, and their units."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from pydantic import Field, field_validator

from leglab.base.errors import LeglabError, RecordingError, SettingsError
from leglab.base.input import parse_toml, read_bytes
from leglab.base.settings import Configuration, validate_configuration
from leglab.data.files import LeftOut


class ColumnRule(Configuration):
    """Name and conversion of one measured column: ours = factor * theirs + offset."""

    name: str = Field(min_length=1, description="The column's name here, for instance 'time'.")
    factor: float = Field(1.0, description="Unit and sign: ours per theirs; not 0.")
    offset: float = Field(0.0, description="Added after the factor, in our unit.")

    @field_validator("factor")
    @classmethod
    def _is_not_zero(cls, factor: float) -> float:
        if factor == 0.0:
            raise ValueError("the factor must not be 0")
        return factor


class TextSettings(Configuration):
    """What cannot be known of a text, such as CSV; what is not given is found."""

    separator: str | None = Field(
        default=None, min_length=1, max_length=1, description="Between cells."
    )
    decimal: Literal[".", ","] | None = Field(default=None, description="Decimal sign.")
    encoding: str | None = Field(
        default=None, description="As Python names it, for instance 'latin-1'."
    )
    skip: int = Field(default=0, ge=0, description="Lines before the head.")


class _MapFile(TextSettings):
    columns: dict[str, Any] = Field(default_factory=dict)
    clock: str | None = None
    stamps: Literal["header", "log"] = "header"


@dataclass(frozen=True, kw_only=True)
class ColumnMap:
    """Names and units of a foreign recording."""

    #: Name and conversion of columns by name in the recording; other columns stay.
    rules: Mapping[str, ColumnRule] = field(default_factory=dict)
    source: str = "column map"  #: Where the map came from, for messages
    #: MCAP alone: the JointState topic whose stamps become the time axis. None: the only one, or
    #: `/joint_states`.
    clock: str | None = None
    #: MCAP alone: "header", where there are any, or "log" (time of reception) throughout.
    stamps: Literal["header", "log"] = "header"
    #: Text alone: how it is written, where that cannot be known.
    text: TextSettings = field(default_factory=TextSettings)

    def __post_init__(self) -> None:
        owners: dict[str, str] = {}
        for theirs, rule in self.rules.items():
            if rule.name in owners:
                raise SettingsError(
                    f"{self.source}: {owners[rule.name]!r} and {theirs!r} both become "
                    f"{rule.name!r}; allowed: one column for a name",
                    given=rule.name,
                )
            owners[rule.name] = theirs
        object.__setattr__(self, "rules", MappingProxyType(dict(self.rules)))

    @property
    def settings(self) -> dict[str, Any]:
        """What stands beside the columns in a file, where it is not as it is by default."""
        own = {"clock": self.clock} if self.clock is not None else {}
        own |= {"stamps": self.stamps} if self.stamps != "header" else {}
        return {**own, **self.text.model_dump(exclude_defaults=True)}

    def name_of(self, theirs: str) -> str:
        """Returns the name here of a column of the recording."""
        return self.rules[theirs].name if theirs in self.rules else theirs

    @property
    def time(self) -> tuple[str, ColumnRule] | None:
        """Name in the recording and rule of what becomes the time."""
        return next(((n, rule) for n, rule in self.rules.items() if rule.name == "time"), None)

    def apply(
        self, table: Mapping[str, np.ndarray], source: str, left_out: LeftOut
    ) -> dict[str, np.ndarray]:
        """Renames and converts.

        Args:
            table: Arrays of shape (n,) by column name, as measured.
            source: Where the table came from, for messages.
            left_out: Columns that could not be read; gets those by our names, and columns of the
                map that are not there.

        Returns:
            Arrays of shape (n,) by our names; columns without a rule are as they were.

        Raises:
            LeglabError: A column of the map is not in the table, or two columns get one name.
        """
        missing = [theirs for theirs in self.rules if theirs not in table]
        if left_out.partial:
            for theirs in missing:
                reasons = [why for name, why in left_out.items() if _owns(name, theirs)]
                absent = f"no column {theirs!r}, which {self.source} names"
                left_out[self.rules[theirs].name] = reasons[0] if reasons else absent
        elif missing:
            which = "none" if len(missing) == len(self.rules) else f"no {_list(missing)}"
            raise RecordingError(
                f"{source}: {which} of the columns of {self.source} is there: the map names "
                f"{_list(self.rules)}; the recording has {_list(table)}",
                given=missing[0],
                allowed=table,
            )
        mapped: dict[str, np.ndarray] = {}
        for theirs, samples in table.items():
            name = self.name_of(theirs)
            if name in mapped:
                why = (
                    f"{source}: after {self.source} two columns are called {name!r}, one of them "
                    f"{theirs!r}; allowed: give the other one a rule with another name"
                )
                left_out.add(name, RecordingError(why, given=theirs))
            rule = self.rules.get(theirs)
            # The time's factor counts where no digit is lost: in `time_axis`.
            if rule and name != "time" and (rule.factor, rule.offset) != (1.0, 0.0):
                with np.errstate(over="ignore"):  # A huge sample becomes infinite; `inspect` tells.
                    samples = rule.factor * samples + rule.offset
            mapped[name] = samples
        return {name: samples for name, samples in mapped.items() if name not in left_out}


def read_column_map(path: str | Path) -> ColumnMap:
    """Reads a column map from a TOML file.

    The table `columns` holds `their_name = "our_name"` or
    `their_name = {name = "our_name", factor = 0.0174533, offset = 0.0}`; beside it `clock`,
    `stamps` and the settings of `TextSettings` may stand, see `ColumnMap`.

    Raises:
        LeglabError: The file cannot be read, or an entry is not allowed; names file, key, value
            and what is allowed.
    """
    try:
        content = parse_toml(read_bytes(path))
    except ValueError as error:
        if isinstance(error, LeglabError):
            raise
        told = f"{path}: not a column map in TOML: {error}"
        raise SettingsError(told, given=path) from error
    file = validate_configuration(_MapFile, content, str(path))
    if not file.columns and not file.model_fields_set - {"columns"}:
        raise SettingsError(f"{path} needs the setting 'columns', with a column at least")
    rules = {}
    for theirs, rule in file.columns.items():
        if isinstance(rule, str):
            rule = {"name": rule}
        if not isinstance(rule, dict):
            raise SettingsError(
                f"{path}: column {theirs!r} is {rule!r}; allowed: ",
                given=rule,
                allowed=f'{theirs} = "our_name" or '
                f'{theirs} = {{name = "our_name", factor = ..., offset = ...}}',
            )
        rules[theirs] = validate_configuration(ColumnRule, rule, f"{path}: column {theirs!r}")
    text = TextSettings(**{name: getattr(file, name) for name in TextSettings.model_fields})
    clock, stamps = file.clock, file.stamps
    return ColumnMap(rules=rules, source=str(path), clock=clock, stamps=stamps, text=text)


def _owns(name: str, column: str) -> bool:
    """Whether a column is the named one or one of the named topic's."""
    return column == name or column.startswith((f"{name}[", f"{name}/"))


def _list(names: Mapping | list) -> str:
    return ", ".join(map(repr, names)) or "no column"
