"""Rules of the verdict on tables of sets made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from leglab.base.errors import FileError
from leglab.diagnosis.verdict.confidence import judge
from leglab.diagnosis.verdict.table import Action, Entry, Member, Table

GAIN, DRY, WET, BOTH = (
    ("actuator_gain", "drive"),
    ("coulomb_friction", "knee"),
    ("viscous_friction", "knee"),
    ("asymmetric_friction", "knee"),
)
PARTS = 4


def action(share=0.99, acts=0.99):
    """Windows of two recordings in which an effect explains a share, and acts by a share."""
    left = 1.0 + 10.0 * (1.0 - share)
    error = left - 1.0 + np.sqrt(2.0 / 1000)
    without = left + share / max(1.0 - share, 1e-9) * error
    change = acts / (1.0 - acts) * error
    numbers = ((left,), (without,), (change,))
    fields = dict(zip(("left", "without", "change"), numbers, strict=True))
    return Action(numbers=(1000, 1000), **{name: (one, one) for name, one in fields.items()})


def member(key, share=0.99, held_out=None, differs=1.0):
    return Member(key=key, differs=differs, fitted=action(share), held_out=held_out)


def entry(*keys, log=0.0, apart=None, members=None, **others):
    own = tuple(member(k) for k in sorted(keys)) if members is None else members
    return Entry(
        keys=tuple(sorted(keys)),
        log=log,
        apart=(log,) * PARTS if apart is None else apart,
        members=own,
        **{"ended": (), "fit": log, "drive": 0.0, "numbers": len(keys), **others},
    )


def table(*sets, **others):
    """A table with the empty set a hundred nats behind, unless another one is given."""
    if all(one.keys for one in sets):
        sets = (*sets, entry(log=-100.0))
    ranked = tuple(sorted(sets, key=lambda one: -one.log))
    return Table(
        sets=ranked, **{"level": 100.0, "impostor": (-0.85, 1.8), "contains": (), **others}
    )


def names(judged):
    return judged.verdict, judged.named, judged.confusion


def test_a_set_far_ahead_of_all_others_gives_its_names():
    judged = judge(table(entry(DRY, WET), entry(DRY, log=-30.0), entry(WET, log=-20.0)))
    assert judged.verdict == "named"
    assert set(judged.named) == {DRY, WET}
    assert all(judged.effects[key].confidence > 0.95 for key in (DRY, WET))


@pytest.mark.parametrize(
    ("ahead", "verdict"), [(0.0, "confusion_set"), (0.5, "confusion_set"), (3.0, "named")]
)
def test_a_rival_as_probable_takes_the_name(ahead, verdict):
    judged = judge(table(entry(DRY), entry(WET, log=-ahead)))
    assert judged.verdict == verdict
    assert judged.effects[DRY].evidence == pytest.approx(1.0 / (1.0 + np.exp(-ahead)))
    if verdict == "confusion_set":
        assert judged.confusion == (DRY, WET)
        assert judged.among > 0.95


def test_every_part_of_the_recordings_has_to_agree():
    agreed, alone = (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, -25.0)
    rival = entry(WET, log=-20.0)
    assert judge(table(entry(DRY, apart=agreed), rival)).named == (DRY,)
    judged = judge(table(entry(DRY, apart=alone), rival))
    assert not judged.named
    assert judged.effects[DRY].evidence > 0.99


def test_what_ends_at_a_bound_is_neither_named_nor_possible():
    at_bound = entry(DRY, ended=(DRY,))
    judged = judge(table(at_bound, entry(WET, log=-0.1)))
    assert DRY not in (*judged.named, *judged.confusion)
    assert judged.effects[DRY].confidence == judged.effects[DRY].possible == 0.0
    beside = judge(table(entry(DRY, WET, ended=(WET,))))
    assert not beside.named
    assert beside.effects[DRY].possible > 0.9


@pytest.mark.parametrize(("share", "verdict"), [(0.95, "named"), (0.3, "unexplained")])
def test_an_effect_has_to_explain_the_errors(share, verdict):
    judged = judge(table(entry(DRY, members=(member(DRY, share),))))
    assert names(judged) == (verdict, (DRY,) if verdict == "named" else (), ())
    assert judged.effects[DRY].possible == judged.effects[DRY].confidence < 1.0


def test_confidence_falls_with_what_wrong_effects_explain():
    fitted = table(entry(DRY, members=(member(DRY, 0.95),)))
    alike = replace(fitted, impostor=(2.0, 1.8))
    assert judge(fitted).effects[DRY].confidence > 0.85 > judge(alike).effects[DRY].confidence


@pytest.mark.parametrize(("acts", "named"), [(0.99, False), (0.05, True)])
def test_held_out_recordings_refute_a_name_only_where_it_acts(acts, named):
    held = action(share=0.1, acts=acts)
    judged = judge(table(entry(DRY, members=(member(DRY, 0.98, held),))))
    assert bool(judged.named) == named


def test_shares_explained_are_weighted_by_the_action():
    # Chance alone leaves sqrt(2/200) = 0.1 of the noise, with 50 errors 0.2.
    one = Action(
        numbers=(200, 50),
        left=((1.0,), (1.8,)),
        without=((1.1,), (1.3,)),
        change=((0.1,), (3.0,)),
    )
    # Shares 0.1/(0.1 + 0.1) and 0, actions 0.1/(0.1 + 0.1) and 3/(3 + 0.8 + 0.2).
    assert one.explained == pytest.approx((0.5 * 0.5 / (0.5 + 0.75), (0.5 + 0.75) / 2))
    fitted, better = action(0.6, 0.9), action(0.9, 0.8)
    assert member_of(fitted, better).share == pytest.approx(0.6)
    assert member_of(better, fitted).share == pytest.approx(0.9 - 0.9 * (0.9 - 0.6))


def member_of(fitted, held_out):
    return Member(key=DRY, differs=1.0, fitted=fitted, held_out=held_out)


def test_an_effect_with_directions_is_named_if_they_differ():
    fitted = [table(entry(BOTH, members=(member(BOTH, differs=p),))) for p in (0.99, 0.4)]
    assert [judge(one).named for one in fitted] == [(BOTH,), ()]


def test_the_best_member_gives_a_confusion_set_its_probability():
    sets = entry(DRY, members=(member(DRY, 0.99),)), entry(WET, members=(member(WET, 0.7),))
    assert judge(table(*sets)).among > 0.95
    weak = [replace(one, members=(member(one.keys[0], 0.05),)) for one in sets]
    assert names(judge(table(*weak))) == ("unexplained", (), ())


def test_a_rival_that_fits_as_well_halves_the_confidence_of_a_gain():
    first = entry(GAIN, log=0.0, numbers=1)
    resists = entry(DRY, WET, log=-8.0, fit=0.0, numbers=3)
    judged = judge(table(first, resists))
    assert judged.effects[GAIN].ties == (frozenset({DRY, WET}),)
    assert names(judged) == ("confusion_set", (), (GAIN, DRY, WET))
    other = replace(resists, numbers=4)
    assert judge(table(first, other)).named == (GAIN,)
    friction = judge(table(replace(first, keys=(BOTH,), members=(member(BOTH),)), resists))
    assert friction.named == (BOTH,)


def test_an_effect_that_contains_another_is_no_tie():
    sets = entry(DRY), entry(BOTH, log=-1.0)
    rivals = [judge(table(*sets, contains=one)).effects[DRY].ties for one in ((), ((BOTH, DRY),))]
    assert rivals == [(frozenset({BOTH}),), ()]


def test_a_set_that_weakens_the_drive_loses_what_it_weakens():
    strong, weak = entry(DRY, log=-5.0), entry(WET, drive=-20.0)
    judged = judge(table(strong, weak))
    assert not judged.named
    assert judged.effects[WET].confidence < 0.01 < judged.effects[WET].evidence
    assert judge(table(strong, replace(weak, drive=0.0))).named == (WET,)


def test_a_name_has_to_stand_in_the_best_set_in_units_of_the_drive_as_well():
    weakens = entry(DRY, drive=-20.0)
    explains_little = entry(DRY, WET, log=-5.0, members=(member(DRY, 0.2), member(WET)))
    assert judge(table(weakens)).named == (DRY,)
    assert judge(table(weakens, explains_little)).effects[DRY].confidence < 0.5


def test_ties_are_counted_in_units_of_the_drive():
    rivals = [entry(WET, log=-1.0, drive=lost) for lost in (0.0, -1.0)]
    ties = [judge(table(entry(DRY), one)).effects[DRY].ties for one in rivals]
    assert ties == [(frozenset({WET}),), ()]


QUIET = {"quiet": True, "quiet_held_out": True}


@pytest.mark.parametrize(
    ("empty", "verdict"),
    [
        (entry(log=0.5, **QUIET), "nothing_missing"),
        (entry(log=-3.0, **QUIET), "named"),
        # Possible without one part of the recordings, as an effect of a confusion set has to be.
        (entry(log=-3.0, apart=(-3.0, -3.0, -3.0, 9.0), **QUIET), "nothing_missing"),
        (entry(log=0.5), "unexplained"),
        (entry(log=0.5, quiet=True), "unexplained"),
    ],
)
def test_nothing_is_missing_if_the_empty_set_is_probable_and_leaves_noise(empty, verdict):
    assert judge(table(entry(DRY), empty)).verdict == verdict


@pytest.mark.parametrize(
    ("sets", "as_it_was", "verdict"),
    [
        ((entry(DRY), entry(WET)), True, "nothing_missing"),
        ((entry(DRY), entry(WET)), False, "confusion_set"),
        ((entry(DRY),), True, "named"),
        ((entry(DRY), entry(log=0.5, **QUIET)), False, "nothing_missing"),
        ((entry(DRY), entry(WET), entry(**QUIET)), False, "confusion_set"),
        ((entry(DRY), entry(WET), entry(**QUIET)), None, "nothing_missing"),
    ],
)
def test_a_machine_that_errs_as_it_did_lacks_nothing_but_a_sure_name(sets, as_it_was, verdict):
    assert judge(table(*sets, as_it_was=as_it_was)).verdict == verdict


def test_a_table_is_judged_from_its_file_as_before(tmp_path):
    held = action(0.9, 0.5)
    made = table(
        entry(DRY, members=(member(DRY, 0.97, held),)),
        entry(GAIN, log=-2.0, ended=(GAIN,)),
        contains=((BOTH, DRY),),
        as_it_was=False,
    )
    path = tmp_path / "sets.json"
    made.write(path)
    assert Table.read(path) == made
    assert judge(Table.read(path)) == judge(made)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "Expecting value"),
        ("{}", "sets: Field required"),
        ('{"sets": [], "level": "high"}', "level: .*number"),
        (None, "No such file"),
    ],
)
def test_a_file_that_is_no_table_is_refused(text, reason, tmp_path):
    path = tmp_path / "sets.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(FileError, match=rf"sets.json is no table.*{reason}.*--keep"):
        Table.read(path)
