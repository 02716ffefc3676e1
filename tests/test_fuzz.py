"""What fuzzing began with and what it found: no reader of outside data trips over it again."""

import pytest

from tests.fuzz.targets import CORPUS, TARGETS, one_input

INPUTS = sorted(path.relative_to(CORPUS) for path in CORPUS.rglob("*") if path.is_file())


def test_every_reader_has_inputs():
    assert {path.parts[0] for path in INPUTS} == set(TARGETS)


@pytest.mark.parametrize("path", INPUTS, ids=str)
def test_a_file_is_read_or_refused_in_one_line(path):
    one_input(path.parts[0], (CORPUS / path).read_bytes())


@pytest.mark.parametrize("name", TARGETS)
def test_a_whole_file_is_read(name):
    plain = {"sweep": "page_0", "identifier": "narx", "model": "valve"}.get(name, "plain")
    assert one_input(name, (CORPUS / name / plain).read_bytes())
