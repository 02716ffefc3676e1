import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from leglab.base.errors import LeglabError
from leglab.base.scenario import ParameterChange


def change(**settings):
    return ParameterChange(
        **{"parameter": "internal_leakage", "value": 10.0, "start": 5.0, **settings}
    )


def test_a_step_changes_at_its_start():
    step = change()
    assert [step.value_at(t, 2.0) for t in (0, 4.999, 5, 100)] == [2, 2, 20, 20]


def test_set_gives_the_value_itself():
    assert change(kind="set").value_at(6, 2.0) == 10.0


@pytest.mark.parametrize("kind", ["scale", "set"])
@given(st.floats(0, 20), st.floats(0.1, 10), st.floats(0, 100), st.floats(0, 100))
def test_a_ramp_is_a_straight_line_between_its_ends(kind, time, ramp, value, before):
    ramped = change(kind=kind, ramp_duration=ramp, value=value)
    after = before * value if kind == "scale" else value
    share = min(max((time - 5) / ramp, 0), 1)
    expected = before + share * (after - before)
    assert ramped.value_at(time, before) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert ramped.value_at(0, before) == before
    assert ramped.value_at(5 + ramp, before) == after


@pytest.mark.parametrize(
    ("pattern", "element", "applies"),
    [
        ("*", "knee_valve", True),
        ("knee_valve", "knee_valve", True),
        ("ankle_*", "knee_valve", False),
    ],
)
def test_patterns(pattern, element, applies):
    assert change(element=pattern).applies_to(element) is applies


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"kind": "add"}, "'internal_leakage': unknown kind 'add': choose scale or set"),
        ({"value": math.nan}, "value nan is not finite"),
        ({"value": -1.0}, "factor -1.0 is negative"),
        ({"start": -0.1}, "start -0.1 s is not allowed, must be >= 0"),
        ({"ramp_duration": -1}, "ramp_duration -1 s is not allowed"),
        ({"start": math.inf}, "start inf s is not allowed"),
    ],
)
def test_impossible_changes(settings, message):
    with pytest.raises(LeglabError, match=message):
        change(**settings)


def test_a_set_value_may_be_negative():
    assert change(kind="set", value=-10.0).value_at(6, 40.0) == -10
