"""Remarks on recordings; equal texts on several columns or recordings are merged."""

from collections.abc import Iterable
from typing import NamedTuple


class Remark(NamedTuple):
    """A remark on a recording: a text, which several remarks may share, and a place.

    A place is a column in quotes, with details of that column; "" for the recording as a whole.
    """

    text: str
    recording: str
    place: str = ""


def merged(remarks: Iterable[Remark], recordings: Iterable[str]) -> tuple[str, ...]:
    """Returns one line per text with the recordings and places that it concerns, in order.

    If a remark applies equally to all `recordings`, its line does not list them.
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
