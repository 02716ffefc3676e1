"""Remarks on recordings, each said once for all columns and recordings that it is true of."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Remark:
    """One remark on a recording.

    Attributes:
        text: What is remarked, the same for all places.
        recording: Name.
        place: Column in quotes, with what is special about it; "" for the recording as a whole.
    """

    text: str
    recording: str
    place: str = ""


def merged(remarks: Iterable[Remark], recordings: Iterable[str] = ()) -> tuple[str, ...]:
    """One line for each text, with the recordings and their columns.

    Args:
        remarks: In any order; lines come in the order of first mention.
        recordings: All of them: what is the same for each is said once.
    """
    found: dict[str, dict[str, list[str]]] = {}
    for remark in remarks:
        places = found.setdefault(remark.text, {}).setdefault(remark.recording, [])
        if remark.place and remark.place not in places:
            places.append(remark.place)
    whole = set(recordings)
    lines = []
    for text, where in found.items():
        same = len({tuple(places) for places in where.values()}) == 1
        named = "all recordings" if len(whole) > 1 and set(where) == whole else ", ".join(where)
        if same:
            listed = ", ".join(next(iter(where.values())))
            lines.append(f"{named}: {text}{f': {listed}' if listed else ''}")
            continue
        listed = "; ".join(f"{name} ({', '.join(p)})" if p else name for name, p in where.items())
        lines.append(f"{text}: {listed}")
    return tuple(lines)
