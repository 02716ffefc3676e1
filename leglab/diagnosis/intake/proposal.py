"""Proposal of a column map for a foreign recording, by similarity of names and by values."""

import json
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from leglab.base.likeness import likeness_of_numbers, likeness_of_words, numbered, words_of
from leglab.data.column_map import ColumnMap, ColumnRule
from leglab.data.units_in_names import NamedUnit, split
from leglab.diagnosis.intake.units import fits, other_unit
from leglab.diagnosis.plant.columns import UsableColumn
from leglab.diagnosis.plant.model import CHAMBERS

# Kind of quantity by the words that loggers use for it.
_KINDS = {
    word: kind
    for kind, words in {
        "time": "time t stamp timestamp clock sec secs seconds",
        "position": "position positions pos q qpos angle angles ang theta phi enc encoder stroke "
        "displacement rotation",
        "velocity": "velocity velocities vel qd dq qvel qdot speed omega rate",
        "acceleration": "acceleration acc accel qdd ddq qacc",
        "command": "command commands cmd commanded ctrl control u action actions input pwm duty",
        "reference": "reference ref target targets setpoint sp desired des goal demand",
        "effort": "effort efforts torque tau force trq load current",
        "pressure": "pressure press p",
        "other": "kp kd ki gain error err temperature temp mode status index idx frame id "
        "limit max min std count enabled voltage",
    }.items()
    for word in words.split()
}
_KIND_OF_UNIT = {
    "s": "time", "rad": "position", "m": "position", "rad/s": "velocity", "m/s": "velocity",
    "rad/s^2": "acceleration", "N m": "effort", "N": "effort", "Pa": "pressure",
}  # fmt: skip
_CHAMBER_WORDS = {
    **dict.fromkeys(("a", "cap", "head", "bottom", "piston"), CHAMBERS[0]),
    **dict.fromkeys(("b", "rod", "ring", "top", "annulus"), CHAMBERS[1]),
}
# Words that occur in names of many elements or columns and therefore do not identify a joint.
_PLAIN = {
    "joint", "joints", "jnt", "motor", "axis", "actuator", "act", "servo", "drive", "valve",
    "cylinder", "cyl", "state", "states", "measured", "meas", "actual", "feedback", "fb", "value",
    "values", "data", "filtered", "sensor", "robot", "observation",
}  # fmt: skip
# Least similarity of names for a line of the map to be applied, and to be proposed as a guess.
_SURE, _NEAR = 0.6, 0.3
_TIME = UsableColumn("time", "", "time", "s")


@dataclass(frozen=True)
class Line:
    """One line of the map: a column of the recording, with its proposed name and factor."""

    theirs: str  #: Name of the column in the recording
    ours: str  #: Name of the model's column; "" if none is similar
    sure: bool  #: Whether the line is applied without confirmation
    factor: float = 1.0  #: The model's value per recorded value
    offset: float = 0.0  #: Added after multiplication by the factor
    why: str = ""  #: Reason for name and unit, and other similar columns

    def __str__(self) -> str:
        theirs, ours = (json.dumps(name, ensure_ascii=False) for name in (self.theirs, self.ours))
        factor = f", factor = {self.factor!r}" if self.factor != 1.0 else ""
        offset = f", offset = {self.offset!r}" if self.offset else ""
        rule = f"{{name = {ours}{factor}{offset}}}" if factor or offset else ours
        return "# " * (not self.sure) + f"{theirs} = {rule}" + f"  # {self.why}" * bool(self.why)


@dataclass(frozen=True)
class Proposal:
    """A proposed column map."""

    lines: tuple[Line, ...]  #: One per column of the recording
    missing: tuple[str, ...]  #: Needed columns that no line provides
    settings: Mapping[str, Any]  #: Settings of the column map on reading files
    doubt: str = ""  #: Reason why a diagnosis would refuse the recording

    @property
    def column_map(self) -> ColumnMap:
        """Column map of the lines that are sure."""
        sure = [o for o in self.lines if o.sure]
        rules = {o.theirs: ColumnRule(name=o.ours, factor=o.factor, offset=o.offset) for o in sure}
        return ColumnMap(rules=rules)

    def asked(self, column: str, factor: float, why: str) -> "Proposal":
        """Multiplies a column by a further factor; marks its line as doubtful, with the reason."""
        lines = list(self.lines)
        for k, one in enumerate(lines):
            if one.sure and one.ours == column:
                scaled = factor * one.factor, factor * one.offset
                lines[k] = Line(one.theirs, column, True, *scaled, f"? {why}")
        return replace(self, lines=tuple(lines))

    @property
    def doubtful(self) -> list[str]:
        """Lines that the user should check."""
        return [line for line in str(self).split("\n") if "# ? " in line]

    def to_json(self) -> dict[str, Any]:
        """Returns the map as JSON values."""
        lines = [asdict(line) for line in self.lines if line.ours]
        return {"columns": lines, "missing": list(self.missing), "doubt": self.doubt}

    def __str__(self) -> str:
        unused = ", ".join(json.dumps(line.theirs) for line in self.lines if not line.ours)
        said = ["# Proposed by leglab inspect. ?: to be checked. A line behind # is not applied."]
        said += ["# factor: ours per theirs."]
        said += [f"{name} = {json.dumps(value)}" for name, value in self.settings.items()]
        said += ["[columns]", *(str(line) for line in self.lines if line.ours)]
        said += [f"# ? no column for {name}" for name in self.missing]
        said += [f"# ? {self.doubt}"] * bool(self.doubt)
        return "\n".join(said + [f"# not used: {unused}"] * bool(unused))


def propose(
    table: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    wanted: Sequence[UsableColumn] = (),
    needed: Sequence[str] = (),
    given: ColumnMap | None = None,
) -> Proposal:
    """Proposes a column map: the assignment with the largest total similarity.

    Args:
        table: Arrays of shape (n,) by the recording's column names.
        units: Units according to the recording, by column.
        wanted: Columns of a model. If empty, names are made from the words of each column, or
            "JOINT" if it has no usable words.
        needed: Columns of the model that a diagnosis needs.
        given: A map that was applied already; it is kept, and lines for other columns are proposed.
    """
    given = given or ColumnMap()
    known = {r.name: Line(t, r.name, True, r.factor, r.offset) for t, r in given.rules.items()}
    table = {name: samples for name, samples in table.items() if name not in known}
    wanted = [one for one in wanted if one.name not in known]
    columns = [_Column(name, units.get(name, ""), wanted) for name in table]
    absent = ["time"] if "time" not in {*table, *known} else []
    lines = _assigned(columns, [*(_TIME for _ in absent), *wanted], table)
    if not wanted:
        lines = {c.name: lines[c.name] if lines[c.name].ours else c.alone() for c in columns}
    every = [*known.values(), *(line for name, line in lines.items() if name != "time")]
    sure = {line.ours for line in every if line.sure}
    missing = tuple(name for name in [*absent, *needed] if name not in sure)
    return Proposal(tuple(every), missing, given.settings.model_dump(exclude_defaults=True))


class _Column:
    """Words, unit and kind of quantity of a column, according to its name."""

    def __init__(self, name: str, unit: str, wanted: Sequence[UsableColumn]) -> None:
        self.name = name
        self.unit: NamedUnit = split(name)
        if unit and not self.unit.unit:
            self.unit = split(f"{name} [{unit}]")._replace(stem=name)
        ours = {word for one in wanted for word in words_of(one.element)}
        self.words = words_of(self.unit.stem, ours | set(_KINDS) | _PLAIN)
        #: Kinds of quantity that the column may have.
        self.kinds = {_KINDS[word] for word in self.words if word in _KINDS}
        if "position" in self.kinds and {"d", "dot"} & set(self.words):
            self.kinds = self.kinds - {"position"} | {"velocity"}
        if not self.kinds and self.unit.si in _KIND_OF_UNIT:
            self.kinds = {_KIND_OF_UNIT[self.unit.si]}
        if not self.kinds and "observation" in self.words:  # in a log with actions
            self.kinds = {"position"}
        #: Words that identify the element.
        self.rest = [word for word in self.words if word not in _KINDS or word in ours]

    def kind_likeness(self, one: UsableColumn) -> float:
        """Returns the similarity of the column's and a model column's kind of quantity, 0 to 1."""
        kinds, sent = self.kinds, self.kinds & {"command", "reference"}
        if "other" in kinds:
            return 0.0
        if "pressure" in kinds or one.kind in CHAMBERS:
            sides = {_CHAMBER_WORDS[word] for word in self.words if word in _CHAMBER_WORDS}
            return float("pressure" in kinds and sides == {one.kind})
        if one.kind != "command":
            # A column with only a joint's name is usually its position.
            bare = 0.8 if self.words == words_of(one.element) else 0.5
            return (kinds == {one.kind}) + bare * (not kinds and one.kind == "position")
        if not kinds:
            return 0.5
        likeness = 1.0 if "command" in sent else 0.8 if sent else 0.0
        if sent == {"reference"} and one.follows not in ("position", "velocity"):
            likeness = 0.4  # the setpoint of a controller outside the model
        if not sent and kinds == {"effort"} and one.follows == "effort":
            likeness = 0.5  # the force of a motor follows its command
        others = kinds & {"position", "velocity", "effort"}
        return likeness * (0.5 if others and one.follows not in others else 1.0)

    def alone(self) -> Line:
        """Returns a line named by the column's own words, for use without a model."""
        sent = self.kinds & {"command", "reference"}
        kind = "command" if sent else next(iter(self.kinds & {"position", "velocity"}), "")
        element = "_".join(w for w in self.rest if w not in _PLAIN) or "JOINT"
        name = f"{element}_{kind}" if kind else ""
        return Line(self.name, name, sure=bool(kind), factor=self.unit.factor)


def _assigned(
    columns: Sequence[_Column], wanted: Sequence[UsableColumn], table: Mapping[str, np.ndarray]
) -> dict[str, Line]:
    """Assigns model columns to recorded columns so that the sum of similarities is largest."""
    lines = {column.name: Line(column.name, "", sure=False) for column in columns}
    if not columns or not wanted:
        return lines
    scores = _likenesses(columns, wanted)
    rows = zip(*linear_sum_assignment(scores, maximize=True), strict=True)
    pairs = [(i, k) for i, k in rows if scores[i, k] >= _NEAR]
    taken = {k: scores[i, k] for i, k in pairs}
    units = _units([(wanted[i], columns[k]) for i, k in pairs], table)
    for i, k in pairs:
        name, score = columns[k].name, float(scores[i, k])
        # Columns that are nearly as similar to this model column, and fit no other one better.
        order = np.argsort(-scores[i], kind="stable").tolist()
        near = [j for j in order if j != k and scores[i, j] > max(0.8 * score, taken.get(j, 0.0))]
        tied = bool(near) and scores[i, near[0]] > score - 1e-9
        factor, why, known = units[name]
        alike = ", ".join(columns[j].name for j in near[:3])
        reasons = [why, f"as near: {alike}" * bool(near), f"likeness {score:.0%}" * (score < _SURE)]
        sure = score >= _SURE and factor != 0.0 and not tied
        why = "? " * (not (sure and known) or bool(near)) + "; ".join(filter(None, reasons))
        lines[name] = Line(name, wanted[i].name, sure, factor or 1.0, why=why)
    return lines


def _likenesses(columns: Sequence[_Column], wanted: Sequence[UsableColumn]) -> np.ndarray:
    """Returns similarities, (wanted, columns): 0 to 1 by kind and element, 2 if names are equal."""
    scores = np.array([[column.kind_likeness(one) for column in columns] for one in wanted])
    numbers = numbered(column.name for column in columns)
    for kind in {one.kind for one in wanted}:
        rows = [i for i, one in enumerate(wanted) if one.kind == kind]
        elements = [words_of(wanted[i].element) for i in rows]
        for k in np.flatnonzero(scores[rows].any(axis=0)).tolist():
            column = columns[k]
            own = likeness_of_words(column.rest, elements, _PLAIN | set(_KINDS))
            if own.max() < 0.5:
                own = likeness_of_numbers(*numbers.get(column.name, (0, ())), elements)
            if len(rows) == 1 and column.kinds and not own.any():  # there is no other element
                own[:] = 0.6 if set(column.rest) - _PLAIN else 0.7
            scores[rows, k] *= own
    same = [[2.0 * (one.name == column.name) for column in columns] for one in wanted]
    return np.maximum(scores, same)


def _units(
    pairs: Sequence[tuple[UsableColumn, _Column]], table: Mapping[str, np.ndarray]
) -> dict[str, tuple[float, str, bool]]:
    """Returns the factor to the model's unit (0 if unknown), reason and certainty, by column.

    The unit is taken from the column's name, or else guessed from the range of joint, command or
    supply pressure; in the second case all columns of a kind get one unit.
    """
    found = {column.name: (1.0, "", True) for _, column in pairs}
    groups: dict[str, list[tuple[UsableColumn, str, np.ndarray]]] = defaultdict(list)
    for one, column in pairs:
        unit, samples = column.unit, table[column.name][np.isfinite(table[column.name])]
        if unit.unit and unit.si != one.unit:
            found[column.name] = 0.0, f"in {unit.unit}, the model's is {one.unit}: factor?", False
        elif unit.unit:
            found[column.name] = unit.factor, f"{unit.unit}, by the name", True
        elif samples.size and np.isfinite(one.limits).all():
            kind = "pressure" if one.kind in CHAMBERS else f"{one.kind} {one.unit}"
            groups[kind].append((one, column.name, samples))
    for group in groups.values():
        guesses = [other_unit(samples, one) or ("", 1.0) for one, _, samples in group]
        # The most common factor is used: a wrong unit affects all columns, a narrow range only few.
        size = Counter(abs(factor) for _, factor in guesses).most_common(1)[0][0]
        usual = next(guess for guess in guesses if abs(guess[1]) == size)
        for (one, name, samples), guess in zip(group, guesses, strict=True):
            guessed, factor = guess if abs(guess[1]) == size else (usual[0], size)
            scaled = factor * samples
            allowed = f"[{one.limits[0]:.4g}, {one.limits[1]:.4g}] {one.unit}"
            why = f"{guessed}, by the range {allowed}" if guessed else ""
            if not fits(scaled, one):
                why = f"covers [{scaled.min():.4g}, {scaled.max():.4g}], allowed {allowed}: factor?"
            found[name] = factor, why, not why
    return found
