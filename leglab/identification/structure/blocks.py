"""Held-out blocks of records, and stretches of the remaining records for the fits."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from leglab.identification.structure.fit import Fit, Problem, Stretch, startable

BLOCKS = (8, 3)
_LEAD_IN = 10_000  # samples that a free run simulates before the block in which it is scored
_MOST = 2  # blocks, relative to their number in a single record
_OVERLAP = 4  # number of overlapping stretches that contain the same sample
Table = tuple[tuple[float, ...], ...]


def blocks(problem: Problem, depth: int, count: int) -> list[Stretch]:
    """Returns about `count` blocks of the records, each of which is held out once.

    A record has at least one block. Of many blocks some are chosen, evenly spaced, because each
    block takes a fit.
    """
    out = []
    total = sum(map(len, problem.records))
    for k, record in enumerate(problem.records):
        pieces = max(1, round(count * len(record) / total))
        usable = np.flatnonzero(startable(record, depth))
        if len(usable) < 2 * pieces:
            continue
        edges = usable[np.linspace(0, len(usable) - 1, pieces + 1).astype(int)]
        edges[-1] = len(record)
        out += [Stretch(k, int(a), int(b - a)) for a, b in pairwise(edges)]
    kept = min(_MOST * count, len(out))
    return [out[i] for i in np.linspace(0, len(out) - 1, kept).round().astype(int)] if kept else out


def lead_in(problem: Problem, block: Stretch, depth: int) -> int:
    """Returns the index of the sample at which the free run over a held-out block begins."""
    usable = np.flatnonzero(startable(problem.records[block.record], depth))
    return int(usable[np.searchsorted(usable, max(0, block.start - _LEAD_IN))])


def stretches(
    problem: Problem, depth: int, length: int, budget: int, without: Stretch | None = None
) -> list[Stretch]:
    """Returns overlapping stretches for a fit that do not touch the held-out block `without`."""
    out: list[Stretch] = []
    while not out and length > 1:
        for k, record in enumerate(problem.records):
            size = min(length, len(record) - depth)
            if size < 1:
                continue
            usable = startable(record, depth)
            for start in range(depth, len(record) - size + 1, max(1, size // _OVERLAP)):
                if usable[start] and not _touches(Stretch(k, start, size), without, depth):
                    out.append(Stretch(k, start, size))
        length //= 2
    total = sum(s.length for s in out)
    if total <= budget:
        return out
    keep = max(2, int(len(out) * budget / total))
    return [out[i] for i in np.unique(np.linspace(0, len(out) - 1, keep).round().astype(int))]


def _touches(stretch: Stretch, block: Stretch | None, depth: int) -> bool:
    return (
        block is not None
        and block.record == stretch.record
        and stretch.start + stretch.length > block.start
        and stretch.start - depth < block.start + block.length
    )


class Held:
    """Held-out blocks, by default eighths and thirds of the records, and errors on the blocks."""

    def __init__(self, problem: Problem, depth: int, counts: tuple[int, ...] = BLOCKS) -> None:
        self._problem = problem
        parts = [blocks(problem, depth, count) for count in counts]
        self.all = [block for part in parts for block in part]
        self._firsts = [lead_in(problem, block, depth) for block in self.all]
        self._ends = np.cumsum([len(part) for part in parts])

    def errors(self, fits: Sequence[Fit]) -> Table:
        """Returns mean squared errors by block; the k-th fit was made without the k-th block."""
        errors = list(map(self._problem.error_of, fits, self.all, self._firsts))
        starts = [0, *self._ends[:-1]]
        return tuple(tuple(errors[a:b]) for a, b in zip(starts, self._ends, strict=True))
