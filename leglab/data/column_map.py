"""Column maps: leglab's names and units for the columns of other programs' recordings."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, field_validator

from leglab.base.errors import RecordingError, SettingsError
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


class MapSettings(Configuration):
    """Settings for reading a recording; those that are not given are detected from the file."""

    #: MCAP: the JointState topic of the time axis; None: the only one, or `/joint_states`.
    clock: str | None = None
    #: MCAP: "header", where there are any, or "log" (time of reception) throughout.
    stamps: Literal["header", "log"] = "header"
    separator: str | None = Field(default=None, min_length=1, max_length=1)  #: Text: between cells
    decimal: Literal[".", ","] | None = None  #: Text: decimal sign
    encoding: str | None = None  #: Text: as Python names it, for instance "latin-1"
    skip: int = Field(default=0, ge=0)  #: Text: lines before the head


class _MapFile(MapSettings):
    columns: dict[str, Any] = Field(default_factory=dict, exclude=True)


@dataclass(frozen=True, kw_only=True)
class ColumnMap:
    """Names and units of a foreign recording."""

    #: Name and conversion of columns by name in the recording; other columns stay.
    rules: Mapping[str, ColumnRule] = field(default_factory=dict)
    source: str = "column map"  #: Where the map came from, for messages
    settings: MapSettings = field(default_factory=MapSettings)  #: How the recording is read

    def __post_init__(self) -> None:
        owners: dict[str, str] = {}
        for theirs, rule in self.rules.items():
            if (other := owners.setdefault(rule.name, theirs)) != theirs:
                text = (
                    f"{self.source}: {other!r} and {theirs!r} both become {rule.name!r}; allowed: "
                )
                raise SettingsError(text, given=rule.name, allowed="one column for a name")

    def name_of(self, theirs: str) -> str:
        """Returns leglab's name of a column of the recording."""
        return self.rules[theirs].name if theirs in self.rules else theirs

    @property
    def time(self) -> tuple[str, ColumnRule] | None:
        """Recorded name of the column that becomes `time`, and its conversion; None without one."""
        return next((item for item in self.rules.items() if item[1].name == "time"), None)

    def apply(
        self, table: Mapping[str, np.ndarray], source: str, left_out: LeftOut
    ) -> dict[str, np.ndarray]:
        """Renames and converts arrays of shape (n,); columns without a rule stay unchanged.

        Args:
            table: Measured columns by name.
            source: Origin of the table, for messages.
            left_out: Columns that could not be read; gets, by leglab's names, the columns of the
                map that are missing or duplicate.

        Raises:
            LeglabError: A column of the map is not in the table, or two columns get one name.
        """
        missing = [theirs for theirs in self.rules if theirs not in table]
        if left_out.partial:
            for theirs in missing:
                # Reasons for the column, or for the topic that it belongs to.
                reasons = (
                    why
                    for name, why in left_out.items()
                    if theirs == name or theirs.startswith((f"{name}[", f"{name}/"))
                )
                absent = f"no column {theirs!r}, which {self.source} names"
                left_out[self.rules[theirs].name] = next(reasons, absent)
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
                text = (
                    f"{source}: after {self.source} two columns are called {name!r}, one of them "
                )
                way = f"{theirs!r}; allowed: give the other one a rule with another name"
                left_out.add(name, RecordingError(text + way, given=theirs))
            rule = self.rules.get(theirs)
            # `time_axis` applies the time's factor, without losing digits.
            if rule and name != "time" and (rule.factor, rule.offset) != (1.0, 0.0):
                with np.errstate(over="ignore"):  # `inspect` reports samples that overflow.
                    samples = rule.factor * samples + rule.offset
            mapped[name] = samples
        return {name: samples for name, samples in mapped.items() if name not in left_out}


def read_column_map(path: str | Path) -> ColumnMap:
    """Reads a column map from a TOML file.

    The table `columns` holds `their_name = "our_name"` or
    `their_name = {name = "our_name", factor = 0.0174533, offset = 0.0}`; the file may also hold
    the settings of `MapSettings`.

    Raises:
        LeglabError: The file cannot be read, or an entry is not allowed; names file, key, value
            and what is allowed.
    """
    content = read_bytes(path)
    try:
        settings = parse_toml(content)
    except ValueError as error:
        text = f"{path}: not a column map in TOML: {error}"
        raise SettingsError(text, given=path) from error
    file = validate_configuration(_MapFile, settings, str(path))
    if not file.columns and not file.model_fields_set - {"columns"}:
        raise SettingsError(f"{path} needs the setting 'columns', with a column at least")
    rules = {}
    for theirs, rule in file.columns.items():
        if not isinstance(rule, (dict, str)):
            text = f"{path}: column {theirs!r} is {rule!r}; allowed: "
            ways = ('"our_name"', '{name = "our_name", factor = ..., offset = ...}')
            allowed = " or ".join(f"{theirs} = {way}" for way in ways)
            raise SettingsError(text, given=rule, allowed=allowed)
        rule = {"name": rule} if isinstance(rule, str) else rule
        rules[theirs] = validate_configuration(ColumnRule, rule, f"{path}: column {theirs!r}")
    return ColumnMap(rules=rules, source=str(path), settings=file)


def _list(names: Mapping | list) -> str:
    return ", ".join(map(repr, names)) or "no column"
