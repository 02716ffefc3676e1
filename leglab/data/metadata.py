"""Metadata of recordings as JSON text, as files hold it."""

import json
from collections.abc import Mapping
from typing import Any

from leglab.base.errors import RecordingError


def to_json(metadata: Mapping[str, Any]) -> str:
    """Returns metadata as JSON with sorted keys.

    Raises:
        ValueError: A number is not finite, which JSON cannot hold.
    """
    return json.dumps(dict(metadata), allow_nan=False, sort_keys=True)


def check_notes(metadata: Mapping[str, Any]) -> None:
    """Checks that the notes to which reading appends are lists.

    Raises:
        RecordingError: "alignment" or "repairs" is something else.
    """
    for key in ("alignment", "repairs"):
        if not isinstance(metadata.get(key, []), list):
            told = f"metadata {key!r} is {metadata[key]!r}, allowed is "
            raise RecordingError(told, given=metadata[key], allowed="a list")
