"""Recordings as MATLAB files, version 5 (what `save` writes as `-v6` and `-v7`), through scipy.

Fields of a file: docs/reference/data_formats.md.
"""

import io
import json
import pickle
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from leglab.base.errors import FileError, LeglabError, RecordingError
from leglab.base.input import parse_json, read_bytes
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.base.units import own_units, unit_of, usual_unit
from leglab.data.clock import Timed
from leglab.data.column_map import ColumnMap
from leglab.data.files import LeftOut, to_json
from leglab.data.variables import check_lengths, table_of

_VARIABLE = "recording"
_NAME_LENGTH = 63  # MATLAB's namelengthmax until R2025.
_KEYWORDS = frozenset(
    {"break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function"}
    | {"global", "if", "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try"}
    | {"while"}
)
# Replaces scipy's header, which has the time of day, so that equal recordings give equal bytes.
_HEADER = b"MATLAB 5.0 MAT-file, written by leglab".ljust(116)
_HDF5 = b"\x89HDF\r\n\x1a\n"

# scipy's compiled reader trusts the counts in a file, so a broken file can crash the process or use
# up its memory. So it runs in a separate process with limited memory [bytes]: `_ROOM`, for two
# variables of the largest size, plus `_RATIO` times the file's size, which may be compressed.
_READER = """
import os, pickle, sys, warnings
os.environ["OPENBLAS_NUM_THREADS"] = "1"
from scipy.io import loadmat
try:
    import resource
    room = int(sys.argv[2])
    resource.setrlimit(resource.RLIMIT_AS, (room, room))
except ImportError:
    pass  # Windows
warnings.simplefilter("ignore")  # Doubled variables: the last one counts.
found = loadmat(sys.argv[1], appendmat=False, simplify_cells=True)
pickle.dump(found, sys.stdout.buffer, protocol=5)
"""
_ROOM, _RATIO = 2**32, 20
_PATIENCE = 60.0  # time limit of reading [s], 100 times the usual time; plus a second per MB

# MATLAB commands that convert objects to readable types; {0} is the variable.
_DATASET = (
    "for k = 1:{0}.numElements, e = {0}{{k}}; s.(matlab.lang.makeValidName(e.Name)) = "
    "struct('time', e.Values.Time, 'data', e.Values.Data); end"
)
_WAYS_OUT = {
    "timeseries": "s.{0} = struct('time', {0}.Time, 'data', {0}.Data)",
    "table": "s = table2struct({0}, 'ToScalar', true)",
    "timetable": "s = table2struct(timetable2table({0}), 'ToScalar', true)",
    "Simulink.SimulationData.Dataset": _DATASET,
    "Simulink.SimulationOutput": "{0} = {0}.logsout; " + _DATASET,
}


def read_table(
    path: Path, left_out: LeftOut, columns: ColumnMap | None = None
) -> tuple[dict[str, np.ndarray], dict]:
    """Reads leglab's file, or the variables of any other file (`leglab.data.variables`).

    The metadata list units other than the usual ones under "units", and variables that are no
    samples under "left_out".

    Raises:
        LeglabError: The file is of version 7.3, truncated or broken, or lengths differ.
    """
    variables = _load(path)
    ours = variables.get(_VARIABLE)
    if isinstance(ours, dict) and {"time", "signals", "name_map"} <= ours.keys():
        return _own_table(ours, left_out)
    return table_of(variables, left_out, columns)


def write(recording: Recording, path: Path) -> None:
    """Writes a recording with its metadata and units; every sample keeps all bits.

    Raises:
        LeglabError: The folder cannot be written to, or the recording is too large (2 GB a column).
    """
    from scipy.io import savemat

    fields = field_names(recording.columns)
    metadata = dict(recording.metadata)
    content = {
        "time": recording.time,
        "signals": {field: recording[name] for name, field in fields.items()},
        "units": {field: unit_of(name, metadata) for name, field in fields.items()},
        "name_map": json.dumps({field: name for name, field in fields.items()}),
        "metadata": to_json(metadata),
    }
    stream = io.BytesIO()
    try:
        options = {"long_field_names": True, "do_compression": True, "oned_as": "column"}
        savemat(stream, {_VARIABLE: content}, **options)
    except ValueError as error:  # scipy's MatWriteError among them.
        text = f"{path}: does not fit into a MATLAB file: {error}"
        raise FileError(text, given=path) from error
    written = _HEADER + stream.getvalue()[len(_HEADER) :]
    write_atomically(path, lambda file: file.write(written))


def field_names(names: Iterable[str]) -> dict[str, str]:
    """Returns unique field names that MATLAB allows, by column name."""
    names = list(names)
    fields: dict[str, str] = {}
    # Names that need no change come first, so that no changed name takes them.
    for name in sorted(names, key=lambda name: _allowed(name) != name):
        ends = ("", *(f"_{count}" for count in range(2, len(names) + 1)))
        free = (_allowed(name)[: _NAME_LENGTH - len(end)] + end for end in ends)
        fields[name] = next(field for field in free if field not in fields.values())
    return {name: fields[name] for name in names}


def _allowed(name: str) -> str:
    field = re.sub(r"[^A-Za-z0-9_]", "_", name)
    if not field[0].isalpha() or field in _KEYWORDS:
        field = f"x_{field}"
    return field[:_NAME_LENGTH]


def _load(path: Path) -> dict[str, Any]:
    content = read_bytes(path)
    if content.startswith((b"MATLAB 7.3", _HDF5)) or content[512:520] == _HDF5:
        text = f"{path}: a MATLAB file of version 7.3 (HDF5), allowed is version 5; in MATLAB: "
        raise FileError(f"{text}save('{path.name}', ..., '-v7')", given="version 7.3")
    if content[126:128] not in (b"IM", b"MI"):
        text = f"{path}: not a MATLAB file: the first 128 bytes are not those of version 5"
        raise FileError(text, given=path)
    room = _ROOM + _RATIO * len(content)
    command = [sys.executable, "-c", _READER, str(path), str(room)]
    try:
        patience = _PATIENCE + 1e-6 * len(content)
        ended = subprocess.run(command, capture_output=True, timeout=patience, check=False)
        found = pickle.loads(ended.stdout) if ended.returncode == 0 else None
    except subprocess.TimeoutExpired as error:
        raise FileError(f"{path}: not a MATLAB file: reading it does not end") from error
    if found is None:
        why = ended.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        text = f"{path}: not a complete MATLAB file: {why or 'it stops the reader'}"
        raise FileError(text, given=path)
    for value in found.values():
        if type(value).__name__ == "MatlabOpaque":  # an object: its name, system and class
            name, kind = (value[part].item().decode() for part in ("s0", "s2"))
            way = _WAYS_OUT.get(kind, _WAYS_OUT["timeseries"]).format(name)
            text = f"{path}: variable {name!r} is a {kind}, which MATLAB alone reads; in MATLAB: "
            raise FileError(f"{text}{way}; save('log.mat', '-struct', 's', '-v7')", given=path)
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _own_table(content: Mapping[str, Any], left_out: LeftOut) -> tuple[dict[str, np.ndarray], dict]:
    names: dict[str, str] = _json(content, "name_map")
    metadata = _json(content, "metadata") if "metadata" in content else {}
    if not all(isinstance(name, str) for name in names.values()):
        raise FileError("field 'name_map' of 'recording' gives a name that is no text")
    signals = content["signals"] if names else {}
    units: Any = content.get("units") if names else {}
    if missing := names.keys() - signals.keys():
        field = min(missing)
        raise FileError(f"field {field!r} of 'name_map' is missing in 'signals'", given=field)
    table = {"time": _vector(content["time"], "time")}
    # Columns added in MATLAB are not in the name map, so their field is used as their name.
    for field in dict.fromkeys((*names, *signals)):
        name = names.get(field, field)
        if name in table:
            text = f"'signals' and 'name_map' of 'recording' give {name!r} twice"
            raise FileError(text, given=name)
        try:
            table[name] = _vector(signals[field], name)
        except LeglabError as error:
            left_out.add(name, error)
    check_lengths(table, left_out)
    if isinstance(units, dict):
        known = own_units(metadata)
        given = {str(names.get(f, f)): unit for f, unit in units.items()}
        usual = {n: ("", known.get(n, usual_unit(n))) for n in given}
        changed = {n: u for n, u in given.items() if isinstance(u, str) and u not in usual[n]}
        metadata |= {"units": {**known, **changed}} if changed else {}
    return Timed(table), metadata


def _vector(value: Any, name: str) -> np.ndarray:
    array = np.asarray(value)
    if array.dtype.kind not in "fiub" or array.ndim > 1:
        found = f"{' x '.join(map(str, array.shape))} array of {array.dtype}"
        text = f"column {name!r} is a {found}, allowed is "
        raise RecordingError(text, given=name, allowed="a real vector")
    return np.atleast_1d(array).astype(np.float64)


def _json(content: Mapping[str, Any], field: str) -> dict[str, Any]:
    found = parse_json(content[field])
    if not isinstance(found, dict):
        raise FileError(f"field {field!r} of 'recording' is not a JSON object", given=field)
    return found
