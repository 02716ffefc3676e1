"""Files of identifiers: settings, parameters and state, from which they resume bit-exactly.

Layout: the line `leglab-identifier VERSION`, one line of JSON (model, joints, settings, size and
SHA-256 of the state), then the memory image of the core's state.
"""

import dataclasses
import hashlib
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from leglab._native import identification as native
from leglab.base.errors import FileError, LeglabError
from leglab.base.input import parse_json, read_bytes
from leglab.base.output import write_atomically
from leglab.identification import checks
from leglab.identification.bsnn_arx import BsnnArx
from leglab.identification.checks import Settings
from leglab.identification.front import Identifier
from leglab.identification.spline_narx import SplineNarx
from leglab.identification.spline_state_space import SplineStateSpace

VERSION = 1
MAGIC = b"leglab-identifier"
_MODELS: dict[str, type[Identifier]] = {
    model.__name__: model for model in (BsnnArx, SplineNarx, SplineStateSpace)
}
# Exceptions that settings of wrong types raise in Python and in the core.
_MALFORMED = (
    ArithmeticError,
    AttributeError,
    LookupError,
    MemoryError,
    RecursionError,
    RuntimeError,
    TypeError,
    ValueError,
)


def _kinds(base: type[Settings]) -> Iterator[type[Settings]]:
    for part in base.__subclasses__():
        yield part
        yield from _kinds(part)


_PARTS: dict[str, Any] = {part.__name__: part for part in _kinds(Settings)}


def save(identifier: Identifier, path: str | Path) -> None:
    """Writes the identifier to `path` atomically: an interrupted write leaves the old file.

    Raises:
        FileError: The file cannot be written.
    """
    state = identifier._bank.state()
    header = {
        "model": type(identifier).__name__,
        "joints": identifier.joints,
        "settings": encode(identifier.settings),
        "state_version": native.STATE_VERSION,
        "byte_order": sys.byteorder,
        "size": len(state),
        "sha256": hashlib.sha256(state).hexdigest(),
    }

    def write(stream: BinaryIO) -> None:
        stream.write(MAGIC + b" %d\n" % VERSION)
        stream.write(json.dumps(header).encode() + b"\n")
        stream.write(state)
        stream.flush()
        os.fsync(stream.fileno())

    write_atomically(path, write)


def load(path: str | Path) -> Identifier:
    """Builds the identifier that `save` wrote, in exactly the saved state.

    The file may come from an untrusted source: contents that no identifier can have are refused.

    Raises:
        FileError: The file is missing, truncated, damaged or of another version.
    """
    header, state = _read(Path(path))
    model = _build(path, header, header["joints"])
    _set_state(model, state, path)
    return model


def restore(identifier: Identifier, path: str | Path) -> None:
    """Sets an identifier of the same settings to the saved state; on failure it stays unchanged.

    Raises:
        FileError: As `load`, or the file is of another model, settings or number of joints.
    """
    header, state = _read(Path(path))
    wanted = (type(identifier).__name__, identifier.joints, identifier.settings)
    found = (header["model"], header["joints"], header["settings"])
    for what, want, have in zip(("model", "joints", "settings"), wanted, found, strict=True):
        if want != have:
            detail = "" if what == "settings" else f" {have!r}, the identifier {want!r}"
            raise FileError(f"{path} has other {what}{detail}: must agree", given=path)
    _set_state(identifier, state, path)


def _read(path: Path) -> tuple[dict[str, Any], bytes]:
    content = read_bytes(path)
    first, _, rest = content.partition(b"\n")
    magic, _, version = first.partition(b" ")
    if magic != MAGIC:
        raise FileError(f"{path} is no saved identifier", given=path)
    if version != b"%d" % VERSION:
        shown = version[:20].decode(errors="replace")
        text = f"{path} has version {shown!r}: this leglab reads "
        raise FileError(text, given=shown, allowed=str(VERSION))
    line, _, state = rest.partition(b"\n")
    try:
        header = parse_json(line)
        if header["model"] not in _MODELS:
            raise FileError.unknown("model", header["model"], _MODELS)
        checks.whole("joints", header["joints"], least=1)
        header["settings"] = decode(header["settings"])
        size, digest = header["size"], header["sha256"]
        layout = (header["state_version"], header["byte_order"])
    except LeglabError as error:
        raise FileError(f"{path} is damaged: {error}", given=path) from None
    except _MALFORMED:
        raise FileError(f"{path} is truncated or damaged in its header", given=path) from None
    if layout != (native.STATE_VERSION, sys.byteorder):
        raise FileError(
            f"{path} holds state version {layout[0]!r}, {layout[1]!r}-endian: this leglab reads ",
            given=path,
            allowed=f"{native.STATE_VERSION}, {sys.byteorder!r}-endian",
        )
    if len(state) != size:
        text = f"{path} is truncated: {len(state)} of {size!r} bytes of state"
        raise FileError(text, given=path)
    if hashlib.sha256(state).hexdigest() != digest:
        text = f"{path} is damaged: the checksum of its state does not agree"
        raise FileError(text, given=path)
    # A model of one joint yields the size for all joints, before memory for all is allocated.
    joint = len(_build(path, header, 1)._bank.state())
    if joint * header["joints"] != len(state):
        raise FileError(
            f"{path} is damaged: {len(state)} bytes of state, its settings need "
            f"{joint} for each of {header['joints']} joints",
            given=path,
        )
    return header, state


def _build(path: str | Path, header: dict[str, Any], joints: int) -> Identifier:
    try:
        return _MODELS[header["model"]](header["settings"], joints=joints)
    except LeglabError as error:
        raise FileError(f"{path} is damaged: {error}", given=path) from None
    except _MALFORMED as error:
        raise FileError(f"{path} is damaged: its settings cannot be", given=path) from error


def _set_state(identifier: Identifier, state: bytes, path: str | Path) -> None:
    try:
        identifier._bank.load_state(state)
    except ValueError as error:
        raise FileError(f"{path} is damaged: {error} cannot be", given=path) from None


def encode(value: Any) -> Any:
    """Returns settings as JSON values."""
    if dataclasses.is_dataclass(value):
        fields = {f.name: encode(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"type": type(value).__name__, **fields}
    if isinstance(value, tuple):
        return [encode(item) for item in value]
    return value


def decode(value: Any) -> Any:
    """Rebuilds settings from the JSON values that `encode` returned."""
    if isinstance(value, dict):
        fields = {name: decode(item) for name, item in value.items() if name != "type"}
        return _PARTS[value["type"]](**fields)
    if isinstance(value, list):
        return tuple(decode(item) for item in value)
    return value
