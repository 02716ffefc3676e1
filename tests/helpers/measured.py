"""Recordings that are not part of this project: a test that needs absent ones is skipped."""

import pytest

from leglab.base.errors import LeglabError


def or_skip(read, *arguments):
    try:
        return read(*arguments)
    except LeglabError as error:
        pytest.skip(str(error))
