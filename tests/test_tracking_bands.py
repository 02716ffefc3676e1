"""Tracking errors of a small matrix stay within committed bands; see `tests/tracking_bands.py`."""

import pytest

from tests.tracking_bands import CASES, measure, outside, read


def test_every_case_has_a_band():
    assert read().keys() == CASES.keys()


@pytest.mark.parametrize("case", CASES)
def test_tracking_error_is_in_its_band(case):
    assert not outside(case, measure(**CASES[case])), (
        "if this change is wanted: python -m tests.tracking_bands --write"
    )


# Half the gain, and half of what each other mechanism of learning is set to.
@pytest.mark.parametrize(
    "changed",
    [
        {"initial_gain": 1.5, "change_gain": 1.5},
        {"memory": 4000.0, "least_memory": 20.0},
        {"interval": 4},
        {"change_ratio": 1e9},
    ],
    ids=lambda changed: "-".join(changed),
)
def test_bands_are_narrow_enough_to_see_slower_learning(changed):
    case = "leg walking"
    assert outside(case, measure(**CASES[case], controller_config=changed))
