"""Remarks on recordings, each said once for all columns and recordings that it is true of."""

from collections.abc import Iterable
from typing import NamedTuple


class Remark(NamedTuple):
    """One remark on a recording by its name, its text the same for all places.

    A place is a column in quotes, with what is special about it; "" for the recording as a whole.
    """

    text: str
    recording: str
    place: str = ""


def merged(remarks: Iterable[Remark], recordings: Iterable[str]) -> tuple[str, ...]:
    """One line for each text, with the recordings and their columns, in order of first mention.

    What is the same for each of all the `recordings` is said once.
    """
    found: dict[str, dict[str, list[str]]] = {}
    for text, recording, place in remarks:
        found.setdefault(text, {}).setdefault(recording, []).append(place)
    lines, whole = [], set(recordings)
    for text, where in found.items():
        listed = {name: ", ".join(filter(None, dict.fromkeys(p))) for name, p in where.items()}
        places, *others = set(listed.values())
        if others:
            told = (f"{name} ({p})" if p else name for name, p in listed.items())
            lines.append(f"{text}: {'; '.join(told)}")
        else:
            named = "all recordings" if len(whole) > 1 and set(where) == whole else ", ".join(where)
            lines.append(f"{named}: {text}" + f": {places}" * bool(places))
    return tuple(lines)
