"""Whether a MATLAB file of version 5 is whole, before scipy reads it.

scipy's reader is compiled and trusts the types and counts in a file: a broken one can end the
process. So every element is walked here first, and scipy gets exactly the bytes that were walked,
uncompressed. Layout: MathWorks, "MAT-File Format" (R2024b), chapter 1, "Level 5 MAT-Files".
"""

import math
import struct
import zlib
from collections.abc import Iterator

_HEADER = 128  # bytes
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED = 1, 5, 6, 14, 15
_NUMBERS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}  # bytes a number
_CHARACTERS = frozenset((1, 2, 4, 16, 17, 18))
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _OPAQUE = 1, 2, 3, 4, 5, 17
# What MATLAB does with objects that it alone reads; {0} is the variable.
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
        ValueError: It is no such file, truncated or broken, or holds a class of variable that is
            no data: objects, functions, sparse matrices; or its variables would take more memory
            than a file of its size may.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None or struct.unpack_from(f"{order}H", content, 124)[0] != 0x0100:
        raise ValueError("the first 128 bytes are not those of version 5")
    # Bytes 116 to 124 point to a workspace of objects, which is not read.
    variables = [content[:116] + bytes(8) + content[124:_HEADER]]
    left = memory = most = max(_LARGEST_TOTAL, _LARGEST_RATIO * len(content))
    for kind, data in _elements(content[_HEADER:], order, padded=False):
        if kind == _COMPRESSED:
            inflate = zlib.decompressobj()
            try:
                data = inflate.decompress(data, min(left + 1, _LARGEST))
            except zlib.error as error:
                raise ValueError(f"a compressed variable is broken: {error}") from error
            left -= len(data)
            if left < 0:
                raise ValueError(f"compressed variables hold more than {most} bytes")
            if not inflate.eof:
                raise ValueError("a compressed variable is truncated")
            inner = list(_elements(data, order))
            if len(inner) != 1:
                raise ValueError(f"a compressed variable holds {len(inner)} elements")
            kind, data = inner[0]
        if kind != _MATRIX:
            raise ValueError(f"a variable of element type {kind}")
        memory -= _check_matrix(data, order, 0, memory)
        variables.append(struct.pack(f"{order}II", _MATRIX, len(data)) + data)
    return b"".join(variables)


def _elements(content: bytes, order: str, *, padded: bool = True) -> Iterator[tuple[int, bytes]]:
    """Yields type and data of the elements that fill `content` exactly."""
    at = 0
    while at < len(content):
        if at + 8 > len(content):
            raise ValueError("the file ends within an element")
        kind, size = struct.unpack_from(f"{order}II", content, at)
        if kind >> 16:  # Up to four bytes are stored within the tag.
            kind, size = kind & 0xFFFF, kind >> 16
            if size > 4:
                raise ValueError(f"a small element of {size} bytes")
            yield kind, content[at + 4 : at + 4 + size]
            at += 8
            continue
        if at + 8 + size > len(content):
            raise ValueError("the file ends within an element")
        yield kind, content[at + 8 : at + 8 + size]
        at += 8 + size
        if padded and kind != _COMPRESSED:
            at += -size % 8


def _check_matrix(content: bytes, order: str, depth: int, most: int) -> int:
    """Returns the memory that an array takes [bytes]; more than `most` is refused."""
    if not content:
        return _within(most, _ARRAY)  # An empty array as a part of another one.
    if depth > _DEEPEST:
        raise ValueError(f"arrays within arrays, more than {_DEEPEST} deep")
    parts = _elements(content, order)
    flags = _part(parts, {_UINT32}, "array flags")
    if len(flags) != 8:
        raise ValueError(f"array flags of {len(flags)} bytes")
    word = struct.unpack_from(f"{order}I", flags)[0]
    kind = word & 0xFF
    if kind == _OPAQUE:
        raise ValueError(_way_out(parts))
    if kind not in (_CELL, _STRUCT, _CHAR, *_NUMERIC):
        what = {_OBJECT: "an object", _SPARSE: "a sparse matrix"}.get(kind, f"of class {kind}")
        raise ValueError(f"a variable is {what}; allowed: numbers, text, cells and structs")
    dimensions = _integers(_part(parts, {_INT32}, "dimensions"), order)
    if not 2 <= len(dimensions) <= _MOST_DIMENSIONS or min(dimensions) < 0:
        raise ValueError(f"an array of dimensions {dimensions}")
    count = math.prod(dimensions)
    _part(parts, {_INT8}, "name")
    size = _ARRAY
    if kind in _NUMERIC:
        size += _numbers(parts, "numbers")
        if word & _COMPLEX:
            size += _numbers(parts, "imaginary numbers")
    elif kind == _CHAR:
        size += _LETTER * len(_part(parts, _CHARACTERS, "text"))
    elif kind == _CELL:
        size += _check_nested(parts, count, order, depth, most)
    else:
        length = _integers(_part(parts, {_INT32}, "length of field names"), order)
        names = _part(parts, {_INT8}, "field names")
        if len(length) != 1 or length[0] < 1 or len(names) % length[0]:
            raise ValueError("field names do not fit their length")
        fields = count * (len(names) // length[0])
        size += _check_nested(parts, fields, order, depth, most)
    if next(parts, None) is not None:
        raise ValueError("an array has more parts than it should")
    return _within(most, size)


def _way_out(parts: Iterator[tuple[int, bytes]]) -> str:
    """Names an object, which has its name, its system and its class as texts, and what to do."""
    texts = [part.rstrip(b"\0").decode(errors="replace") for kind, part in parts if kind == _INT8]
    name, kind = ([*texts, "", "", ""][0] or "x"), [*texts, "", "", ""][2]
    way = _WAYS_OUT.get(kind, _WAYS_OUT["timeseries"]).format(name)
    what = kind or "an object"
    return f"variable {name!r} is a {what}, which MATLAB alone reads; in MATLAB: {way}{_SAVE}"


def _within(most: int, size: int) -> int:
    if size > most:
        raise ValueError("its variables take more memory than a file of this size may")
    return size


def _numbers(parts: Iterator[tuple[int, bytes]], what: str) -> int:
    """Bytes of the next part's numbers as 64-bit ones, which columns of recordings are."""
    kind, content = next(parts, (0, b""))
    if kind not in _NUMBERS:
        raise ValueError(f"element type {kind} where {what} should be")
    return 8 * (len(content) // _NUMBERS[kind])


def _check_nested(
    parts: Iterator[tuple[int, bytes]], count: int, order: str, depth: int, most: int
) -> int:
    size = 0
    for _ in range(count):
        content = _part(parts, {_MATRIX}, "array")
        size += _check_matrix(content, order, depth + 1, most - size)
    return size


def _part(
    parts: Iterator[tuple[int, bytes]], allowed: frozenset[int] | set[int], what: str
) -> bytes:
    kind, content = next(parts, (0, b""))
    if kind not in allowed:
        raise ValueError(f"element type {kind} where {what} should be")
    return content


def _integers(content: bytes, order: str) -> tuple[int, ...]:
    if len(content) % 4:
        raise ValueError(f"32-bit integers in {len(content)} bytes")
    return struct.unpack(f"{order}{len(content) // 4}i", content)
