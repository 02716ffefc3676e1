"""The clock of adaptation: closed forms, a definition sample by sample, and real runs."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leglab.base.scenario import ParameterChange, Scenario
from leglab.cli import main
from leglab.cli.terminal import metrics_table
from leglab.controllers.bsnn_arx import AdaptiveController
from leglab.report.film.track import load_track
from leglab.report.folder_index import write_index
from leglab.report.page.outcome import outcome
from leglab.report.page.wording import number
from leglab.report.run.tables import run_table
from leglab.runs.clock import adaptation
from leglab.runs.folder import read_runs
from leglab.runs.preparation import RunSettings, reference_config, scenario_of
from leglab.runs.run import run_scenario

TIME = np.arange(10001) * 0.002


def scenario(change=10.0, ramp=0.0, duration=20.0):
    changes = ()
    if change is not None:
        changes = (ParameterChange(parameter="x", value=2, start=change, ramp_duration=ramp),)
    return Scenario(name="s", duration=duration, changes=changes)


def clock(error, twin=None, stride=1.25, **options):
    both = [
        None if e is None else np.broadcast_to(e(TIME)[:, None], (10001, 2)) for e in (error, twin)
    ]
    return adaptation(scenario(**options), stride, TIME, both[0], ("hip", "knee"), twin=both[1])


def decaying(before, damage, constant, end=0.0):
    """An error that jumps by the damage at 10 s and decays to `end` above what it was."""
    return lambda t: (
        before + np.where(t < 10, 0.0, end + (damage - end) * np.exp(-(t - 10) / constant))
    )


def jump(before, damage):
    return lambda t: np.where(t < 10, before, before + damage)


def test_exponential_decay_against_its_closed_form():
    before, damage, constant, stride = 0.1, 10.0, 0.4, 1.25
    found = clock(decaying(before, damage, constant), jump(before, damage))
    assert found.before_rad == pytest.approx({"hip": before, "knee": before, "all": before})
    assert found.end_rad["all"] == pytest.approx(before, rel=1e-3)
    assert (found.damage_rad, found.damage_of) == (pytest.approx(damage), "frozen twin")
    assert found.recovered == pytest.approx(1.0, abs=1e-4)

    # RMS over a stride that begins at t: (b + D e^(-t/c))^2 integrated.
    def over_a_stride(t):
        a = damage * math.exp(-t / constant)
        one, two = 1 - math.exp(-stride / constant), 1 - math.exp(-2 * stride / constant)
        mean = before**2 + (2 * before * a * one + a**2 * two / 2) * constant / stride
        return math.sqrt(mean)

    assert found.level_rad == pytest.approx(before + 0.1 * damage)
    assert over_a_stride(found.t90_s) == pytest.approx(found.level_rad, rel=3e-3)


def test_a_step_back_is_timed_exactly():
    found = clock(lambda t: np.where((t >= 10) & (t < 13), 1.1, 0.1), jump(0.1, 1.0))
    # A stride may hold no more bad samples than lift its RMS to the level: 3 % of it here.
    share = (found.level_rad**2 - 0.1**2) / (1.1**2 - 0.1**2)
    assert found.t90_s == pytest.approx(3.0 - 1.25 * share, abs=0.003)
    assert found.recovered == pytest.approx(1.0)


def test_a_relapse_counts():
    found = clock(
        lambda t: np.where(((t >= 10) & (t < 11)) | ((t >= 14) & (t < 15)), 1.1, 0.1),
        jump(0.1, 1.0),
    )
    assert 4.9 < found.t90_s < 5.0
    late = clock(lambda t: np.where(t < 10, 0.1, np.where(t < 19.5, 0.1, 5.0)), jump(0.1, 1.0))
    assert late.t90_s is None


def test_a_controller_without_a_twin_is_measured_by_its_worst_stride():
    found = clock(jump(0.1, 0.4))
    assert found.damage_of == "own peak"
    assert found.damage_rad == pytest.approx(0.4)
    assert found.recovered == pytest.approx(0.0, abs=1e-9)
    assert found.t90_s is None


def test_the_worst_stride_of_all_is_the_peak_and_a_ramp_counts_from_its_beginning():
    """Without a twin: errors of 0.1, 0.9 while the machine changes, 0.5 when it is done."""
    found = clock(
        lambda t: np.select([t < 10, t < 13], [0.1, 0.9], 0.5), change=10.0, ramp=3.0, stride=1.25
    )
    assert found.before_rad["all"] == pytest.approx(0.1)
    assert found.damage_rad == pytest.approx(0.8)
    assert found.recovered == pytest.approx(0.5)


def test_all_joints_are_pooled():
    # Of as many samples in a span as joints: the pool is not each second sample of one of them.
    error = np.broadcast_to([3.0, 4.0], (10001, 2)).copy()
    found = adaptation(scenario(), 1.25, TIME, error, ("hip", "knee"))
    assert found.end_rad == pytest.approx({"hip": 3.0, "knee": 4.0, "all": math.sqrt(12.5)})


def test_a_change_that_ends_where_the_last_span_begins_is_told():
    found = clock(jump(0.1, 1.0), jump(0.1, 1.0), change=10.0, ramp=5.0)
    assert found.reason is None


def test_a_periodic_error_recovers_nothing_whatever_the_phase():
    def ripple(t):
        return np.where(t < 10, 1.0, 2.0) * (1.5 + np.sin(2 * np.pi * t / 1.25))

    found = clock(ripple, ripple)
    assert found.recovered == pytest.approx(0.0, abs=2e-3)
    assert clock(ripple).recovered == pytest.approx(0.0, abs=1e-3)


def test_no_damage_is_said_instead_of_counted():
    found = clock(jump(0.1, 0.02), jump(0.1, 0.02))
    assert (found.recovered, found.t90_s) == (None, None)
    assert "does no damage" in found.reason
    assert found.damage_rad == pytest.approx(0.02)
    assert outcome(found, "mrad") == found.reason


def test_a_run_that_ends_better_than_it_began():
    found = clock(decaying(0.5, 2.0, 0.3, end=-0.2), jump(0.5, 2.0))
    assert found.recovered == pytest.approx(1.1, abs=1e-3)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"change": 4.0}, "leaves less than 5 s before it"),
        ({"change": 10.0, "ramp": 6.0}, "still changes in the last 5 s"),
        ({"stride": 6.0}, "a quarter of the run, 5 s, is less than a stride, 6 s"),
        ({"change": None}, "nothing changes"),
    ],
)
def test_what_cannot_be_told_has_a_reason(options, reason):
    found = clock(jump(0.1, 1.0), jump(0.1, 1.0), **options)
    assert reason in found.reason
    assert (found.recovered, found.t90_s, found.damage_rad) == (None, None, None)


def test_a_run_that_stopped_has_no_clock():
    error = np.ones((10001, 1))
    found = adaptation(scenario(), 1.25, TIME, error, ("knee",), failure="the knee blew up")
    assert found.reason == "the run stopped early: the knee blew up"
    assert found.end_rad is None


@given(
    st.lists(st.floats(0.01, 3.0), min_size=40, max_size=40),
    st.floats(0.05, 3.0),
    st.integers(1, 5),
    st.integers(10, 30),
)
def test_the_definition_stride_by_stride(levels, twin, stride, change):
    """Forty samples a second apart; every figure from its words."""
    time, error = np.arange(40.0), np.array(levels)[:, None]
    frozen = np.where(time < change, error[:, 0], twin)[:, None]
    case = scenario(change=float(change), duration=40.0)
    found = adaptation(case, float(stride), time, error, ("knee",), twin=frozen)
    span = 10 // stride * stride

    def rms(samples):
        return math.sqrt(sum(s * s for s in samples) / len(samples))

    before, end = rms(levels[change - span : change]), rms(levels[40 - span :])
    if twin < 1.25 * before:
        assert "no damage" in found.reason
        return
    assert found.before_rad["knee"] == pytest.approx(before)
    assert found.end_rad["all"] == pytest.approx(end)
    assert found.damage_rad == pytest.approx(twin - before)
    assert found.recovered == pytest.approx(1 - (end - before) / (twin - before))
    level = before + 0.1 * (twin - before)
    # Strides by the number of their last sample; one that begins at k holds k + 1 .. k + stride.
    bad = [
        last
        for last in range(change, 40)
        if last >= stride - 1 and rms(levels[last - stride + 1 : last + 1]) > level * (1 + 1e-9)
    ]
    if not bad:
        assert found.t90_s == 0.0
    elif bad[-1] == 39:
        assert found.t90_s is None
    else:
        assert found.t90_s == pytest.approx(max(0.0, bad[-1] + 1 - stride - change))


def run(controller, **options):
    settings = RunSettings(
        scenario="seal_wear", model="knee_bench", controller=controller, **options
    )
    return run_scenario(settings)


@pytest.fixture(scope="module")
def adapting():
    return run("bsnn_arx")


def test_the_twin_is_the_frozen_controller(adapting):
    frozen = run("frozen")
    assert adapting.record.adaptation.damage_rad == frozen.record.adaptation.damage_rad
    assert adapting.record.adaptation.twin_end_rad == frozen.record.adaptation.end_rad["all"]
    after = frozen.record.phases[-1].rms_rad["all"]
    before = adapting.record.adaptation.before_rad["all"]
    assert adapting.record.adaptation.damage_rad == pytest.approx(after - before, rel=1e-12)
    assert abs(frozen.record.adaptation.recovered) < 0.05


def test_adapting_recovers_and_a_fixed_map_does_not(adapting):
    found = adapting.record.adaptation
    assert found.recovered > 0.9
    assert 0.2 < found.t90_s < 5.0
    static = run("static_feedforward").record.adaptation
    assert static.damage_of == "own peak"
    assert static.t90_s is None
    assert abs(static.recovered) < 0.1


def test_the_twin_leaves_the_run_as_it_is(adapting, monkeypatch):
    """The recording is that of a controller that has no `freeze`."""
    monkeypatch.setattr(AdaptiveController, "freeze", None)
    alone = run("bsnn_arx")
    assert alone.record.adaptation.damage_of == "own peak"
    np.testing.assert_array_equal(alone.history.position, adapting.history.position)
    for name, column in alone.recording.columns.items():
        np.testing.assert_array_equal(column, adapting.recording[name], err_msg=name)


@pytest.mark.parametrize("controller", ["arx", "bsnn_arx_paper", "adaptive_backstepping"])
def test_every_controller_that_adapts_has_a_twin(controller):
    assert run(controller, duration=8.0).record.adaptation.damage_of == "frozen twin"


def test_the_terminal_tells_the_figures_of_the_file(adapting):
    caption = str(metrics_table(adapting.record).caption)
    found = adapting.metrics["adaptation"]
    assert f"90 % undone after {found['t90_s']:.2f} s" in caption
    assert f"{100 * found['recovered']:.0f} % undone in the last 4.8 s" in caption


def test_all_places_tell_the_same_figures(tmp_path, capsys):
    """A single run, a comparison, a page's table and sentence, a list, and a film, of one run."""
    options = ["--model", "knee_bench", "--tolerance", "0.1", "--vary"]

    def shown(*arguments):
        main([*arguments, *options, "--json"])
        return json.loads(capsys.readouterr().out)

    folder = tmp_path / "run"
    alone = shown("run", "seal_wear", "--controller", "bsnn_arx", "--out", str(folder))
    wanted = alone["adaptation"]
    compared = shown(
        *("compare", "seal_wear", "--controllers", "bsnn_arx", "--seeds", "1", "--no-figures"),
        *("--out", str(tmp_path / "compare")),
    )
    cell = compared["results"]["seal_wear"]["bsnn_arx"]
    assert cell["after_rad"]["values"] == [alone["phases"][-1]["rms_rad"]["all"]]
    for name in ("damage_rad", "recovered", "t90_s"):
        assert cell[name]["values"] == [wanted[name]]
    for name in ("before_rad", "end_rad"):
        assert cell[name]["values"] == [wanted[name]["all"]]

    reported = shown(
        *("report", "--scenario", "seal_wear", "--controllers", "bsnn_arx", "--no-video"),
        *("--out", str(tmp_path / "report")),
    )
    assert reported["runs"][0]["adaptation"] == wanted
    runs = read_runs([folder])
    (row,) = run_table(runs).rows
    t90, recovered = f"{wanted['t90_s']:.2f}", f"{100 * wanted['recovered']:.0f}"
    end, damage = (number(1e3 * v) for v in (wanted["end_rad"]["all"], wanted["damage_rad"]))
    assert {end, damage, recovered, t90} <= set(row)
    page = (tmp_path / "report" / "report.html").read_text()
    text = " ".join(page.split())
    assert f"the change would raise the error by {damage} mrad; {recovered} % of that" in text
    assert f"90 % of it {t90} s after the change" in text
    entries, _ = write_index(tmp_path, tmp_path / "index.html")
    (listed,) = [entry for entry in entries if entry.name == "run"]
    errors = [wanted["before_rad"]["all"], alone["phases"][-1]["rms_rad"]["all"]]
    errors.append(wanted["end_rad"]["all"])
    assert [listed.before, listed.after, listed.end] == pytest.approx([1e3 * e for e in errors])
    assert f"90 % undone after {t90} s" in listed.told
    over, told = load_track(folder).undone
    assert told == f"strides from {t90} s after the change on: 90 % undone"
    change = runs[0].configuration.changes[0].start
    assert over == pytest.approx(change + wanted["t90_s"] + wanted["stride_s"])


def test_seeds_draw_time_and_phase():
    def drawn(seed, **options):
        settings = RunSettings(scenario="seal_wear", seed=seed, vary=True, **options)
        case = scenario_of(settings)
        return case.breakpoints[0], reference_config(settings, case).get("phase")

    times, phases = zip(*(drawn(seed) for seed in range(200)), strict=True)
    assert 8.0 <= min(times) < 8.2
    assert 11.8 < max(times) <= 12.0
    assert abs(np.mean(times) - 10.0) < 0.3
    assert min(phases) < 0.05
    assert max(phases) > 0.95
    assert abs(np.corrcoef(times, phases)[0, 1]) < 0.25
    assert drawn(3) == drawn(3)
    # What the user says of the phase holds; other motions have none.
    assert drawn(3, reference_config={"phase": 0.25})[1] == 0.25
    assert drawn(3, reference="squat")[1] is None
    plain = RunSettings(scenario="seal_wear", seed=3)
    assert scenario_of(plain).breakpoints == (10.0,)


def test_ramps_and_what_is_changed_from_the_start_stay_inside_the_run():
    late = scenario_of(RunSettings(scenario="seal_wear", ramp_duration=10.0, vary=True, seed=1))
    assert late.breakpoints[-1] <= 20.0
    cold = RunSettings(scenario="cold_start")
    varied = RunSettings(scenario="cold_start", vary=True, seed=5)
    assert scenario_of(varied).changes == scenario_of(cold).changes
