"""Report and index without a browser: words, escaping, half runs, size."""

import base64
import json
import re
from dataclasses import replace

import imageio_ffmpeg
import numpy as np
import pytest

from leglab.base.errors import LeglabError
from leglab.base.settings import documented_units
from leglab.causes.fault_names import FaultEvent, FaultName
from leglab.control import controller_summary
from leglab.control.contract import CONTROLLERS
from leglab.controllers import controller_names
from leglab.references import reference_names
from leglab.references.base import REFERENCES
from leglab.report.page.shell import inline_json
from leglab.report.page.wording import capital
from leglab.report.run import page as page_module
from leglab.report.run.page import page, write_report
from leglab.report.run.plots import plot_data
from leglab.report.run.tables import run_table, setting_tables
from leglab.report.run.words import change_words, headline, sections
from leglab.runs.folder import read_runs
from leglab.runs.record import ChangeRecord
from tests.helpers.report_folders import HOSTILE, Elements, write_folder


def story(runs, title):
    found = next(s for s in sections(runs) if s.title == title)
    names = found.names or [""] * len(found.lines)
    return [f"{name} {line}".strip() for name, line in zip(names, found.lines, strict=True)]


def curves(name, runs, joints):
    """The curves of a plot, of each of these joints."""
    return next(p["traces"] for p in plot_data(runs, joints, 0)["plots"] if p["name"] == name)


def test_the_better_controller_is_named_with_exact_numbers(tmp_path):
    runs = read_runs(
        [
            write_folder(tmp_path / "a", "pd", before=0.020, after=0.040),
            write_folder(
                tmp_path / "b", "bsnn_arx", after=0.010, before=0.004, damage=0.024, t90=1.2
            ),
        ]
    )
    assert headline(runs) == (
        "In the last 2 s, bsnn_arx tracked best: 10 mrad RMS error; pd 40 mrad."
    )
    assert story(runs, "What was tested") == [
        "Scenario seal_wear on the model leg with 2 driven joints; reference walking_stride, "
        "10 s, seed 0.",
        "At 5 s: internal leakage of all elements \u00d7 10, at once.",
    ]
    pd, bsnn = story(runs, "What happened")
    assert pd.startswith(
        "pd: RMS error 20 mrad in the 2 s before the change, 40 mrad in the 5 s after it, 40 mrad "
        "in the last 2 s, at most 56.6"
    )
    assert (
        "The change raises the error by 20 mrad in the worst stride; nothing of that is undone in "
        "the last 2 s." in pd
    )
    assert (
        "With adaptation stopped just before it, the change would raise the error by 24 mrad; 75 % "
        "of that is undone in the last 2 s, 90 % of it 1.20 s after the change." in bsnn
    )
    assert "The supply gave 500 J in the 5 s after the change, 100 W on average." in bsnn
    assert story(runs, "Verdict") == [
        "bsnn_arx follows the reference 4 times as closely as pd: 10 mrad against 40 mrad RMS "
        "error in the last 2 s.",
        "Of the accuracy that the change costs, bsnn_arx wins back 75 % and pd wins back nothing.",
        "Of these, bsnn_arx is the one for a machine that changes like this.",
    ]
    assert story(runs, "The controllers") == [
        f"{name}: {capital(controller_summary(name))}." for name in ("pd", "bsnn_arx")
    ]


def test_settings_have_units_and_energy_and_power_one_span(tmp_path):
    (run,) = read_runs([write_folder(tmp_path / "a", "bsnn_arx")])
    table = run_table([run])
    shown = dict(zip(table.head, table.rows[0], strict=True))
    assert (shown["energy, after [J]"], shown["power, after [W]"]) == ("500", "100")
    names = {row[0]: row[1] for part in setting_tables([run]) for row in part.rows}
    assert names["duration [s]"] == "10"
    assert names["sensors: control period [s]"] == "0.004"
    assert names["severity (internal leakage ratio)"] == "10"
    change = ChangeRecord(
        parameter="oil_temperature", element="*", kind="set", value=0.0, start=1.0
    )
    assert change_words(change) == "oil temperature of all elements = 0 \u00b0C"
    # A joint alone stands for its cylinder, spring and encoder.
    alone = change.model_copy(update={"element": "knee,knee_*"})
    assert change_words(alone) == "oil temperature of knee = 0 \u00b0C"


def test_what_a_controller_named_while_it_ran_is_told(tmp_path):
    (run,) = read_runs([write_folder(tmp_path / "a", "bsnn_arx")])
    assert "What was named while it ran" not in {part.title for part in sections([run])}
    name = FaultName(
        time=10.2, onset=10.0, fault="seal_wear", element="knee", size=9.6, low=8.4, high=10.8,
        meaning="internal leakage ratio", confidence=0.93, explained=0.9,
    )  # fmt: skip
    metrics = run.metrics.model_copy(update={"events": [FaultEvent(names=[name])]})
    (part,) = (
        p
        for p in sections([replace(run, metrics=metrics)])
        if p.title == "What was named while it ran"
    )
    assert part.lines == (
        "knee: seal_wear [internal_leakage] 9.6 (8.4 to 10.8; internal leakage ratio), 93 %, "
        "since 10.00 s, said at 10.20 s.",
    )
    gone = FaultEvent(names=[name.model_copy(update={"size": None})], withdrawn=11.0)
    assert gone.told().endswith("said at 10.20 s, withdrawn at 11.00 s")
    assert "9.6" not in gone.told()


@pytest.mark.parametrize("name", [*controller_names(), *reference_names()])
def test_units_of_settings_are_read_from_their_docs(name):
    registry = CONTROLLERS if name in controller_names() else REFERENCES
    configuration = registry.get(name).configuration
    units = documented_units(configuration)
    assert units.keys() <= configuration.model_fields.keys()
    assert "," not in "".join(units.values())
    assert units
    assert units.get("memory") != "1"


def test_a_worse_controller_is_called_worse(tmp_path):
    runs = read_runs(
        [
            write_folder(tmp_path / "a", "pd", after=0.030),
            write_folder(tmp_path / "b", "arx", after=0.045),
            write_folder(tmp_path / "c", "frozen", after=0.0306),
        ]
    )
    assert headline(runs).startswith("In the last 2 s, pd tracked best")
    assert story(runs, "Verdict") == [
        "arx follows the reference less closely than pd: 45 mrad against 30 mrad RMS error in the "
        "last 2 s.",
        "frozen follows the reference about as closely as pd: 30.6 mrad against 30 mrad RMS error "
        "in the last 2 s.",
        "Of the accuracy that the change costs, pd, arx and frozen win back nothing.",
    ]
    alike = (runs[0], runs[2])
    assert "no controller is clearly better" in headline(alike)


def test_a_fallback_is_admitted(tmp_path):
    (often,) = read_runs([write_folder(tmp_path / "a", "bsnn_arx", fallback=0.25)])
    (never,) = read_runs([write_folder(tmp_path / "b", "bsnn_arx", fallback=0.0)])
    (told,) = story([often], "What happened")
    found = re.search(r"stood in for what it had learned ([\d.]+) % of the time before", told)
    assert float(found.group(1)) == pytest.approx(25.0, abs=0.5)
    assert "What it had learned was in use all the time." in story([never], "What happened")[0]
    assert "never fell back" not in "".join(Elements(page([never])).texts)


def test_a_run_that_stopped_is_reported_as_far_as_it_came(tmp_path):
    runs = read_runs(
        [
            write_folder(tmp_path / "a", "pd"),
            write_folder(tmp_path / "b", "arx", stopped=3.0),
        ]
    )
    assert headline(runs) == (
        "In the last 2 s, only pd came to the end: 30 mrad RMS error; arx stopped early."
    )
    assert story(runs, "What happened")[1].startswith(
        "arx: Stopped at 3.00 s of 10 s: the knee blew up. What follows holds as far as it came."
    )
    assert story(runs, "Verdict") == [
        "arx stopped early: it is not judged.",
        "Of the accuracy that the change costs, pd wins back nothing.",
    ]
    text = page(runs)
    assert "stopped early" in text
    assert read_runs([tmp_path / "b"])[0].last.name == "before"
    assert page(read_runs([tmp_path / "b"]))


def test_runs_that_differ_are_not_compared(tmp_path):
    runs = read_runs(
        [write_folder(tmp_path / "a", seed=0), write_folder(tmp_path / "b", seed=1, after=0.5)]
    )
    assert [run.label for run in runs] == ["pd, seed 0", "pd, seed 1"]
    assert "differ in seed" in story(runs, "What was tested")[0]
    assert not [s for s in sections(runs) if s.title == "Verdict"]
    assert "%)" not in "".join(Elements(page(runs)).texts)


def test_runs_that_are_alike_keep_apart_by_their_folders(tmp_path):
    folders = [write_folder(tmp_path / name) for name in ("first", "second")]
    assert [run.label for run in read_runs(folders)] == ["pd, first", "pd, second"]
    with pytest.raises(LeglabError, match="given twice"):
        read_runs([folders[0], tmp_path / "second" / ".." / "first"])


def test_curves_keep_their_extremes_when_they_are_thinned(tmp_path):
    folder = write_folder(tmp_path / "a", duration=60.0, change=30.0, after=0.2)
    (run,) = read_runs([folder])
    deviation = curves("deviation", [run], run.joints)[1][0]
    values = np.frombuffer(base64.b64decode(deviation["y"]["bdata"]), "<f4")
    error = 1e3 * (run.recording["knee_truth"] - run.recording["knee_reference"])
    assert len(error) == 15000
    assert len(values) == 3000
    assert values.max() == pytest.approx(error.max(), rel=1e-3)
    assert values.min() == pytest.approx(error.min(), rel=1e-3)
    names = [plot["name"] for plot in plot_data([run], run.joints, 0)["plots"]]
    assert names == ["error", "deviation", "angle", "command", "pressure", "temperature"]


def test_hostile_names_are_shown_and_do_nothing(tmp_path):
    folder = write_folder(
        tmp_path / "<b>&",
        HOSTILE,
        scenario=HOSTILE,
        model=HOSTILE,
        joints=(HOSTILE, "knee"),
        stopped=8.0,
    )
    elements = Elements(page(read_runs([folder])))
    scripts = elements.all("script")
    assert [s.get("type") for s in scripts] == ["application/json", None, None, None]
    assert not elements.all("img")
    assert not [a for _, a in elements.tags if any(name.startswith("on") for name in a)]
    shown = HOSTILE.replace("\x00", "\ufffd")
    assert any(shown in text for text in elements.texts)
    (policy,) = [
        m["content"] for m in elements.all("meta") if "content" in m and "src" in m["content"]
    ]
    assert re.search(r"script-src( 'sha256-[^ ]+'){3};", policy)


def test_json_in_a_page_cannot_leave_its_element():
    text = inline_json({"name": "</script><!--\u2028&"})
    assert not re.search("[<>&\u2028]", text)
    assert json.loads(text) == {"name": "</script><!--\u2028&"}


def test_nothing_is_loaded_from_elsewhere(tmp_path):
    elements = Elements(page(read_runs([write_folder(tmp_path / "a")])))
    for _, attributes in elements.tags:
        for name in ("src", "href"):
            assert not re.match(r"\s*(\w+:)?//", attributes.get(name) or "")
    assert not elements.all("link")


def test_a_missing_film_is_said_on_the_page(tmp_path):
    def fails(path):
        raise LeglabError("no OpenGL library for egl; install one with: apt-get <this>")

    runs = read_runs([write_folder(tmp_path / "a")])
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.mp4").write_text("of an earlier report")
    written = write_report(runs, tmp_path / "out", filmer=fails)
    assert written.film is None
    assert "no OpenGL library" in written.why_no_film
    text = written.page.read_text()
    assert "No film: no OpenGL library for egl; install one with: apt-get &lt;this&gt;" in text
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["report.html"]


def test_a_film_that_is_too_large_is_encoded_anew_for_the_page(tmp_path, monkeypatch):
    def film(path):
        # Noise is what a codec can do least about.
        random = np.random.default_rng(0)
        writer = imageio_ffmpeg.write_frames(
            str(path), (320, 192), codec="libx264", output_params=["-crf", "10"]
        )
        writer.send(None)
        for _ in range(30):
            writer.send(random.integers(0, 255, (192, 320, 3), dtype=np.uint8).tobytes())
        writer.close()
        return path

    runs = read_runs([write_folder(tmp_path / "a")])
    most = len(page(runs)) + 400_000
    monkeypatch.setattr(page_module, "_LARGEST", most)
    monkeypatch.setattr(page_module, "_FILM_LEAST", 0)
    written = write_report(runs, tmp_path / "out", filmer=film)
    assert written.film.stat().st_size > 1e6  # it would not have fitted
    assert most - 390_000 < written.page.stat().st_size < most
    data = re.search(r'id="film-data">([^<]+)<', written.page.read_text()).group(1)
    assert base64.b64decode(data)[4:8] == b"ftyp"
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["report.html", "report.mp4"]


def test_twenty_seconds_of_three_runs_leave_room_for_a_film(tmp_path):
    joints = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")
    folders = [
        write_folder(tmp_path / n, n, duration=20.0, change=10.0, joints=joints) for n in "abc"
    ]
    assert len(page(read_runs(folders)).encode()) < 8e6


def test_references_that_differ_are_told_apart(tmp_path):
    folders = [write_folder(tmp_path / "a"), write_folder(tmp_path / "b", "arx", stopped=4.0)]
    runs = read_runs(folders)

    def names(of):
        return [trace["name"] for trace in curves("angle", of, ("hip",))[0]]

    assert names(runs) == ["reference", "pd", "arx"]
    assert names(runs[::-1]) == ["reference", "arx", "pd"]
    other = runs[1].recording.with_columns({"hip_reference": 0.0 * runs[1].recording.time})
    assert names((runs[0], replace(runs[1], recording=other))) == ["reference of pd", "pd", "arx"]


def test_runs_of_machines_with_other_joints_stand_on_one_page(tmp_path):
    leg = write_folder(tmp_path / "leg")
    bench = write_folder(tmp_path / "bench", "arx", model="axis.xml", joints=("knee", "axis"))
    runs = read_runs([leg, bench])
    angles = curves("angle", runs, ("hip", "knee", "axis"))
    shown = [[trace["name"] for trace in traces] for traces in angles]
    first, second = (run.label for run in runs)
    assert shown[0] == ["reference", first]
    assert [name for name in shown[1] if name in (first, second)] == [first, second]
    assert shown[2] == ["reference", second]
    assert len(Elements(page(runs)).all("table")) > 2
