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
    Estimate,
    Gap,
    NotTestable,
    Rank,
    RecordingGap,
    Where,
)
from leglab.diagnosis.verdict.output import summary_lines, summary_tables
from leglab.report.diagnosis.figures import pictures, short
from leglab.report.diagnosis.page import write_page
from leglab.report.diagnosis.words import (
    facts,
    headline,
    improved_words,
    sections,
)
from leglab.report.page.wording import number
from tests.helpers.made_up_diagnosis import (
    CALIBRATION,
    diagnosis,
    effect,
    left,
    section,
    trace,
    whole,
)

HOSTILE = "<script>alert('1')</script> & \"$\\frac\" \x00"


SPACE = "{http://www.w3.org/1999/xhtml}"

# Most figures need them; what a page says in words does not.
NOT_DRAWN = {"traces": (), "whole": None}


def parsed(path):
    """Fails on tags that are left open and on texts that are not escaped."""
    text = path.read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>\n")
    return text, ElementTree.fromstring(text.removeprefix("<!DOCTYPE html>\n"))


def picture(result, name):
    return next(p for p in pictures(result) if p.name == name)


def words(root):
    return re.sub(r"\s+", " ", "".join(root.find(f"{SPACE}body").itertext()))


def told_sure(verdict):
    return verdict in ("named", "confusion_set")


@pytest.mark.parametrize(
    ("verdict", "told"),
    [
        ("named", "The simulation is missing: valve deadband at knee_valve."),
        ("confusion_set", "do not pin down: valve deadband or stiction at knee_valve."),
        ("unexplained", "no known effect explains it."),
        ("nothing_missing", "Nothing is missing that these recordings could show."),
    ],
)
def test_every_verdict_has_its_page(tmp_path, verdict, told):
    text, root = parsed(write_page(diagnosis(verdict), tmp_path, model="knee_bench"))
    page = words(root)
    assert told in page
    main = root.find(f".//{SPACE}main")
    titles = [term.text for term in main.iter(f"{SPACE}dt")]
    sure = "Left" if verdict == "nothing_missing" else "How sure"
    assert titles[:2] == ["Missing", sure]
    titles = titles[titles.index("What was looked at") :]
    second = "What was tried" if verdict == "unexplained" else "How sure"
    assert titles[:4] == ["What was looked at", "What is missing", second, "What is left"]
    assert titles[4:] == ["Where", "What cannot be told", "Next experiment"]
    assert "Backlash at knee: needs reversals." in page
    assert ("slow sine" in page) == (verdict == "confusion_set")
    assert ("Fitted: lap 0.05 (95 %: 0.04 to 0.06), in the model 0.02." in page) == (
        told_sure(verdict)
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
        "overlay",
        "whole",
        "gap",
        "ranking",
        "rivals",
        "residual_state_1_knee_position",
        "residual_time_1_knee_position",
        "residual_state_2_knee_pressure_a",
        "residual_time_2_knee_pressure_a",
    ]
    told = [i.get("alt") for i in images]
    assert "walk: 14.2 before, 1.1 after." in told[2]
    assert "valve_deadband beats payload + stiction with 83%." in told[4]
    assert all(told)


def test_a_whole_recording_is_drawn_first_and_told_in_numbers(tmp_path):
    result = diagnosis()
    drawn = picture(result, "whole")
    assert "RMS error of knee: 50 \u2192 2 mrad." in drawn.caption
    assert "standard deviation: 30 \u2192 1 %." in drawn.caption
    curves = [axes.get_lines() for axes in drawn.figure.axes]
    assert curves[0][0].get_xdata()[0] == 0.0
    away = [np.mean(line.get_ydata()) for line in curves[1] if line.get_color() != "#c8c8c8"][-2:]
    assert away == pytest.approx([50.0, -2.0])
    text, _ = parsed(write_page(result, tmp_path, model="knee_bench"))
    places = [text.index(f'alt="{start}') for start in ("Measured over", "Whole rec", "Replay err")]
    assert places == sorted(places)
    told = json.loads(json.dumps(result.to_json()))["whole"]
    assert told == {
        "recording": "walk",
        "joint": "knee",
        "unit": "rad",
        "before": 0.05,
        "after": 0.002,
        "correction_before": 0.3,
        "correction_after": 0.01,
    }


def test_a_whole_recording_that_blew_up_is_not_told_as_a_number():
    gone = np.full(5000, np.nan)
    result = diagnosis(whole=whole(before=gone))
    assert "RMS error of knee: beyond bounds \u2192 2 mrad." in picture(result, "whole").caption
    assert result.to_json()["whole"]["before"] is None
    for changes in ({"whole": whole(after=gone)}, {"whole": None}):
        names = [p.name for p in pictures(diagnosis(**changes))]
        assert "whole" not in names
    assert diagnosis(whole=None).to_json()["whole"] is None


def test_every_effect_with_parameters_and_onset_is_told(tmp_path):
    effects = (effect(), effect("payload", "shank", onset=(("walk", 4.2),)))
    _, root = parsed(write_page(diagnosis(effects=effects), tmp_path, model="knee_bench"))
    page = words(root)
    assert "missing: valve deadband at knee_valve and payload at shank." in page
    assert "Payload begins at 4.20 s of walk." in page
    table = next(root.iter(f"{SPACE}table"))
    cells = [[cell.text or "" for cell in row] for row in table.iter(f"{SPACE}tr")]
    assert [row[0] for row in cells[1:]] == ["valve deadband", "payload"]


def test_hostile_names_are_shown_and_do_nothing(tmp_path):
    found = effect(HOSTILE, HOSTILE, rivals=(HOSTILE,))
    result = diagnosis(
        effects=(found,),
        recording=HOSTILE,
        ranking=(Rank(name=HOSTILE, element=HOSTILE, gain=90.0),),
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
        remaining=(),
        whole=None,
    )
    _, root = parsed(write_page(result, tmp_path, model="knee_bench"))
    assert not list(root.iter(f"{SPACE}img"))
    assert "off by unknown noise levels" in words(root)


def test_figures_of_an_earlier_diagnosis_do_not_stay(tmp_path):
    write_page(diagnosis(), tmp_path, model="knee_bench")
    write_page(diagnosis(rivals=(), traces=(), whole=None), tmp_path, model="knee_bench")
    assert {p.name for p in (tmp_path / "figures").iterdir()} == {"gap.png", "ranking.png"}


def test_gap_figure_shows_each_recording_at_its_values():
    axes = picture(diagnosis(), "gap").figure.axes[0]
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
        figure = picture(diagnosis(traces=(made,)), "residual_state_1_knee_position").figure
        top, bottom = figure.axes[0], figure.axes[3]
        assert (top.get_ylim() == bottom.get_ylim()) is shared
        assert ("finer" in bottom.get_title("left")) is not shared
    assert top.get_ylabel() == "error [mrad]"


def test_each_window_has_a_line_of_its_own():
    """Windows may overlap, or be missing: no line leads from one to the next."""
    whole = trace("walk", "knee_position", "rad", 0)
    figure = pictures(diagnosis(traces=(whole,)))[-1].figure
    drawn = figure.axes[0].lines[0].get_xdata()
    count, bins = whole.time.size, whole.bins
    assert count > bins > 1
    assert np.isnan(drawn).sum() == count // bins - 1
    assert np.isnan(drawn[bins :: bins + 1]).all()


def table(path, caption):
    """Cells of a table of the page, by its caption."""
    _, root = parsed(path)
    for found in root.iter(f"{SPACE}table"):
        if caption in "".join(found.find(f"{SPACE}caption").itertext()):
            return [["".join(c.itertext()) for c in row] for row in found.iter(f"{SPACE}tr")]
    raise AssertionError(f"no table {caption!r}")


def test_what_is_missing_how_sure_and_how_much_is_left_come_first(tmp_path):
    told = dict(facts(diagnosis()))
    assert told["Missing"] == (
        "Valve deadband at knee_valve: lap 0.05 (95 %: 0.04 to 0.06), in the model 0.02."
    )
    assert told["How sure"] == "91 % that the name is right."
    assert told["Explains"] == "99 % of the error beyond sensor noise on walk."
    assert told["Left"].startswith(
        "After 0.3 s of simulation: knee position 2.4 mrad off (before 24 mrad, sensor noise 0.12"
    )
    assert "knee pressure a 0.4 bar off (before 4 bar, sensor noise 0.02 bar)" in told["Left"]
    page = words(parsed(write_page(diagnosis(), tmp_path, model="m"))[1])
    places = [page.index(text) for text in (*told.values(), "What was looked at")]
    assert places == sorted(places)


def test_the_first_figure_lays_measured_over_simulated():
    result = diagnosis()
    shown = pictures(result)[0]
    made = result.traces[0]
    ends = np.abs(made.before.reshape(-1, 6)[:, -1])
    # Worst and median window by the first channel's error at the end; two channels, three windows.
    for place, window in ((0, int(np.argmax(ends))), (1, int(np.argsort(ends)[5]))):
        axes = shown.figure.axes[place]
        part = slice(6 * window, 6 * window + 6)
        drawn = [line.get_ydata() for line in axes.lines]
        measured = 1e3 * (made.measured[part] - made.measured[part][0])
        assert np.allclose(drawn[0], measured)
        assert np.allclose(drawn[1], measured - 1e3 * made.before[part])
        assert np.allclose(drawn[2], measured - 1e3 * made.after[part])
        assert f"{made.time[part][0]:.1f} s" in axes.get_title("left")
    assert shown.figure.axes[0].get_ylabel() == "position [mrad]"
    assert "0.3 s from the measured motion and pressures, driven by" in shown.caption
    # A bin has 50 ms: pressures have moved by the first point.
    assert "Points are means over 50 ms" in shown.caption
    assert "that no fit has seen" in shown.caption


def test_a_start_without_measured_pressures_is_not_told_as_one_with_them(tmp_path):
    made = trace("walk", "knee_position", "rad", 0)
    result = diagnosis(traces=(made,), remaining=(left("knee_position", "rad", 0.024),))
    text, root = parsed(write_page(result, tmp_path, model="m"))
    assert "after a start from the measured motion, RMS" in words(root)
    assert "motion and pressures," not in text


def test_tables_and_figures_have_the_recordings_in_one_order(tmp_path):
    names = ("fast", "walk", "slow")
    rows = tuple(
        RecordingGap(name=n, held_out=n == "walk", before=b, baseline=b, after=1.0)
        for n, b in zip(names, (3.0, 9.0, 20.0), strict=True)
    )
    # The largest errors of the two channels are in different recordings.
    traces = tuple(
        replace(made, before=made.before * (9.0 if name == worst else 1.0))
        for channel, worst in (("knee_position", "slow"), ("hip_position", "fast"))
        for name in names
        for made in (trace(name, channel, "rad", 0),)
    )
    result = diagnosis(recordings=rows, traces=traces, whole=None)
    wanted = ["walk", "fast", "slow"]
    drawn = [p for p in pictures(result) if p.name == "gap" or p.name.startswith("residual_time")]
    labels = [[t.get_text() for t in drawn[0].figure.axes[0].get_yticklabels()]]
    labels += [[axes.get_ylabel() for axes in p.figure.axes[1::2]] for p in drawn[1:]]
    assert labels == [["walk *", "fast", "slow"]] * 3
    page = write_page(result, tmp_path, model="m")
    assert [row[0] for row in table(page, "noise alone gives")[1:]] == wanted
    assert "3 recordings: walk, fast and slow." in words(parsed(page)[1])


def test_flows_are_told_in_units_that_a_person_reads(tmp_path):
    flow = Estimate(
        name="rated_flow", unit="m^3/s", value=1.25e-4, nominal=1.1e-4, interval=(1.2e-4, 1.3e-4)
    )
    leak = Estimate(
        name="internal_leakage",
        unit="m^3/s/Pa",
        value=1.7e-12,
        nominal=1.7e-13,
        interval=(1.5e-12, 2e-12),
    )
    found = replace(effect(), parameters=(flow, leak))
    result = diagnosis(effects=(found,), **NOT_DRAWN)
    told = dict(facts(result))["Missing"]
    assert "rated flow 125 cm^3/s (0.000125 m^3/s) (95 %: 120 to 130 cm^3/s)" in told
    assert "internal leakage 0.17 cm^3/s/bar (1.7e-12 m^3/s/Pa)" in told
    rows = table(write_page(result, tmp_path, model="m"), "Missing effects")
    assert rows[1][2:7] == ["rated flow", "cm^3/s", "125", "120 to 130", "110"]


def test_captions_hold_in_the_dark_where_figures_are_inverted():
    told = " ".join(p.caption for p in pictures(diagnosis()))
    assert not re.search(r"\b(black|white|dark|darker|light)\b", told)


def test_an_effect_that_is_not_told_apart_from_itself_elsewhere_says_so():
    result = diagnosis(effects=(effect("payload", "shank", rivals=("payload", "stiction")),))
    assert "Payload is not told apart from the same at another place or stiction." in section(
        result, "How sure"
    )


def test_a_channel_alone_shows_its_error_below():
    made = trace("walk", "knee_position", "rad", 0)
    figure = pictures(diagnosis(traces=(made,), remaining=()))[0].figure
    window = int(np.argmax(np.abs(made.before.reshape(-1, 6)[:, -1])))
    below = figure.axes[len(figure.axes) // 2]
    drawn = below.lines[1].get_ydata()
    assert np.allclose(drawn, -1e3 * made.before[6 * window : 6 * window + 6])
    assert "simulated less" in below.get_ylabel()


def test_recordings_of_the_fit_are_not_in_the_first_figure():
    seen = replace(trace("slow", "knee_position", "rad", 5), measured=np.full(60, 7.0))
    both = diagnosis(traces=(trace("walk", "knee_position", "rad", 0), seen))
    alone = diagnosis(traces=(trace("walk", "knee_position", "rad", 0),))
    assert pictures(both)[0].alt == pictures(alone)[0].alt


@pytest.mark.parametrize(
    ("verdict", "told"),
    [
        ("named", "Changed since the healthy recordings: valve deadband at knee_valve."),
        (
            "confusion_set",
            "healthy recordings, one of these: valve deadband or stiction at knee_valve.",
        ),
        ("unexplained", "has changed since the healthy recordings, and no known effect explains"),
        ("nothing_missing", "Nothing has changed since the healthy recordings that these could"),
    ],
)
def test_healthy_recordings_tell_what_changed_since(tmp_path, verdict, told):
    result = diagnosis(verdict, calibration=CALIBRATION, **NOT_DRAWN)
    assert told in headline(result)
    assert "calm 30, calibrated 4" in section(result, "The specimen before")
    page = write_page(result, tmp_path, model="m")
    assert table(page, "error in the healthy recordings")[1] == ["calm", "30", "4"]
    assert table(page, "differs most")[1][2:] == ["pressure", "205 bar", "210 bar"]
    changed = section(result, "What changed since")
    # The specimen's own value was calibrated, whatever the model has.
    assert ("before" in changed, "in the model" in changed) == (bool(result.effects), False)
    assert not result.effects or "before" in table(page, "What changed")[0]


def test_figures_of_effects_alone_and_of_sets_have_a_row_each():
    result = diagnosis()
    (alone,) = picture(result, "ranking").figure.axes
    assert [t.get_text() for t in alone.get_yticklabels()] == [
        "valve deadband, knee_valve",
        "stiction, knee_valve",
    ]
    assert [line.get_xdata()[0] for line in alone.lines if len(line.get_xdata()) == 1] == [900, 300]
    (sets,) = picture(result, "rivals").figure.axes
    rows = [t.get_text() for t in sets.get_yticklabels()]
    assert rows == ["valve deadband  1", "payload + stiction  2", "nothing  3"]
    assert [t.get_text() for t in sets.texts] == ["83", "100", "17", "100", "0", "0"]


def test_a_value_that_says_little_is_called_uncertain(tmp_path):
    wide = Estimate(name="armature", unit="kg m^2", value=1.9, nominal=0.1, interval=(0.0, 11.9))
    result = diagnosis(
        effects=(replace(effect("armature", "knee"), parameters=(wide,)),), **NOT_DRAWN
    )
    assert "Uncertain, check before use: armature of armature at knee 1.9" in improved_words(result)
    assert "95 %: 0 to 11.9 kg m^2, uncertain" in dict(facts(result))["Missing"]
    page = words(parsed(write_page(result, tmp_path, model="m"))[1])
    assert "ncertain, check before use" in page
    assert "ready to run" not in page
    assert "ncertain" not in improved_words(diagnosis())


def test_many_effects_that_cannot_be_told_are_one_sentence_and_a_table(tmp_path):
    many = tuple(
        NotTestable(name=f"effect_{i}", element="knee", reason="needs x") for i in range(6)
    )
    result = diagnosis(not_testable=many, notes=("walk: 3 samples are missing",))
    lines = next(s for s in sections(result, "m") if s.title == "What cannot be told").lines
    assert len(lines) == 2
    assert "effect 4 at knee or effect 5 at knee; the table below" in lines[0]
    assert lines[1] == "walk: 3 samples are missing."
    page = write_page(result, tmp_path, model="m")
    assert len(table(page, "hardly show")) == 7


def test_where_is_told_without_pressures():
    place = Where(
        residual="motion", element="slide", level=40.0, region="near zero velocity (-1 to 1 m/s)"
    )
    told = section(diagnosis(where=(place,)), "Where")
    assert (
        "Motion of slide, replayed from the measured command: 40 noise levels, worst near zero"
        in told
    )
    lines = summary_lines(diagnosis(where=(place,)))
    assert (
        lines[0]
        == "motion of slide: 40 noise levels off as it was, worst near zero velocity (-1 to 1 m/s)"
    )


def test_tables_of_the_terminal_have_units():
    head, rest, gaps = summary_tables(diagnosis())
    assert list(rest.columns[1].cells) == ["24 mrad", "4 bar"]
    assert list(rest.columns[3].cells) == ["0.12 mrad", "0.02 bar"]
    assert list(head.columns[1].cells) == [r"lap \[1]"]
    assert gaps.row_count == 2
    assert len(summary_tables(diagnosis("nothing_missing", remaining=()))) == 1
    # What an effect departs from is the model, or the specimen in its healthy recordings.
    for known, told in ((None, "model"), (CALIBRATION, "before")):
        (first, *_) = summary_tables(diagnosis(calibration=known))
        assert first.columns[-1].header == told


def test_numbers_are_short():
    values = (2826.7, 0.9664, 495.2, 1.7e-13, np.inf)
    assert [number(v) for v in values] == ["2,830", "0.966", "495", "1.7e-13", "unknown"]


def test_long_names_are_cut_in_the_middle():
    assert short("walk.parquet") == "walk"
    assert short("0123456789_abcdefghij", 10) == "01234…ghij"


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


def test_of_several_effects_each_stands_on_a_line_of_its_own(tmp_path):
    one = diagnosis(**NOT_DRAWN)
    other = replace(one.effects[0], name="valve_bias")
    several = replace(one, effects=(*one.effects, other))
    told = dict(facts(several))
    first, second = told["Missing"].split("\n")
    assert first.startswith("Valve deadband at knee_valve: lap 0.05")
    assert first.endswith(";")
    assert second.startswith("valve bias [valve null shift] at knee_valve: lap 0.05")
    _, root = parsed(write_page(several, tmp_path, model="m"))
    lines = ["".join(line.itertext()) for line in root.iter(f"{SPACE}span")]
    assert {first, second} <= set(lines)
