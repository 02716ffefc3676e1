"""Whatever parameters a cylinder is given within their bounds, its states stay numbers."""

import math
import re

import mujoco
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from leglab.base.errors import LeglabError
from leglab.machine.parameters import plugin_tables
from leglab.machine.plugin import load_error
from tests.helpers.plugin_models import CYLINDER, Slots, compiled, full_physics, slides, valve

TABLE = plugin_tables()["leglab.cylinder"]
ATMOSPHERE = 101325.0  # Pa


def values_of(row):
    """The lowest value, zero, and values about the nominal one, as far as the bounds allow."""
    nominal = CYLINDER.get(row.name, row.nominal)
    about = st.floats(0.3, 3.0).map(
        lambda factor: min(max(factor * nominal, row.minimum), row.maximum)
    )
    ends = [value for value in (row.minimum, 0.0) if row.minimum <= value <= row.maximum]
    if not row.minimum_allowed:
        ends = [value for value in ends if value > row.minimum]
    choices = [about, *map(st.just, ends)]
    if row.name == "substeps":
        return st.integers(1, 8)
    return st.one_of(choices)


# What an end stop or an empty chamber is made of: with no room for oil nothing is asked.
FIXED = {"stroke", "mid_length", "bore", "rod"}
VALUES = {
    name: values_of(row)
    for name, row in TABLE.parameters.items()
    if name not in FIXED and math.isfinite(row.nominal)
}
SOME = st.lists(st.sampled_from(sorted(VALUES)), max_size=6, unique=True).flatmap(
    lambda names: st.fixed_dictionaries({name: VALUES[name] for name in names})
)


@settings(max_examples=80, deadline=None)
@given(values=SOME, commands=st.lists(st.floats(-1.5, 1.5), min_size=4, max_size=4))
def test_states_stay_numbers_and_a_reset_repeats_them(values, commands):
    try:
        model, data = compiled(slides(valve("v", **values)))
    except (ValueError, mujoco.FatalError) as error:
        told = load_error(error, "model.xml")
        assert isinstance(told, LeglabError)
        assert "\n" not in str(told)
        return
    ends = []
    for _ in range(2):
        mujoco.mj_resetData(model, data)
        for command in commands:
            data.ctrl[:] = command
            mujoco.mj_step(model, data, 15)
        ends.append(full_physics(model, data))
        assert np.isfinite(ends[-1]).all(), values
        slots = Slots(model, data, "v")
        # Beyond vacuum there is no oil.
        assert slots["pressure_a"] >= -1.001 * ATMOSPHERE
        assert slots["pressure_b"] >= -1.001 * ATMOSPHERE
        assert abs(slots["spool_position"]) <= 1.0
    np.testing.assert_array_equal(*ends)


def test_sources_of_parameters_are_told_in_words():
    told = [
        row.description
        for table in plugin_tables().values()
        for row in (*table.parameters.values(), *table.states.values())
    ]
    assert any("Ledezma 2016" in text for text in told)
    assert not [text for text in told if re.search(r"\[(?!0)[A-Za-z]+\]", text)]
