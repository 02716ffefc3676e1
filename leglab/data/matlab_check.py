"""Whether a MATLAB file of version 5 is whole, before scipy reads it.

scipy's reader is compiled and trusts the types and counts in a file: a broken one can end the
process. So every element is walked here first, and scipy gets exactly the bytes that were walked,
uncompressed. Layout: MathWorks, "MAT-File Format" (R2024b), chapter 1, "Level 5 MAT-Files".
"""

import math
import struct
import zlib
from collections.abc import Container, Iterator

_HEADER = 128  # bytes
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED = 1, 5, 6, 14, 15
_NUMBERS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}  # bytes a number
_CHARACTERS = frozenset((1, 2, 4, 16, 17, 18))
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _OPAQUE = 1, 2, 3, 4, 5, 17
# MATLAB commands that convert objects to readable types; {0} is the variable.
_SAVE = "; save('log.mat', '-struct', 's', '-v7')"
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
_NUMERIC = range(6, 16)
_COMPLEX = 0x800
_LARGEST = 2**31  # bytes of a variable, by the format.
# Of all variables, uncompressed and as arrays of 64-bit numbers: compressed zeros take a thousandth
# of their size, and a number of one byte becomes one of eight.
_LARGEST_TOTAL = 2**29  # bytes, or
_LARGEST_RATIO = 20  # times the size of the file.
_ARRAY, _LETTER = 128, 4  # bytes in memory of an array without content, and of a character
_DEEPEST = 20
_MOST_DIMENSIONS = 32


def checked(content: bytes) -> bytes:
    """Returns the file with all variables uncompressed.

    Args:
        content: The file.

    Raises:
        ValueError, struct.error, zlib.error: It is no such file, truncated or broken, or holds a
            class of variable that is no data: objects, functions, sparse matrices; or its variables
            would take more memory than a file of its size may.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None or struct.unpack_from(f"{order}H", content, 124)[0] != 0x0100:
        raise ValueError("the first 128 bytes are not those of version 5")
    # Bytes 116 to 124 point to a workspace of objects, which is not read.
    variables = [content[:116] + bytes(8) + content[124:_HEADER]]
    left = most = max(_LARGEST_TOTAL, _LARGEST_RATIO * len(content))
    arrays = _Arrays(order, most)
    for kind, data in _elements(content[_HEADER:], order, padded=False):
        if kind == _COMPRESSED:
            inflate = zlib.decompressobj()
            data = inflate.decompress(data, min(left + 1, _LARGEST))
            left -= len(data)
            if left < 0:
                raise ValueError(f"compressed variables hold more than {most} bytes")
            if not inflate.eof:
                raise ValueError("a compressed variable is truncated")
            ((kind, data),) = _elements(data, order)
        if kind != _MATRIX:
            raise ValueError(f"a variable of element type {kind}")
        arrays.check(data)
        variables.append(struct.pack(f"{order}II", _MATRIX, len(data)) + data)
    return b"".join(variables)


def _elements(content: bytes, order: str, *, padded: bool = True) -> Iterator[tuple[int, bytes]]:
    """Yields type and data of the elements that fill `content` exactly."""
    at = 0
    while at < len(content):
        kind, size = struct.unpack_from(f"{order}II", content, at)
        start = at + 8
        end = start + size + (-size % 8 if padded and kind != _COMPRESSED else 0)
        if kind >> 16:  # Up to four bytes are stored within the tag.
            kind, size, start, end = kind & 0xFFFF, kind >> 16, at + 4, at + 8
            if size > 4:
                raise ValueError(f"a small element of {size} bytes")
        if start + size > len(content):
            raise ValueError("the file ends within an element")
        yield kind, content[start : start + size]
        at = end


class _Arrays:
    """Walks arrays, whose memory [bytes] is taken from what is left."""

    def __init__(self, order: str, left: int) -> None:
        self._order, self._left = order, left

    def check(self, content: bytes, depth: int = 0) -> None:
        self._take(_ARRAY)
        if not content:
            return  # An empty array as a part of another one.
        if depth > _DEEPEST:
            raise ValueError(f"arrays within arrays, more than {_DEEPEST} deep")
        parts = _elements(content, self._order)
        word, _ = struct.unpack(f"{self._order}II", _part(parts, {_UINT32}, "array flags")[1])
        kind = word & 0xFF
        if kind == _OPAQUE:
            raise ValueError(_way_out(parts))
        if kind not in (_CELL, _STRUCT, _CHAR, *_NUMERIC):
            what = {_OBJECT: "an object", _SPARSE: "a sparse matrix"}.get(kind, f"of class {kind}")
            raise ValueError(f"a variable is {what}; allowed: numbers, text, cells and structs")
        dimensions = self._integers(parts, "dimensions")
        if not 2 <= len(dimensions) <= _MOST_DIMENSIONS or min(dimensions) < 0:
            raise ValueError(f"an array of dimensions {dimensions}")
        count = math.prod(dimensions)
        _part(parts, {_INT8}, "name")
        if kind in _NUMERIC:
            for what in ("numbers", "imaginary numbers")[: 2 if word & _COMPLEX else 1]:
                stored, numbers = _part(parts, _NUMBERS, what)
                self._take(8 * (len(numbers) // _NUMBERS[stored]))
        elif kind == _CHAR:
            self._take(_LETTER * len(_part(parts, _CHARACTERS, "text")[1]))
        else:
            if kind == _STRUCT:
                length = self._integers(parts, "length of field names")
                _, names = _part(parts, {_INT8}, "field names")
                if len(length) != 1 or length[0] < 1 or len(names) % length[0]:
                    raise ValueError("field names do not fit their length")
                count *= len(names) // length[0]
            for _ in range(count):
                self.check(_part(parts, {_MATRIX}, "array")[1], depth + 1)
        if next(parts, None) is not None:
            raise ValueError("an array has more parts than it should")

    def _take(self, size: int) -> None:
        self._left -= size
        if self._left < 0:
            raise ValueError("its variables take more memory than a file of this size may")

    def _integers(self, parts: Iterator[tuple[int, bytes]], what: str) -> list[int]:
        _, content = _part(parts, {_INT32}, what)
        return [number for (number,) in struct.iter_unpack(f"{self._order}i", content)]


def _part(
    parts: Iterator[tuple[int, bytes]], allowed: Container[int], what: str
) -> tuple[int, bytes]:
    """Type and data of the next part."""
    kind, content = next(parts, (0, b""))
    if kind not in allowed:
        raise ValueError(f"element type {kind} where {what} should be")
    return kind, content


def _way_out(parts: Iterator[tuple[int, bytes]]) -> str:
    """Names an object, which has its name, its system and its class as texts, and what to do."""
    texts = [part.rstrip(b"\0").decode(errors="replace") for kind, part in parts if kind == _INT8]
    name, _, kind, *_ = [*texts, "", "", ""]
    way = _WAYS_OUT.get(kind, _WAYS_OUT["timeseries"]).format(name or "x")
    what = f"variable {name or 'x'!r} is a {kind or 'an object'}"
    return f"{what}, which MATLAB alone reads; in MATLAB: {way}{_SAVE}"
