"""The page of a sweep: its numbers are those of the rows, and what it says can be done."""

import base64
import html
import json
import re
import shlex
from itertools import pairwise
from pathlib import Path

import pytest
import typer

from leglab.base.errors import LeglabError
from leglab.cli.app import app
from leglab.report.film import render_film
from leglab.report.folder_index import write_index
from leglab.report.sweep.films import film_runs
from leglab.report.sweep.page import page, worst_runs, write_sweep_page
from leglab.runs.sweeps.engine import run_sweep
from leglab.runs.sweeps.plan import SweepPlan
from leglab.runs.sweeps.query import ask
from tests.cli.test_cli import leglab as command_line
from tests.helpers.report_folders import HOSTILE
from tests.helpers.sweep_folders import SIZES, middle, write_sweep
from tests.runs.test_sweeps import BENCH

COMMANDS = typer.main.get_command(app).commands


def tables(text):
    """Rows of the tables of a page by the beginning of their caption, as lists of text."""
    found = {}
    for table in re.findall(r"<table.*?</table>", text, re.DOTALL):
        table = re.sub(r'<a class="term"[^>]*>(.*?)</a>', r"\1", table)
        caption = html.unescape(re.search(r"<caption>(.*?)</caption>", table, re.DOTALL)[1])
        rows = re.findall(r"<tr>(.*?)</tr>", table, re.DOTALL)
        cells = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in rows]
        found.setdefault(caption, [[html.unescape(cell) for cell in row] for row in cells])
    return found


def test_heat_maps_show_medians_and_the_worst_runs_come_first(tmp_path):
    times = write_sweep(tmp_path / "s", failed=(4,))
    found = tables(page(tmp_path / "s"))
    heat = found["90 % undone after, s, by scenario with size and controller"]
    assert heat[0] == ["scenario, size", "bsnn_arx", "pd"]
    for row, size in zip(heat[1:], SIZES, strict=True):
        assert row[0] == f"seal_wear, {size:g}"
        for cell, controller in zip(row[1:], ("bsnn_arx", "pd"), strict=True):
            wanted = middle(times[controller, size])
            assert cell == ("never" if wanted is None else f"{wanted:.3g}")
    by_specimen = found["90 % undone after, s, by scenario with size and specimen (seed): pd"]
    assert by_specimen[1] == ["seal_wear, 3", "never", "0.3", "0.4"]
    assert by_specimen[2] == ["seal_wear, 25", "0.5", "\u2013", "never"]
    worst = found["The worst runs, by the share of the damage that is undone"]
    assert [row[0] for row in worst[1:4]] == ["11", "10", "9"]
    assert worst[2][-2:] == ["never", "80"]
    failed = next(rows for caption, rows in found.items() if caption.startswith("Runs that failed"))
    assert failed[1] == ["died", "no <b>figures</b> of pd", "4", "1"]
    numbers = next(rows for caption, rows in found.items() if caption.startswith("Medians over"))
    assert numbers[2][:4] == ["seal_wear", "pd", "6", "1"]


def test_the_headline_tells_controllers_apart(tmp_path):
    times = write_sweep(tmp_path / "s")
    text = html.unescape(re.search(r"<h1.*?>(.*?)</h1>", page(tmp_path / "s"))[1])
    assert "with damage" not in text  # all have
    wanted = {}
    for controller, first in (("pd", 0), ("bsnn_arx", 6)):
        own = [time for (name, _), found in times.items() if name == controller for time in found]
        share = 100 * (1 - 0.02 * (first + 2.5))
        never = f" ({own.count(None)} of 6 never)"
        wanted[middle(own)] = (
            f"{controller} undoes {share:.3g} % of the damage, nine tenths after "
            f"{middle(own):.3g} s{never}"
        )
    best, worse = (wanted[time] for time in sorted(wanted))
    assert text == f"12 runs; in the median {best}, {worse}"


def test_runs_without_damage_are_told_apart_from_those_that_never_undo_it(tmp_path):
    reason = "the change does no damage: it raises the error by less than a quarter"
    write_sweep(tmp_path / "s", failed=(4,), untold=dict.fromkeys((0, 1, 2), reason))
    text = page(tmp_path / "s")
    headline = html.unescape(re.search(r"<h1.*?>(.*?)</h1>", text)[1])
    assert headline.startswith("12 runs; 1 of them failed; in the median of the 8 with damage ")
    told = html.unescape(re.sub("<[^>]*>", "", text))
    assert f"3 runs (seal_wear, pd): {reason}." in told
    assert "1 runs (seal_wear, pd): it failed." in told
    heat = tables(text)["90 % undone after, s, by scenario with size and controller"]
    assert heat[1][2] == "\u2013"


def test_a_value_that_was_reached_is_no_never_and_values_that_are_alike_have_no_shade(tmp_path):
    write_sweep(tmp_path / "s")
    text = page(tmp_path / "s")
    start = text.index("<caption>90 % undone after, s, by scenario with size and specimen")
    table = text[start : text.index("</table>", start)]
    fields = re.findall(r'--shade: ([\d.]+)">([^<]*)<', table)
    never = [float(shade) for shade, value in fields if value == "never"]
    reached = [float(shade) for shade, value in fields if value != "never"]
    assert set(never) == {1.0}
    assert max(reached) == 0.6
    write_sweep(tmp_path / "one", ("pd",), untold=dict.fromkeys(range(3), "it is made up"))
    text = page(tmp_path / "one")
    start = text.index("<caption>undone at the end, %, by scenario with size and controller")
    assert "--shade" not in text[start : text.index("</table>", start)]


def test_settings_that_were_varied_have_a_table_and_a_curve(tmp_path):
    leakage = "parameters.internal_leakage"
    write_sweep(tmp_path / "s", ("pd",), more={leakage: [2e-13, 2e-12, 8e-12]})
    text = page(tmp_path / "s")
    title = "error at the end, mrad, by internal leakage [m^3/s/Pa]"
    table = tables(text)[title]
    assert table[0] == ["internal leakage [m^3/s/Pa]", "seal_wear, pd"]
    rows = ask(
        tmp_path / "s",
        "SELECT parameters_internal_leakage, 1e3 * median(end_rad) FROM runs GROUP BY 1 ORDER BY 1",
    ).rows
    assert table[1:] == [[f"{leak:.3g}", f"{error:.3g}"] for leak, error in rows]
    effect = text[text.index(f"<caption>{title}") :]
    (points,) = re.findall(r'<polyline points="([^"]*)"', effect.partition("</figure>")[0])
    places = [tuple(map(float, point.split(","))) for point in points.split()]
    high = rows[-1][1]
    assert [y for _, y in places] == pytest.approx([100 * (1 - e / high) for _, e in rows], abs=0.1)
    # Forty times as much, the middle ten times: an axis of decades.
    assert [x for x, _ in places] == pytest.approx([0.0, 62.4, 100.0], abs=0.1)
    close = [float(f"{2 + 0.05 * i:.3g}") * 1e-13 for i in range(8)]
    write_sweep(tmp_path / "close", ("pd",), more={leakage: close})
    texts = re.findall(r'<span style="left: ([\d.]+)%">', page(tmp_path / "close"))
    across = sorted({float(x) for x in texts})
    assert across[0] == 0.0
    assert min(b - a for a, b in pairwise(across)) > 14.0  # as wide as "2.05e-13"


def test_columns_that_no_run_fills_are_left_out_and_the_reason_told(tmp_path):
    reason = "a quarter of the run, 1 s, is less than a stride, 1.2 s"
    write_sweep(tmp_path / "s", untold=dict.fromkeys(range(12), reason))
    text = page(tmp_path / "s")
    caption, rows = next((c, t) for c, t in tables(text).items() if c.startswith("Medians over"))
    assert rows[0] == ["scenario", "controller", "runs", "whole run", "end", "valve travel, 1/s"]
    assert "No run has a value of before, damage, undone, least, 90 % after" in caption
    assert f": {reason}." in html.unescape(re.sub("<[^>]*>", "", text))


def test_the_darkest_field_is_the_worst(tmp_path):
    write_sweep(tmp_path / "s")
    text = page(tmp_path / "s")
    for caption, worst in (("undone at the end, %", min), ("error at the end, mrad", max)):
        table = text[text.index(f"<caption>{caption}, by scenario with size and controller") :]
        fields = re.findall(r'--shade: ([\d.]+)">([\d.]+)<', table[: table.index("</table>")])
        values = {float(value): float(shade) for shade, value in fields}
        assert len(values) == 4
        assert values[worst(values)] == 1.0
        assert min(values.values()) == 0.0


def test_the_commands_of_the_worst_runs_are_commands(tmp_path):
    write_sweep(tmp_path / "s x")
    text = html.unescape(re.search(r"<pre>(.*?)</pre>", page(tmp_path / "s x"), re.DOTALL)[1])
    for line in text.strip().splitlines():
        for command in line.split(" && "):
            program, name, *arguments = shlex.split(command)
            assert program == "leglab"
            parsed = COMMANDS[name].make_context(name, arguments).params
            assert parsed["load"] == ["it's.py"]
            assert parsed.get("out") in (None, tmp_path / "s x")


def test_hostile_names_stay_text(tmp_path):
    write_sweep(tmp_path / "s", controllers=(HOSTILE, "pd"))
    text = page(tmp_path / "s")
    assert HOSTILE not in text
    assert "<script" not in text
    assert "script-src 'none'" in html.unescape(text)


def test_a_real_sweep_is_reported_and_one_of_its_runs_recorded(tmp_path, capsys):
    plan = SweepPlan({"settings": BENCH, "block": [{"grid": {"seed": {"count": 3}}}]})
    folder = tmp_path / "s"
    run_sweep(plan, folder, workers=1)
    status, printed, _ = command_line("report", folder, "--no-video", capsys=capsys)
    assert (status, printed) == (0, f"written to {folder / 'report.html'}\n")
    assert "exists; remove it" in command_line("report", folder, capsys=capsys)[2]
    other = ("report", folder, "--out", tmp_path / "o")
    assert command_line(*other, "--no-video", capsys=capsys)[0] == 0
    assert (tmp_path / "o" / "report.html").read_text() == (folder / "report.html").read_text()
    record = ("sweep", folder / "sweep.json", "--out", folder, "--record")
    assert command_line(*record, "2", capsys=capsys)[0] == 0
    metrics = (folder / "recordings" / "00000" / "2" / "metrics.json").read_text()
    (error,) = ask(folder, "SELECT after_rad FROM runs WHERE run = 2").rows[0]
    assert f'"all": {error!r}' in metrics
    assert "there is no run 3; allowed: 0 to 2" in command_line(*record, "3", capsys=capsys)[2]
    entries, _ = write_index(tmp_path, tmp_path / "index.html")
    assert [e.told for e in entries if e.kind == "sweep"] == ["3 runs over seed"]


def test_a_folder_without_a_sweep_is_refused(tmp_path):
    with pytest.raises(LeglabError, match="holds no sweep"):
        write_sweep_page(tmp_path)


@pytest.mark.slow("films")
def test_the_worst_runs_are_filmed_from_before_the_change_on(tmp_path, capsys):
    grid = {"controller": ["pd", "static_feedforward"], "seed": {"count": 2}}
    plan = SweepPlan({"settings": {**BENCH, "duration": 6.0}, "block": [{"grid": grid}]})
    folder, out = tmp_path / "s", tmp_path / "o"
    run_sweep(plan, folder, workers=2)
    words = ("report", folder, "--out", out, "--films", "2", "--duration", "0.2", "--json")
    status, printed, _ = command_line(*words, capsys=capsys)
    assert status == 0
    films = [Path(film) for film in json.loads(printed)["films"]]
    worst = worst_runs(folder, 2)
    assert [film.name for film in films] == [f"run-{number}.mp4" for number in worst]
    assert sorted(path.name for path in out.iterdir()) == sorted(
        ["report.html", *(film.name for film in films)]
    )
    text = (out / "report.html").read_text()
    found = re.findall(r'<video[^>]*src="data:video/mp4;base64,([^"]*)"', text)
    assert [base64.b64decode(data) for data in found] == [film.read_bytes() for film in films]
    rows = tables(text)[next(c for c in tables(text) if c.startswith("The worst runs"))]
    told = re.findall(r"<figcaption>(Run \d+): ", text)
    assert told == [f"Run {row[0]}" for row in rows[1:3]]
    assert "<script" not in text
    # The change comes after half of the run, three seconds: the film begins two before.
    still = film_runs(folder, worst[:1], tmp_path, duration=0.2, camera="three_quarter")
    at_one = render_film(
        [folder / "recordings" / "00000" / str(worst[0])],
        tmp_path / "at_one.mp4",
        start=1.0,
        duration=0.2,
    )
    assert still[worst[0]].read_bytes() == at_one.read_bytes()
    refused = command_line("report", folder, "--films", "13", "--overwrite", capsys=capsys)[2]
    assert "films is 13; allowed: 0 to 12" in refused
    run = folder / "recordings" / "00000" / str(worst[0])
    assert (
        "is for the page of a sweep"
        in command_line("report", run, "--films", "1", capsys=capsys)[2]
    )
