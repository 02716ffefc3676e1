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
_NUMBERS = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13))
_CHARACTERS = frozenset((1, 2, 4, 16, 17, 18))
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE = 1, 2, 3, 4, 5
_NUMERIC = range(6, 16)
_COMPLEX = 0x800
_LARGEST = 2**31  # bytes of a variable, by the format.
# Of all compressed variables: zeros take a thousandth of their size, and memory several times it.
_LARGEST_TOTAL = 2**29  # bytes, or
_LARGEST_RATIO = 20  # times the size of the file.
_DEEPEST = 20
_MOST_DIMENSIONS = 32


def checked(content: bytes) -> bytes:
    """Returns the file with all variables uncompressed.

    Args:
        content: The file.

    Raises:
        ValueError: It is no such file, truncated or broken, or holds a class of variable that is
            no data: objects, functions, sparse matrices.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None or struct.unpack_from(f"{order}H", content, 124)[0] != 0x0100:
        raise ValueError("the first 128 bytes are not those of version 5")
    # Bytes 116 to 124 point to a workspace of objects, which is not read.
    variables = [content[:116] + bytes(8) + content[124:_HEADER]]
    left = most = max(_LARGEST_TOTAL, _LARGEST_RATIO * len(content))
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
        _check_matrix(data, order, 0)
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


def _check_matrix(content: bytes, order: str, depth: int) -> None:
    if not content:
        return  # An empty array as a part of another one.
    if depth > _DEEPEST:
        raise ValueError(f"arrays within arrays, more than {_DEEPEST} deep")
    parts = _elements(content, order)
    flags = _part(parts, {_UINT32}, "array flags")
    if len(flags) != 8:
        raise ValueError(f"array flags of {len(flags)} bytes")
    word = struct.unpack_from(f"{order}I", flags)[0]
    kind = word & 0xFF
    dimensions = _integers(_part(parts, {_INT32}, "dimensions"), order)
    if not 2 <= len(dimensions) <= _MOST_DIMENSIONS or min(dimensions) < 0:
        raise ValueError(f"an array of dimensions {dimensions}")
    count = math.prod(dimensions)
    _part(parts, {_INT8}, "name")
    if kind in _NUMERIC:
        _part(parts, _NUMBERS, "numbers")
        if word & _COMPLEX:
            _part(parts, _NUMBERS, "imaginary numbers")
    elif kind == _CHAR:
        _part(parts, _CHARACTERS, "text")
    elif kind == _CELL:
        _check_nested(parts, count, order, depth)
    elif kind == _STRUCT:
        length = _integers(_part(parts, {_INT32}, "length of field names"), order)
        names = _part(parts, {_INT8}, "field names")
        if len(length) != 1 or length[0] < 1 or len(names) % length[0]:
            raise ValueError("field names do not fit their length")
        _check_nested(parts, count * (len(names) // length[0]), order, depth)
    else:
        what = {_OBJECT: "an object", _SPARSE: "a sparse matrix"}.get(kind, f"of class {kind}")
        raise ValueError(f"a variable is {what}; allowed: numbers, text, cells and structs")
    if next(parts, None) is not None:
        raise ValueError("an array has more parts than it should")


def _check_nested(parts: Iterator[tuple[int, bytes]], count: int, order: str, depth: int) -> None:
    for _ in range(count):
        _check_matrix(_part(parts, {_MATRIX}, "array"), order, depth + 1)


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
