"""Figures and page of diagnoses made up by hand: no simulation runs here."""

import base64
import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from leglab.cli import main
from leglab.diagnosis.result import (
    Diagnosis,
    Estimate,
    Gap,
    NamedEffect,
    NotTestable,
    Proposal,
    Rank,
    RecordingGap,
    ResidualTrace,
    Rivals,
    Where,
)
from leglab.report.diagnosis.figures import pictures, short
from leglab.report.diagnosis.page import write_page
from leglab.report.diagnosis.words import parameter_words, sections
from leglab.report.page.wording import number

HOSTILE = "<script>alert('1')</script> & \"$\\frac\" \x00"
SPACE = "{http://www.w3.org/1999/xhtml}"


def effect(name="valve_deadband", element="knee_valve", rivals=(), onset=()):
    return NamedEffect(
        name=name,
        element=element,
        group="valve and command",
        physics="No flow while |x| < lap.",
        onset=onset,
        confidence=0.91,
        contribution=0.8,
        parameters=(
            Estimate(name="lap", unit="1", value=0.05, nominal=0.02, interval=(0.04, 0.06)),
        ),
        indistinguishable_from=rivals,
    )


def trace(recording, channel, unit, seed):
    rng = np.random.default_rng(seed)
    time = np.arange(60) * 0.05
    return ResidualTrace(
        recording=recording,
        channel=channel,
        unit=unit,
        time=time,
        position=np.sin(time),
        velocity=np.cos(time),
        pressure=1e6 * np.sin(3 * time),
        before=rng.normal(size=60) + 2.0,
        after=(0.1 if unit == "rad" else 0.3) * rng.normal(size=60),
    )


def diagnosis(verdict="named", effects=None, recording="walk", **changes):
    gone = verdict in ("unexplained", "nothing_missing")
    rivals = ("stiction",) if verdict == "confusion_set" else ()
    if effects is None:
        effects = () if gone else (effect(rivals=rivals),)
    tried = (("valve_deadband", "knee_valve"), ("stiction", "knee_valve"), ("payload", "shank"))
    result = Diagnosis(
        verdict=verdict,
        effects=effects,
        where=(Where(residual="hydraulic", element="knee_valve", level=27.0, region="anywhere"),),
        not_testable=(NotTestable(name="backlash", element="knee", reason="needs reversals"),),
        gap=Gap(before=14.2, baseline=12.0, after=1.1, held_out=(recording,)),
        recordings=(
            RecordingGap(name=recording, held_out=True, before=14.2, baseline=12.0, after=1.1),
            RecordingGap(name="slow", held_out=False, before=9.0, baseline=8.0, after=1.0),
        ),
        ceiling=0.4,
        ranking=tuple(
            Rank(name=n, element=e, round=1, gain=g, threshold=25.0)
            for (n, e), g in zip(tried, (900.0, 300.0, -4.0), strict=True)
        ),
        rivals=(
            Rivals(
                round=1,
                names=("valve_deadband", "stiction"),
                cost=(1.1, 1.2),
                preference=np.array([[0.5, 0.83], [0.17, 0.5]]),
            ),
        ),
        traces=(
            trace(recording, "knee_position", "rad", 0),
            trace(recording, "knee_pressure_a", "Pa", 1),
        ),
        nuisances=(),
        next_experiment=Proposal(
            name="slow sine, 1 Hz",
            description="command slow sine, 1 Hz",
            rivals=("valve_deadband", "stiction"),
            separation=5000.0,
            separation_now=3.0,
        )
        if rivals
        else None,
        notes=("walk: 3 samples are missing",),
        model="improved.xml",
    )
    return replace(result, **changes)


def parsed(path):
    """Fails on tags that are left open and on texts that are not escaped."""
    text = path.read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>\n")
    return text, ElementTree.fromstring(text.removeprefix("<!DOCTYPE html>\n"))


def words(root):
    return re.sub(r"\s+", " ", "".join(root.find(f"{SPACE}body").itertext()))


@pytest.mark.parametrize(
    ("verdict", "told"),
    [
        ("named", "The simulation is missing: valve deadband at knee_valve."),
        ("confusion_set", "do not pin down: valve deadband or stiction at knee_valve."),
        ("partial", "is missing valve deadband at knee_valve, and more that has no name yet."),
        ("unexplained", "no known effect explains it."),
        ("nothing_missing", "Nothing is missing that these recordings could show."),
    ],
)
def test_every_verdict_has_its_page(tmp_path, verdict, told):
    text, root = parsed(write_page(diagnosis(verdict), tmp_path, model="knee_bench"))
    page = words(root)
    assert told in page
    titles = [term.text for term in root.iter(f"{SPACE}dt")]
    assert titles[:4] == ["What was looked at", "What is missing", "How sure", "What it costs"]
    assert titles[4:] == ["Where", "What cannot be told", "Next experiment"]
    assert "Backlash at knee: needs reversals." in page
    assert ("slow sine" in page) == (verdict == "confusion_set")
    assert ("Fitted: lap 0.05 (95 %: 0.04 to 0.06), in the model 0.02." in page) == (
        verdict in ("named", "confusion_set", "partial")
    )
    assert not re.search(r"(src|href)=\"(https?:)?//", text)


def test_the_page_holds_the_figures_that_lie_beside_it(tmp_path):
    result = diagnosis()
    _, root = parsed(write_page(result, tmp_path, model="knee_bench"))
    images = list(root.iter(f"{SPACE}img"))
    files = {p.read_bytes() for p in (tmp_path / "figures").glob("*.png")}
    inline = {base64.b64decode(i.get("src").removeprefix("data:image/png;base64,")) for i in images}
    assert inline == files
    assert [p.name for p in pictures(result)] == [
        "gap",
        "ranking",
        "rivals",
        "residual_state_1_knee_position",
        "residual_time_1_knee_position",
        "residual_state_2_knee_pressure_a",
        "residual_time_2_knee_pressure_a",
    ]
    told = [i.get("alt") for i in images]
    assert "walk: 14.2 before, 1.1 after." in told[0]
    assert "valve_deadband beats stiction in 83%." in told[2]
    assert all(told)


def test_every_effect_with_parameters_and_onset_is_told(tmp_path):
    effects = (effect(), effect("payload", "shank", onset=(("walk", 4.2),)))
    _, root = parsed(write_page(diagnosis(effects=effects), tmp_path, model="knee_bench"))
    page = words(root)
    assert "missing: valve deadband at knee_valve and payload at shank." in page
    assert "Payload begins at 4.20 s of walk." in page
    table = next(root.iter(f"{SPACE}table"))
    cells = [[cell.text or "" for cell in row] for row in table.iter(f"{SPACE}tr")]
    assert [row[0] for row in cells[1:]] == ["valve_deadband", "payload"]


def test_hostile_names_are_shown_and_do_nothing(tmp_path):
    found = effect(HOSTILE, HOSTILE, rivals=(HOSTILE,))
    result = diagnosis(
        effects=(found,),
        recording=HOSTILE,
        ranking=(Rank(name=HOSTILE, element=HOSTILE, round=1, gain=90.0, threshold=25.0),),
        traces=(trace(HOSTILE, f"{HOSTILE}/../../x_position", "rad", 0),),
        notes=(HOSTILE,),
        model="improved.xml",
    )
    text, root = parsed(write_page(result, tmp_path, model=HOSTILE))
    assert not list(root.iter(f"{SPACE}script"))
    assert "<script" not in text
    assert "<script>alert('1')</script> & \"$\\frac\" \ufffd" in words(root)
    assert all(re.fullmatch(r"\w+\.png", p.name) for p in (tmp_path / "figures").iterdir())
    assert sorted(p.name for p in tmp_path.iterdir()) == ["diagnosis.html", "figures"]


def test_a_diagnosis_without_evidence_still_has_a_page(tmp_path):
    nan = float("nan")
    result = diagnosis(
        "nothing_missing",
        where=(),
        not_testable=(),
        ranking=(),
        rivals=(),
        traces=(),
        notes=(),
        recordings=(
            RecordingGap(name="walk", held_out=False, before=nan, baseline=nan, after=nan),
        ),
        gap=Gap(before=nan, baseline=nan, after=nan, held_out=()),
        ceiling=None,
    )
    _, root = parsed(write_page(result, tmp_path, model="knee_bench"))
    assert not list(root.iter(f"{SPACE}img"))
    assert "off by unknown noise levels" in words(root)


def test_figures_of_an_earlier_diagnosis_do_not_stay(tmp_path):
    write_page(diagnosis(), tmp_path, model="knee_bench")
    write_page(diagnosis(rivals=(), traces=()), tmp_path, model="knee_bench")
    assert {p.name for p in (tmp_path / "figures").iterdir()} == {"gap.png", "ranking.png"}


def test_gap_figure_shows_each_recording_at_its_values():
    axes = pictures(diagnosis())[0].figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["walk *", "slow"]
    marks = [line.get_xdata()[0] for line in axes.lines if line.get_marker() == "o"]
    assert marks == [14.2, 1.1, 9.0, 1.0]
    low, high = axes.get_xlim()
    assert low < 1.0
    assert high > 14.2


def test_residuals_keep_one_scale_unless_they_shrink_much():
    alike = trace("walk", "knee_position", "rad", 0)
    same = replace(alike, after=0.5 * alike.before)
    for made, shared in ((same, True), (alike, False)):
        figure = pictures(diagnosis(ranking=(), rivals=(), traces=(made,)))[1].figure
        top, bottom = figure.axes[0], figure.axes[3]
        assert (top.get_ylim() == bottom.get_ylim()) is shared
        assert ("finer" in bottom.get_title("left")) is not shared
    assert top.get_ylabel() == "error [mrad]"


def test_no_line_is_drawn_over_missing_windows():
    whole = trace("walk", "knee_position", "rad", 0)
    kept = np.r_[0:20, 40:60]
    fields = ("time", "position", "velocity", "pressure", "before", "after")
    cut = replace(whole, **{f: getattr(whole, f)[kept] for f in fields})
    figure = pictures(diagnosis(traces=(cut,)))[-1].figure
    drawn = figure.axes[0].lines[0].get_xdata()
    assert np.flatnonzero(np.isnan(drawn)).tolist() == [20]


def test_costs_are_told_in_units_of_the_held_out_recording():
    result = diagnosis()
    told = " ".join(sections(result, "m")[3].lines)
    before = np.sqrt(np.mean(result.traces[0].before ** 2)) * 1e3
    assert f"knee position {number(float(before))} mrad, then" in told
    assert "99 % of the gap is closed" in told


def test_numbers_are_short():
    values = (2826.7, 0.9664, 495.2, 1.7e-13, np.inf)
    assert [number(v) for v in values] == ["2,830", "0.966", "495", "1.7e-13", "unknown"]


def test_long_names_are_cut_in_the_middle():
    assert short("walk.parquet") == "walk"
    assert short("0123456789_abcdefghij", 10) == "01234…ghij"


def test_ends_of_a_narrow_interval_differ():
    narrow = Estimate(
        name="lap", unit="kg", value=0.049998, nominal=0.02, interval=(0.049991, 0.050005)
    )
    assert parameter_words(narrow) == ("0.049998 kg", "0.049991 to 0.050005 kg", "0.02 kg")


def test_overwrite_replaces_a_diagnosis_and_nothing_else(tmp_path, capsys):
    (tmp_path / "letter.txt").write_text("mine")
    arguments = ["diagnose", "knee_bench", str(tmp_path / "none.csv"), "--out", str(tmp_path)]
    with pytest.raises(SystemExit):
        main([*arguments, "--overwrite"])
    assert "holds no diagnosis.json: it is left as it is" in " ".join(
        capsys.readouterr().err.split()
    )
    (tmp_path / "diagnosis.json").write_text(json.dumps({}))
    with pytest.raises(SystemExit):
        main([*arguments, "--overwrite"])
    assert "holds no" not in (told := capsys.readouterr().err)
    assert "none.csv" in told.replace("\n", "")
    assert (tmp_path / "letter.txt").read_text() == "mine"
