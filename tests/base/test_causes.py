"""The catalogue of causes names what there is."""

import re

from leglab.base.causes import CAUSES, effect_of, live_of
from leglab.base.scenario import scenario_names
from leglab.diagnosis.effects import all_effects
from leglab.machine.parameters import plugin_tables
from leglab.runs.fault_simulation import FAULTS, PARTS


def test_every_fault_that_is_named_while_driving_has_its_name_in_a_diagnosis():
    known = {effect.name for effect in all_effects()}
    for cause in CAUSES:
        assert set(cause.effect.split(" and ")) <= known
        assert cause.live in {*scenario_names(), *PARTS}
    assert {*FAULTS, *PARTS} <= {cause.live for cause in CAUSES}
    # Where both use a name they mean the same.
    for cause in CAUSES:
        assert cause.live not in known or cause.live == cause.effect


def test_attributes_are_those_of_the_plugins():
    there = {name for table in plugin_tables().values() for name in table.parameters}
    for cause in CAUSES:
        if " of " not in cause.attributes and "'" not in cause.attributes:
            assert set(re.split(r", | or ", cause.attributes)) <= there, cause.live


def test_names_that_differ_are_found_both_ways():
    assert effect_of("seal_wear") == "internal_leakage"
    assert live_of("internal_leakage") == ("seal_wear",)
    assert effect_of("stiction") == ""
    assert live_of("valve_deadband") == ()
    assert live_of("armature") == ()
