"""What is said of a diagnosis: headline, confidence, what is left."""

from dataclasses import replace

import pytest

from leglab.diagnosis.result import Certainty, Estimate, Moved
from leglab.diagnosis.verdict.output import summary_lines
from leglab.report.diagnosis.why import why
from leglab.report.diagnosis.words import (
    facts,
    headline,
    improved_words,
    parameter_words,
)
from tests.helpers.made_up_diagnosis import CALIBRATION, diagnosis, effect, left, section


def test_noise_that_no_rig_resolves_has_no_digits():
    still = replace(left("knee_position", "rad", 0.024), noise=2e-8)
    assert "sensor noise under 0.001 mrad" in dict(facts(diagnosis(remaining=(still,))))["Left"]


def test_smaller_differences_are_no_names():
    small = replace(
        effect("command_delay"),
        contribution=0.02,
        parameters=(
            Estimate(name="delay", unit="s", value=0.0011, nominal=0.0, interval=(0.001, 0.0012)),
        ),
    )
    result = diagnosis(smaller=(small,))
    assert section(result, "What is missing").endswith(
        "There too, and not the cause: command delay at knee_valve 1.1 ms (closes 2 % of the gap)."
    )
    assert "delay" not in headline(result)
    assert "delay" not in dict(facts(result))["Missing"]


def test_the_share_without_an_effect_is_a_factor():
    result = diagnosis(effects=(replace(effect(), without=12.1),))
    assert "without it the error is 11 times as large (12.1 instead of 1.1 noise levels)" in (
        section(result, "How sure")
    )


@pytest.mark.parametrize("verdict", ["named", "confusion_set"])
def test_confidence_is_told_as_it_was_computed(verdict):
    text = section(diagnosis(verdict), "How sure")
    for word in ("all sets of effects", "without any one part", "units of the drive", "no effect"):
        assert word in text


def test_the_number_of_a_confusion_set_is_that_of_the_set():
    one = replace(effect(rivals=("payload",)), confidence=0.004)
    result = replace(diagnosis("confusion_set", effects=(one,)), among=0.83)
    assert dict(facts(result))["How sure"] == "83 % that the cause is one of these."
    assert "or another of these: confidence 83 %" in section(result, "How sure")


def test_unexplained_says_what_was_tried_and_learned():
    there = Estimate(
        name="supply_pressure", unit="Pa", value=2.05e7, nominal=2.1e7, interval=(2e7, 2.2e7)
    )
    moved = Moved(effect="supply_pressure", element="knee_valve", estimate=there, share=-1.0)
    result = diagnosis("unexplained", moved=(moved,), learned="a torque that repeats")
    text = section(result, "What was tried")
    assert (
        "3 possible effects, alone and together; valve deadband and payload + stiction came closest"
    ) in text
    assert "errs by 14.2 noise levels, recalibrated within tolerance by 12" in text
    assert "Recalibrated: supply pressure 205 bar, in the model 210 bar." in text
    assert "carries no effect without a name" in text
    assert "Learned without a name: a torque that repeats." in text
    assert "no effect without a name is in it" in improved_words(result)
    assert "No improved model" in section(replace(result, model=""), "What was tried")


def test_what_comes_nearest_is_told_with_its_doubt_and_is_not_in_the_model():
    one = replace(effect("spring_stiffness", "knee"), confidence=0.004)
    result = replace(diagnosis("unexplained", effects=(one,)), model="improved.xml")
    assert headline(result).endswith("explains it; nearest comes spring stiffness at knee.")
    told = dict(facts(result))
    assert told["Missing"].startswith("Nothing that can be named; nearest comes")
    assert told["How sure"] == "Under 1 % that the name is right."
    assert "spring stiffness" not in improved_words(result)


def test_an_error_without_a_name_has_a_place_and_a_shape():
    result = diagnosis("unexplained", learned="a torque that repeats")
    result = result.with_model("improved.xml", result.learned, [0.0031, 2e5])
    told = dict(facts(result))
    assert "with what was learned 3.1 mrad" in told["Left"]
    assert result.to_json()["remaining"][1]["learned"] == 2e5
    assert told["Missing"] == (
        "Something that has no name among the 3 effects tried; most of it in the hydraulics of "
        "knee_valve, anywhere."
    )
    assert told["Learned"] == "Without a name: a torque that repeats."
    assert "Explains" not in told
    assert "Learned" not in dict(facts(diagnosis("nothing_missing", learned="a torque")))


def test_ends_of_a_narrow_interval_differ():
    narrow = Estimate(
        name="lap", unit="kg", value=0.049998, nominal=0.02, interval=(0.049991, 0.050005)
    )
    assert parameter_words(narrow) == ("0.049998 kg", "0.049991 to 0.050005 kg", "0.02 kg")


@pytest.mark.parametrize("since", [False, True])
def test_a_sure_effect_is_told_apart_from_one_that_has_rivals(since):
    one = diagnosis("confusion_set")
    (tied,) = one.effects
    sure = replace(tied, name="payload", element="shank", indistinguishable_from=())
    calibration = CALIBRATION if since else None
    told = headline(replace(one, effects=(sure, tied), calibration=calibration))
    if since:
        wanted = "Changed since the healthy recordings: payload at shank, and one of these: "
    else:
        wanted = "The simulation is missing payload at shank, and something that these recordings "
    assert told.startswith(wanted)
    assert told.endswith(": valve deadband or stiction at knee_valve.")


def test_one_cause_of_several_joints_is_told_once():
    one = diagnosis("confusion_set")
    legs = tuple(
        replace(one.effects[0], name="viscous_friction", element=joint)
        for joint in ("hip", "thigh", "calf")
    )
    told = headline(replace(one, effects=legs))
    assert told.endswith(": viscous friction or stiction at hip, thigh and calf.")
    sure = dict(facts(replace(one, effects=legs)))["How sure"]
    assert sure.startswith("Viscous friction at hip ")
    alone = replace(legs[0], indistinguishable_from=())
    told = headline(replace(one, effects=(alone,)))
    assert told.endswith("do not pin down: perhaps viscous friction at hip.")


def test_a_constant_force_is_told_with_the_friction_beside_which_it_explains():
    one = diagnosis("confusion_set")
    rivals = ("coulomb_friction", "force_offset", "viscous_friction")
    effect = replace(one.effects[0], name="asymmetric_friction", indistinguishable_from=rivals)
    one = replace(one, effects=(effect,))
    both = "coulomb friction and viscous friction with a force offset"
    assert f"asymmetric friction or {both} at knee_valve." in headline(one)
    assert f"Asymmetric friction is not told apart from {both}." in section(one, "How sure")
    other = replace(effect, name="payload")
    assert "payload, coulomb friction, force offset or" in headline(replace(one, effects=(other,)))


def test_inertia_is_told_with_the_friction_beside_which_it_imitates_a_weak_drive():
    one = diagnosis("confusion_set")
    rivals = ("encoder_scale", "armature", "viscous_friction", "coulomb_friction")
    effect = replace(one.effects[0], name="actuator_gain", indistinguishable_from=rivals)
    one = replace(one, effects=(effect,))
    both = "armature with viscous friction and coulomb friction"
    assert f"actuator gain, encoder scale or {both} at knee_valve." in headline(one)
    assert f"Actuator gain is not told apart from encoder scale or {both}." in section(
        one, "How sure"
    )
    # Without inertia friction is a rival of its own.
    other = replace(effect, indistinguishable_from=rivals[2:])
    assert "actuator gain, viscous friction or coulomb friction" in headline(
        replace(one, effects=(other,))
    )


def test_an_onset_is_told_as_a_time_or_as_from_when_to_when_it_may_have_been():
    one = effect(
        onset=(("walk", 4.35), ("run", 6.02)),
        onset_interval=(("walk", 2.7, 6.0), ("run", 6.0, 6.04)),
    )
    assert one.begins() == ("between 2.70 and 6.00 s of walk", "at 6.02 s of run")
    told = section(diagnosis(effects=(one,)), "What is missing")
    assert "begins between 2.70 and 6.00 s of walk and at 6.02 s of run." in told
    assert "valve_deadband begins between 2.70 and 6.00 s of walk" in summary_lines(
        diagnosis(effects=(one,))
    )
    (written,) = diagnosis(effects=(one,)).to_json()["effects"]
    assert written["onset"] == {"walk": 4.35, "run": 6.02}
    assert written["onset_interval"] == {"walk": [2.7, 6.0], "run": [6.0, 6.04]}


def test_by_how_much_directions_differ_is_told_beside_what_is_unsure_of_each():
    one = Estimate(
        name="viscous_forward_less_backward",
        unit="N s/m",
        value=-73.0,
        nominal=0.0,
        interval=(-90.0, -56.0),
    )
    asymmetric = effect("asymmetric_friction", "slide", differences=(one,))
    told = dict(facts(diagnosis(effects=(asymmetric,))))["Missing"]
    assert "viscous forward less backward -73 N s/m (95 %: -90 to -56 N s/m)" in told
    (written,) = diagnosis(effects=(asymmetric,)).to_json()["effects"]
    assert written["differences"][one.name]["interval"] == [-90.0, -56.0]
    assert list(written["parameters"]) == ["lap"]


def test_why_explains_an_effect_by_its_evidence_and_the_fitted_sets():
    result = diagnosis()
    best, other, third = (why(result, one.name) for one in result.ranking)
    assert best[:2] == (
        "valve deadband at knee_valve",
        "  alone, at first order and with the final model error: 900 nats over no effect",
    )
    assert best[3].endswith("(the best set without stiction): 1.2 noise levels")
    assert best[-1] == "  reported with a confidence of 91 %"
    assert other[1].endswith(
        "300 nats over no effect; the largest is 900, valve deadband at knee_valve"
    )
    assert other[2].endswith("1.1 noise levels, 7 nats behind the most probable set")
    assert "at best 12 nats less than the most probable set" in other[3]
    assert other[4].startswith("  most probable: valve deadband at knee_valve (")
    assert "not among the effects that gain most" in third[-2]
    shares = {"evidence": 0.97, "parts": 0.6, "drive": 0.5, "explained": 0.9, "inside": 0.8}
    own = {"name": "stiction", "element": "knee_valve", "confidence": 0.12, "differs": 0.6}
    judged = replace(result, judged=(Certainty(**own, **shares, ties=1),))
    (line,) = (one for one in why(judged, "stiction") if "confidence" in one)
    assert line.startswith("  confidence 12 %: the smallest of 97 % by the evidence of its sets")
    for word in ("60 % without", "50 % in units", "times 80 %, as it explains 90 %", "60 % that"):
        assert word in line
    assert line.endswith("divided by 2; other sets that fit as well: 1")
    unsure = replace(result, effects=())
    assert "below the confidence that a name needs" in why(unsure, "valve_deadband")[-1]
    assert "has no place for it" in why(result, "joint_flexibility")[0]
    assert "--effect leaves it out" in why(result, "joint_flexibility", ["payload"])[0]
