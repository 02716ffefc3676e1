"""Plan of a sweep: blocks of runs from a TOML file, as grids and sampled points."""

import hashlib
import json
import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from leglab.base.errors import FileError, LeglabError, SettingsError
from leglab.base.input import read_bytes, read_json
from leglab.base.settings import Configuration, validate_configuration
from leglab.control.contract import CONTROLLERS
from leglab.machine.changes import check_tolerance
from leglab.machine.parameters import placed_parameters
from leglab.references.base import REFERENCES
from leglab.runs.loop import Loop
from leglab.runs.preparation import Preparation, RunSettings, reference_config, scenario_of
from leglab.runs.run_settings import NAMES, check_type, read_toml
from leglab.runs.sweeps.outcome import FIGURES

# Maximum number of runs of a sweep; the process that stores the rows tracks all of them in memory.
MOST_RUNS = 10_000_000
_MOST_FILE = 10_000_000  # maximum size of the file of a sweep [bytes]
# Settings that are a table of names and values.
MAPPINGS: tuple[str, ...] = ("controller_config", "reference_config", "sensors", "parameters")
_COUNT, _RANGE = {"first", "count"}, {"low", "high", "log"}


class Range(Configuration):
    """Between which values points are drawn.

    Attributes:
        low: Lowest value.
        high: Highest value.
        log: Whether logarithms are drawn evenly.
    """

    low: float
    high: float
    log: bool = False


class Count(Configuration):
    """Whole numbers that follow each other.

    Attributes:
        first: The first one.
        count: How many.
    """

    first: int = 0
    count: Annotated[int, Field(ge=1, le=MOST_RUNS)]


class Tune(Configuration):
    """Objective for the proposed points of a block.

    Attributes:
        metric: Column of the dataset, a number.
        aim: Whether it is to be low or high.
        over: Whether its mean over the runs of the grid counts, or the worst of them.
        together: Points that are proposed at a time: more of them keep more processes busy, and
            know less of each other.
    """

    metric: str
    aim: Literal["lowest", "highest"] = "lowest"
    over: Literal["mean", "worst"] = "mean"
    together: Annotated[int, Field(ge=1, le=1000)] = 1


class Block(Configuration):
    """Runs that are varied together: every drawn point in every combination of the grid.

    Attributes:
        settings: What its runs share, over the settings of the whole plan.
        grid: Lists of values by setting; every combination is run.
        ranges: Ranges by setting, from which points are drawn.
        draw: How: `sobol` (scrambled, Owen 1998, by `scipy.stats.qmc`) or `random`; or proposed by
            Optuna after the runs of those before: `tpe` (tree-structured Parzen estimator) or
            `gp` (Gaussian process).
        points: How many; needed where there are ranges. Of proposed ones the first is the block
            without values of the ranges.
        draw_seed: Seed of the points.
        tune: What proposed points are to bring about.
    """

    settings: dict[str, Any] = Field(default_factory=dict)
    grid: dict[str, Any] = Field(default_factory=dict)
    ranges: dict[str, Any] = Field(default_factory=dict)
    draw: Literal["sobol", "random", "tpe", "gp"] = "sobol"
    points: Annotated[int, Field(ge=1, le=MOST_RUNS)] | None = None
    draw_seed: Annotated[int, Field(ge=0)] = 0
    tune: Tune | None = None


class PlanFile(Configuration):
    """Content of the file of a sweep.

    Attributes:
        settings: What all runs share, by the names of `RunSettings`.
        block: Blocks of runs.
        keep: What is kept beside a row a run: `metrics` (all of `metrics.json`, as text), `traces`
            (the windowed errors), `recordings` (the folder of each run).
        timeout: Wall time that a run may take [s].
        memory: Memory that the process of a run may take [MB]; None for its share of this machine.
    """

    settings: dict[str, Any] = Field(default_factory=dict)
    block: Annotated[list[Block], Field(min_length=1)]
    keep: list[Literal["metrics", "traces", "recordings"]] = Field(default_factory=list)
    timeout: Annotated[float, Field(gt=0)] = 3600.0
    memory: Annotated[float, Field(ge=500)] | None = None


@dataclass(frozen=True, kw_only=True)
class Runs:
    """The consecutive runs of one block: each combination of grid values with each point."""

    block: Block  #: The block
    number: int  #: Number of the block, from 0
    first: int  #: Number of its first run
    settings: Mapping[str, Any]  #: Settings of all runs of the block, by dotted name
    grid: Mapping[str, Sequence[Any]]  #: Values by setting; all combinations are run
    ranges: Mapping[str, Range]  #: Ranges from which points are drawn or proposed
    #: Proposed points of a tuned block: values of the ranges by number of the point, from 1.
    proposals: dict[int, dict[str, float]] = field(default_factory=dict)

    @property
    def points(self) -> int:
        """Number of points, each a value for every range."""
        return self.block.points or 1

    @property
    def tune(self) -> Tune:
        """Objective of a tuned block."""
        assert self.block.tune is not None
        return self.block.tune

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each grid setting, followed by the number of points."""
        return (*map(len, self.grid.values()), self.points)

    def __len__(self) -> int:
        return math.prod(self.shape)

    def runs(self, point: int) -> range:
        """Returns the numbers of the runs of a point."""
        return range(self.first + point, self.first + len(self), self.points)

    @cached_property
    def drawn(self) -> np.ndarray:
        """Values of the ranges, (points, ranges)."""
        size = len(self.ranges)
        if not size:
            return np.empty((self.points, 0))
        if self.block.draw == "sobol":
            from scipy.stats import qmc  # imported late: half a second, for Sobol points only

            engine = qmc.Sobol(size, scramble=True, seed=self.block.draw_seed)
            # Sobol sequences are balanced for powers of two; the first `points` are used.
            unit = engine.random_base2((self.points - 1).bit_length())[: self.points]
        else:
            unit = np.random.default_rng(self.block.draw_seed).random((self.points, size))
        low = np.array([_scale(r.low, r) for r in self.ranges.values()])
        high = np.array([_scale(r.high, r) for r in self.ranges.values()])
        logs = [r.log for r in self.ranges.values()]
        values = low + unit * (high - low)
        values[:, logs] = np.exp(values[:, logs])
        return values

    def values(self, number: int, *, ends: bool = False) -> dict[str, Any] | None:
        """Returns the settings of a run by dotted name; None if its point is not proposed yet.

        Args:
            number: Number of the run.
            ends: Whether points 1 and 2 of a tuned block are the low and high ends of its ranges.
        """
        *places, point = map(int, np.unravel_index(number - self.first, self.shape))
        chosen = {
            name: values[i] for (name, values), i in zip(self.grid.items(), places, strict=True)
        }
        if self.block.tune is None:
            drawn = dict(zip(self.ranges, self.drawn[point].tolist(), strict=True))
        elif ends and point in (1, 2):
            drawn = {n: r.low if point == 1 else r.high for n, r in self.ranges.items()}
        elif point == 0 or point in self.proposals:
            drawn = self.proposals.get(point, {})
        else:
            return None
        return {**self.settings, **chosen, **drawn}


def _scale(value: float, range_: Range) -> float:
    return math.log(value) if range_.log else value


class SweepPlan:
    """All runs of a sweep, numbered from 0; the settings of a run are computed on demand.

    Args:
        content: Content of the file.
        name: Name of the file in messages.

    Attributes:
        keep: Optional parts that are stored in addition to the rows.
        timeout: Maximum wall time of a run [s].
        memory: Maximum memory of a run's process [MB]; None for its share of the machine.
        tuned: Runs of the tuned blocks.

    Raises:
        LeglabError: The content is not allowed; names file, key, value and what is allowed.
    """

    def __init__(self, content: Mapping[str, Any], name: str = "sweep") -> None:
        self._name = name
        found = validate_configuration(PlanFile, content, name)
        self.keep = tuple(sorted(set(found.keep)))
        self.timeout, self.memory = found.timeout, found.memory
        shared = _checked(found.settings, f"{name}: settings")
        self._blocks: list[Runs] = []
        for i, block in enumerate(found.block):
            parts = _parts(block, shared, f"{name}: block {i + 1}")
            self._blocks.append(Runs(block=block, number=i, first=len(self), **parts))
        self.tuned = [runs for runs in self._blocks if runs.block.tune is not None]
        if len(self) > MOST_RUNS:
            text = f"{name}: asks for {len(self):,} runs; allowed: "
            raise SettingsError(text, given=len(self), allowed=f"at most {MOST_RUNS:,}")
        self._content = found

    def __len__(self) -> int:
        return self._blocks[-1].first + len(self._blocks[-1]) if self._blocks else 0

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Dotted names of the settings in which runs differ."""
        names = dict.fromkeys(
            name for block in self._blocks for name in (*block.grid, *block.ranges)
        )
        # A shared setting that differs between blocks also distinguishes runs.
        shared = [block.settings for block in self._blocks]
        for name in dict.fromkeys(name for settings in shared for name in settings):
            if any(settings.get(name) != shared[0].get(name) for settings in shared):
                names.setdefault(name)
        return tuple(names)

    def values_of(self, axis: str) -> list[Any]:
        """Returns example values of a setting, from each block of the plan that contains it."""
        found: list[Any] = []
        for block in self._blocks:
            if axis in block.ranges:
                found.append(block.ranges[axis].low)
            elif axis in block.grid:
                found += block.grid[axis]
            elif axis in block.settings:
                found.append(block.settings[axis])
        return found

    @cached_property
    def digest(self) -> str:
        """Digest of all that determines the runs and their rows, without time-out and memory."""
        content = self._content.model_dump(exclude={"timeout", "memory"})
        content["keep"] = self.keep
        for block in content["block"]:
            if block["tune"] is None:  # Keeps the digest of plans from before `tune` existed.
                del block["tune"]
        text = json.dumps(content, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def content(self) -> dict[str, Any]:
        """Content of the file, JSON-serialisable."""
        return self._content.model_dump(mode="json", exclude_unset=True)

    def values(self, number: int) -> dict[str, Any]:
        """Returns those settings of a run that the file sets, by dotted name.

        Raises:
            LeglabError: The point of the run is not proposed yet.
        """
        found = self._block(number).values(number)
        if found is None:
            text = f"{self._name}: run {number}: its settings are not proposed yet"
            raise SettingsError(text, given=number)
        return found

    def _block(self, number: int) -> Runs:
        """Returns the block that contains a run."""
        return self._blocks[bisect_right(self._blocks, number, key=lambda runs: runs.first) - 1]

    def is_known(self, number: int) -> bool:
        """Tests whether the settings of a run are known, not still to be proposed."""
        return not self.tuned or self._block(number).values(number) is not None

    def point(self, number: int) -> int | None:
        """Returns the number of a run's point in a tuned block; None for other blocks."""
        runs = self._block(number)
        return (number - runs.first) % runs.points if runs.block.tune else None

    def settings(self, number: int) -> RunSettings:
        """Returns the settings of a run."""
        return self._settings(self.values(number))

    def _settings(self, given: Mapping[str, Any]) -> RunSettings:
        plain = {k: v for k, v in given.items() if k in NAMES}
        for name, value in given.items():
            owner, _, key = name.partition(".")
            if key:
                plain[owner] = {**plain.get(owner, {}), key: value}
        return RunSettings(**plain)

    def check(self, progress: Callable[[int, int, str], None] | None = None) -> dict[str, str]:
        """Tests that all runs can be set up, before any run is made.

        Names, magnitudes and settings of every run are checked; a closed loop without controller
        is set up for each kind of run (model, scenario, element, reference). Errors that depend on
        the numbers of a run, such as a specimen that cannot hold its joint, are raised later.

        Args:
            progress: Called periodically with 0, the number of runs, and a status text.

        Returns:
            Digests of the models by name.

        Raises:
            LeglabError: A run is not valid; names the run, the setting and what is allowed.
        """
        models: dict[str, str] = {}
        checks = _Checks()
        for number in range(len(self)):
            if progress and number % 1000 == 0:
                progress(0, len(self), f"checking, {number:,} of {len(self):,}")
            given = self._block(number).values(number, ends=True)
            if given is None:
                continue
            settings = self._settings(given)
            try:
                files = checks(settings).files
            except LeglabError as error:
                raise error.at(f"{self._name}: run {number} ({self._told(given)})") from error
            if settings.model not in models:
                models[settings.model] = files.digest if files else ""
        return models

    def _told(self, given: Mapping[str, Any]) -> str:
        """Returns the settings in which a run differs from the others, in one line."""
        shown = {name: given[name] for name in self.axes if name in given}
        parts = (f"{n} {v:g}" if isinstance(v, float) else f"{n} {v}" for n, v in shown.items())
        return ", ".join(parts) or "the only one"

    def __iter__(self) -> Iterator[RunSettings]:
        return map(self.settings, range(len(self)))


def check_run(settings: RunSettings) -> None:
    """Tests that a run can be set up.

    Raises:
        LeglabError: A setting is not valid; the message names it and what is allowed.
    """
    _Checks()(settings)


class _Checks:
    """Checks of run settings, each part of which is checked only once."""

    def __init__(self) -> None:
        self._preparations: dict[Any, Preparation] = {}
        self._seen: set[Any] = set()

    def __call__(self, settings: RunSettings) -> Preparation:
        scenario = scenario_of(settings)
        check_tolerance(settings.tolerance)
        self._once(
            ("controller", settings.controller, _key(settings.controller_config)),
            lambda: CONTROLLERS.configured(settings.controller, settings.controller_config),
        )
        reference = settings.reference or scenario.reference
        config = reference_config(settings, scenario)
        self._once(
            ("reference", reference, _key(config)), lambda: REFERENCES.configured(reference, config)
        )
        # The key omits `parameters`, which `placed_parameters` checks and nothing here depends on.
        machine = (settings.model, settings.timestep, _key(settings.sensors))
        if machine not in self._preparations:
            plain = replace(settings, parameters={}, tolerance=0.0)
            self._preparations[machine] = Preparation(plain)
        preparation = self._preparations[machine]
        placed_parameters(settings.parameters, preparation.nominal.elements)
        kind = (machine, settings.scenario, settings.element, reference, settings.ramp_duration > 0)
        self._once(
            ("loop", kind),
            lambda: Loop(
                replace(settings, parameters={}, tolerance=0.0),
                preparation=preparation,
                scenario=scenario,
                controlled=False,
            ),
        )
        return preparation

    def _once(self, key: Any, check: Callable[[], object]) -> None:
        if key not in self._seen:
            check()
            self._seen.add(key)


def _key(settings: Mapping[str, Any]) -> str:
    return json.dumps(settings, sort_keys=True, default=str)


def read_plan(path: str | Path) -> SweepPlan:
    """Reads the file of a sweep.

    Args:
        path: A TOML file, or the `sweep.json` of a sweep, which holds the same content.

    Raises:
        LeglabError: The file cannot be read, is not TOML, or has an entry that is not allowed; the
            message is one line with file, key, value and what is allowed.
    """
    path = Path(path)
    if len(read_bytes(path, _MOST_FILE + 1)) > _MOST_FILE:
        raise FileError(f"{path}: has more than {_MOST_FILE:,} bytes", given=path)
    if path.suffix == ".json":
        kept = read_json(path)
        if not isinstance(kept, dict) or not isinstance(kept.get("plan"), dict):
            raise FileError(f"{path}: holds no plan of a sweep", given=path)
        return SweepPlan(kept["plan"], str(path))
    return SweepPlan(read_toml(path), str(path))


def _parts(block: Block, shared: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Checks a block; returns `settings`, `grid` and `ranges` of its runs."""
    settings = {**shared, **_checked(block.settings, f"{where}: settings")}
    grid = {
        name: _list(name, value, f"{where}: grid")
        for name, value in _flat(block.grid, f"{where}: grid", leaf=_COUNT).items()
    }
    ranges = {
        name: _range(name, value, f"{where}: ranges")
        for name, value in _flat(block.ranges, f"{where}: ranges", leaf=_RANGE).items()
    }
    for name in ranges:
        if name in grid:
            raise SettingsError(f"{where}: {name!r} stands in grid and in ranges", given=name)
    if ranges and block.points is None:
        raise SettingsError(f"{where}: ranges need 'points', the number of points to draw")
    if block.points is not None and not ranges:
        text = f"{where}: points is {block.points}, but there are no ranges"
        raise SettingsError(text, given=block.points)
    proposed = block.draw in ("tpe", "gp")
    if proposed and (block.tune is None or not ranges):
        text = f"{where}: draw is {block.draw!r}: needs ranges and tune.metric"
        raise SettingsError(text, given=block.draw)
    if block.tune is not None:
        if not proposed:
            text = f"{where}: tune needs draw = 'tpe' or 'gp', not {block.draw!r}"
            raise SettingsError(text, given=block.draw, allowed=("tpe", "gp"))
        if block.tune.metric not in FIGURES:
            error = SettingsError.unknown("number", block.tune.metric, FIGURES)
            raise error.at(f"{where}: tune")
    if "scenario" not in {*settings, *grid}:
        text = f"{where}: needs 'scenario', in settings or grid"
        raise SettingsError(text, allowed=("scenario",))
    return {"settings": settings, "grid": grid, "ranges": ranges}


def _checked(table: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Returns settings by dotted name after checking the types of their values."""
    found = _flat(table, where)
    for name, value in found.items():
        _check_value(name, value, f"{where}.{name}")
    return found


def _flat(
    table: Mapping[str, Any], where: str, *, leaf: set[str] | None = None, prefix: str = ""
) -> dict[str, Any]:
    """Flattens settings to dotted names; entries of tables become TABLE.NAME."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        full = f"{prefix}{name}"
        owner, _, key = full.partition(".")
        if owner not in NAMES or (key and owner not in MAPPINGS):
            raise SettingsError.unknown("setting of a run", full, NAMES).at(where)
        is_leaf = not isinstance(value, dict) or (leaf is not None and {*value} <= leaf and value)
        if is_leaf and (key or owner not in MAPPINGS):
            found[full] = value
        elif isinstance(value, dict) and owner in MAPPINGS:
            found |= _flat(value, where, leaf=leaf, prefix=f"{full}.")
        else:
            allowed = "a value or a list of values"
            allowed = f"a table, or {owner}.NAME" if owner in MAPPINGS else allowed
            text = f"{where}: {full} is {value!r}; allowed: "
            raise SettingsError(text, given=value, allowed=allowed)
    return found


def _list(name: str, value: Any, where: str) -> Sequence[Any]:
    place = f"{where}.{name}"
    if isinstance(value, dict):
        count = validate_configuration(Count, value, place)
        value = list(range(count.first, count.first + count.count))
    if not isinstance(value, list) or not value:
        allowed = "a list of one or more values, or { first = 0, count = 10 }"
        raise SettingsError(f"{place} is {value!r}; allowed: ", given=value, allowed=allowed)
    seen: set[str] = set()
    for i, item in enumerate(value):
        if (key := json.dumps(item, default=str)) in seen:
            raise SettingsError(f"{place}: {item!r} is given twice", given=item)
        seen.add(key)
        _check_value(name, item, f"{place}[{i}]")
    return value


def _range(name: str, value: Any, where: str) -> Range:
    place = f"{where}.{name}"
    if isinstance(value, list) and len(value) == 2:
        value = {"low": value[0], "high": value[1]}
    if not isinstance(value, dict):
        allowed = "[low, high] or { low = 1, high = 10, log = true }"
        raise SettingsError(f"{place} is {value!r}; allowed: ", given=value, allowed=allowed)
    found = validate_configuration(Range, value, place)
    if not found.low < found.high:
        text = f"{place}: low {found.low:g} is not "
        raise SettingsError(text, given=found.low, allowed=f"below high {found.high:g}")
    if found.log and found.low <= 0:
        text = f"{place}: low is {found.low:g}; with log = true allowed: "
        raise SettingsError(text, given=found.low, allowed="more than 0")
    for end in (found.low, found.high):
        _check_value(name, end, place)
    return found


def _check_value(name: str, value: Any, place: str) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        text = f"{place} is {value!r}; allowed: "
        raise SettingsError(text, given=value, allowed="a finite number")
    if name in NAMES:  # A setting in a table is checked by the settings class of its owner.
        check_type(name, value, place)
