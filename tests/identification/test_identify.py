"""`leglab identify`: structures from data, data that are not clean, files, interruption."""

import json
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from leglab import Recording, RecordingError, SettingsError, identify
from leglab.cli.app import main
from leglab.data import write
from leglab.identification import load
from leglab.identification.structure import plans, search
from leglab.identification.structure.fit import Fit
from leglab.identification.structure.identified import rms
from leglab.identification.structure.journal import Journal
from leglab.identification.structure.residuals import residual_tests
from leglab.identification.structure.signals import signals_of


def levels(rng, n, hold=6):
    change = rng.random(n) < 1 / hold
    return rng.uniform(-1, 1, n)[np.maximum.accumulate(np.where(change, np.arange(n), 0))]


def recorded(u, y, period=0.01, **further):
    return Recording(time=np.arange(len(y)) * period, columns={"u": u, "y": y, **further})


def noisy(u, y_of, noise):
    rng = np.random.default_rng(0)
    return recorded(u, y_of(u) + noise * rng.normal(size=len(u)))


def oscillator(u):
    """Second order, four samples late."""
    return lfilter([0.0, 0.0, 0.0, 0.0, 0.2, 0.1], [1, -1.6, 0.8], u)


def bent(u):
    """A dead zone before a first-order lag."""
    return lfilter([0.0, 0.2], [1, -0.8], np.sign(u) * np.maximum(np.abs(u) - 0.4, 0))


@pytest.fixture(scope="module")
def linear():
    u = levels(np.random.default_rng(1), 600)
    whole = noisy(u, oscillator, 0.05)
    (found,) = identify(
        whole.between(0, 3.995), tests={"rest": whole.between(3.995, None)}
    ).values()
    return found


@pytest.fixture(scope="module")
def dead_zone():
    u = levels(np.random.default_rng(2), 600)
    whole = noisy(u, bent, 0.005)
    (found,) = identify(
        whole.between(0, 3.995), tests={"rest": whole.between(3.995, None)}, jobs=2
    ).values()
    return found


def test_a_linear_machine_gets_a_linear_model_with_its_delay_and_poles(linear):
    assert linear.kind.startswith("linear")
    assert linear.chosen.plan.orders.delays[0] in (3, 4)
    (errors,) = linear.tested
    # The run begins at a few noisy samples; what is left of them dies out.
    late = slice(60, None)
    assert rms((errors.simulated - errors.measured)[late]) < 1.1 * 0.05
    system = linear.model.transfer_function(timestep=linear.period)
    slowest = sorted(np.roots(system.den[0][0]), key=abs)[-2:]
    assert np.abs(slowest) == pytest.approx(0.8**0.5, abs=0.03)


def test_a_dead_zone_is_told_as_what_the_paper_calls_hammerstein(dead_zone):
    assert dead_zone.kind.startswith("Hammerstein")
    (errors,) = dead_zone.tested
    assert errors.free_run < 0.5 * errors.linear
    assert errors.fit > 90
    # At rest the input does nothing within the dead zone, and drives the output beyond it.
    inside = dead_zone.at_rest("u", np.linspace(-0.3, 0.3, 7))
    outside = dead_zone.at_rest("u", np.array([-0.9, 0.9]))
    assert np.ptp(inside) < 0.15 * np.ptp(outside)


def test_an_output_that_the_input_does_not_drive_gets_a_constant():
    rng = np.random.default_rng(3)
    (found,) = identify(recorded(levels(rng, 300), rng.normal(size=300))).values()
    assert not found.better_than_mean
    assert found.kind.startswith("a constant")


@pytest.mark.parametrize(
    ("name", "machine", "noise"), [("dead_zone", bent, 0.005), ("linear", oscillator, 0.05)]
)
def test_a_model_that_learns_on_stays_with_its_machine_and_follows_it(
    name, machine, noise, request
):
    model = request.getfixturevalue(name).model.copy()
    rng = np.random.default_rng(20)
    u = levels(rng, 6000)
    y = machine(u) + noise * rng.normal(size=6000)
    u_test = levels(rng, 1000)
    y_test = machine(u_test)

    def error(gain=1.0):
        run = model.copy().free_run(u_test, gain * y_test[: model.lags])
        return rms(run - gain * y_test, model.lags)

    before = error()
    model.update(np.nan, np.nan)  # another recording follows
    model.run(u, y)
    assert error() < 1.2 * before
    model.run(u[:3000], 1.3 * y[:3000])
    assert error(1.3) < 0.3 * 0.3 * np.std(y_test)


def test_threads_and_an_interruption_change_no_bit(tmp_path):
    u = levels(np.random.default_rng(4), 160)
    data = noisy(u, bent, 0.01)
    (whole,) = identify(data, jobs=1).values()
    journal = Journal(tmp_path / "journal", "key")

    def keep(output, candidate):
        journal.keep(output, candidate)
        if journal.path.read_text().count("\n") > 40:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        identify(data, jobs=2, keep=keep)
    again = Journal(tmp_path / "journal", "key")
    assert len(again.kept["y"]) == 40
    made = []
    (resumed,) = identify(
        data, jobs=2, kept=again.kept, keep=lambda _, c: made.append(c.plan)
    ).values()
    assert (resumed.model.parameters == whole.model.parameters).all()
    assert resumed.model.settings == whole.model.settings
    assert not set(made) & set(again.kept["y"])
    assert not Journal(tmp_path / "journal", "other data").kept


def test_an_interruption_drops_the_structures_that_wait(monkeypatch):
    begun = []
    make = search.searched
    monkeypatch.setattr(search, "searched", lambda *of: begun.append(of[1]) or make(*of))
    u = levels(np.random.default_rng(5), 240)

    def keep(output, candidate):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        identify(noisy(u, bent, 0.01), jobs=1, keep=keep)
    assert len(begun) < 10  # of some fifty linear ones


def test_a_nonlinear_structure_must_win_between_the_data_and_beyond_them():
    def candidate(kind, eighths, thirds, parameters=10):
        plan = plans.Plan(kind, plans.Orders(1, 1, (0,)), 60)
        fit = Fit((), np.zeros(parameters), 0.1)
        return plans.Candidate(plan, fit, (eighths, thirds), ())

    flat = candidate("constant", (1.0, 1.0, 1.0), (1.0, 1.0))
    line = candidate("linear", (0.5, 0.4, 0.6), (0.5, 0.5))
    beyond = candidate("terms", (0.1, 0.1, 0.1), (0.6, 0.5))
    lucky = candidate("terms", (0.1, 0.5, 0.7), (0.4, 0.4))
    sure = candidate("curves", (0.4, 0.3, 0.5), (0.4, 0.4))
    assert plans.chosen_first([flat, line], [beyond, lucky, sure])[0] == sure
    assert plans.chosen_first([flat, line], [beyond, lucky])[0] == line
    chance = candidate("linear", (0.9, 1.05, 0.99), (0.9, 0.9))
    assert plans.chosen_first([flat, chance], [])[0] == flat
    # A larger model of another family has to win in both block sizes, a smaller one need not.
    states = candidate("states", (0.3, 0.2, 0.4), (0.41, 0.4), 20)
    assert plans.chosen_first([flat, line], [sure, states])[0] == sure
    small = replace(states, fit=Fit((), np.zeros(9), 0.1))
    assert plans.chosen_first([flat, line], [sure, small])[0] == small


def test_garbage_is_named_and_left_out():
    rng = np.random.default_rng(5)
    u, n = levels(rng, 200), 200
    y = bent(u)
    wild = u.copy()
    wild[50] = 3e13
    data = recorded(u, y, u2=np.full(n, 4.0), u3=rng.normal(size=n) * 3e13, u4=wild)
    found = signals_of({"a": data})
    assert found.inputs == ("u", "u4")
    notes = "\n".join(found.notes)
    assert "'u2' is left out: it is constant, 4" in notes
    assert "'u3' is left out: values of" in notes
    assert "'u4': 1 wild samples count as missing" in notes
    assert np.abs(found.records[0][0].u).max() <= 1


def test_a_recording_is_split_where_straight_lines_tell_no_inputs():
    rng = np.random.default_rng(6)
    u, slow = rng.normal(size=300), np.sin(0.05 * np.arange(300))
    y = oscillator(u)
    u_gap, y_gap = u.copy(), y.copy()
    u_gap[90:93], slow[40:45], y_gap[100:110] = np.nan, np.nan, np.nan
    keep = np.r_[0:200, 210:300]
    data = Recording(
        time=keep * 0.01, columns={"u": u_gap[keep], "u2": slow[keep], "y": y_gap[keep]}
    )
    found = signals_of({"a": data})
    parts = found.records[0]
    assert [(r.name, len(r)) for r in parts] == [
        ("a, part 1", 90),
        ("a, part 2", 107),
        ("a, part 3", 90),
    ]
    assert (parts[1].u[:, 0] == u[93:200]).all()
    np.testing.assert_allclose(parts[0].u[:, 1], np.sin(0.05 * np.arange(90)), atol=0.02)
    assert np.isnan(parts[1].y).sum() == 10
    notes = "\n".join(found.notes)
    assert "10 rows are missing" in notes
    assert (
        "inputs are missing in 18 samples; 5 of them are bridged by straight lines; split into 3 "
        "parts, which hold 287 of 300 samples" in notes
    )
    assert "20 samples of 'y' are missing" in notes
    # Gaps that leave no parts are bridged.
    u_gap[::40] = np.nan
    data = Recording(time=np.arange(300) * 0.01, columns={"u": u_gap, "y": y})
    found = signals_of({"a": data})
    (record,) = found.records[0]
    assert np.isfinite(record.u).all()
    assert "11 of them are bridged by straight lines" in "\n".join(found.notes)


def test_irregular_sampling_is_refused_with_the_remedy():
    rng = np.random.default_rng(7)
    time = np.cumsum(rng.uniform(0.005, 0.02, 300))
    data = Recording(time=time, columns={"u": rng.normal(size=300), "y": rng.normal(size=300)})
    with pytest.raises(RecordingError, match=r"one period is needed; --period 0\.01\d+ resamples"):
        signals_of({"a": data})
    found = signals_of({"a": data}, period=0.01)
    assert found.period == 0.01
    assert "became" in found.notes[0]
    # A clock that trembles about the very period that is asked for.
    time = 0.01 * np.arange(300) + rng.normal(0, 0.0004, 300)
    data = Recording(time=time, columns={"u": levels(rng, 300), "y": np.sin(time)})
    with pytest.raises(RecordingError, match="resamples"):
        signals_of({"a": data})
    assert len(signals_of({"a": data}, period=0.01).records[0][0]) in (299, 300)
    # Rows that are missing are a gap, not a straight line.
    rows = np.r_[0:140, 160:300]
    gap = Recording(time=time[rows], columns={k: v[rows] for k, v in data.columns.items()})
    assert len(signals_of({"a": gap}, period=0.01).records[0]) == 2


@pytest.mark.parametrize(
    ("inputs", "outputs", "error", "message"),
    [
        (("v",), (), SettingsError, "unknown input 'v'"),
        ((), ("z",), SettingsError, "unknown output 'z'"),
        (("u",), ("u",), SettingsError, "'u' is input and output"),
        (("y",), (), SettingsError, "which column is the output"),
        (("flat",), (), RecordingError, "no input is left: 'flat' is left out: it is constant"),
        ((), ("flat",), RecordingError, "output 'flat' is left out: it is constant"),
    ],
)
def test_wrong_columns_are_refused(inputs, outputs, error, message):
    rng = np.random.default_rng(8)
    columns = {"u": rng.normal(size=200), "y": rng.normal(size=200), "flat": np.ones(200)}
    data = Recording(time=np.arange(200.0), columns=columns)
    with pytest.raises(error, match=message):
        signals_of({"a": data}, inputs, outputs)


def test_too_few_samples_are_refused():
    data = recorded(np.arange(50.0), np.arange(50.0))
    with pytest.raises(RecordingError, match="a: 50 samples; needed are 100"):
        signals_of({"a": data})


def test_a_stream_of_anything_leaves_no_number_that_is_not_finite(dead_zone, linear):
    rng = np.random.default_rng(9)
    for found in (dead_zone, linear):
        model = found.model.copy()
        for scale in (1.0, 1e6, 1e-9):
            u = scale * rng.normal(size=3000)
            y = np.repeat(scale * rng.normal(size=300), 10)
            y[rng.random(3000) < 0.05] = np.nan
            u[rng.random(3000) < 0.02] = np.inf
            model.run(u, y, missing="skip")
        assert np.isfinite(model.parameters).all()
        assert np.isfinite(model.free_run(rng.uniform(-1, 1, 500))).all()


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_c_header_runs_as_the_model_does(dead_zone, tmp_path):
    from leglab.identification.c_header import c_header

    curves = next(c for c in dead_zone.candidates if c.plan.kind == "curves")
    model, record = dead_zone.problem.identifier(curves.fit), dead_zone.tests[0]
    (tmp_path / "model.h").write_text(c_header(model, "my model", dead_zone.period))
    u, lags = record.u[:, 0], model.lags
    lines = [f"{a!r} {b!r}" for a, b in zip(u.tolist(), record.y.tolist(), strict=True)]
    program = f"""
#include <stdio.h>
#include "model.h"
int main(void) {{
  my_model_state s = {{0}};
  double u[1], y;
  for (int t = 0; scanf("%lf %lf", u, &y) == 2; ++t) {{
    double p = my_model_predict(&s, u);
    if (t < {lags}) p = y;
    printf("%.17g\\n", p);
    my_model_put(&s, p);
  }}
}}
"""
    (tmp_path / "main.c").write_text(program)
    words = ["cc", "-std=c99", "-Wall", "-Werror", "main.c", "-o", "run", "-lm"]
    subprocess.run(words, cwd=tmp_path, check=True)
    done = subprocess.run(
        ["./run"], cwd=tmp_path, check=True, input="\n".join(lines), capture_output=True, text=True
    )
    ours = model.free_run(u, record.y[:lags])
    assert np.array(done.stdout.split(), float) == pytest.approx(ours, rel=1e-9, abs=1e-12)


def test_the_command_writes_model_page_and_header(tmp_path, capsys):
    rng = np.random.default_rng(10)
    u = levels(rng, 300)
    data = noisy(u, bent, 0.01)
    for name, part in (("train", data.between(0, 1.595)), ("test", data.between(1.595, None))):
        write(part, tmp_path / f"{name}.csv")
        head, rows = (tmp_path / f"{name}.csv").read_text().split("\n", 1)
        (tmp_path / f"{name}.csv").write_text(head.replace("u", "u [V]") + "\n" + rows)
    train, test = (str(tmp_path / f"{name}.csv") for name in ("train", "test"))
    words = ["identify", train, "--test", test, "--test", train, "--input", "u"]
    main([*words, "--out", str(tmp_path / "out"), "--json"])
    told = json.loads(capsys.readouterr().out)
    kept = json.loads((tmp_path / "out" / "identify.json").read_text())
    assert told == kept
    (found,) = kept["models"]
    assert (found["inputs"], found["output"]) == (["u [V]"], "y")
    assert (
        "train.csv: the test data are training data, so their errors test nothing" in found["notes"]
    )
    assert found["test"][0]["free_run"] < found["test"][0]["mean"]
    assert len(found["transfer_functions"]) == 1
    model = load(tmp_path / "out" / "model.leglab")
    test = data.between(1.595, None)
    run = model.copy().free_run(test["u"], test["y"][: model.lags])
    rms = np.sqrt(np.mean((run - test["y"])[model.lags :] ** 2))
    assert rms == pytest.approx(found["test"][0]["free_run"])
    page = (tmp_path / "out" / "identify.html").read_text()
    assert "free run fits" in page
    assert page.count("<img") >= 3
    assert not list(tmp_path.glob(".out*"))
    with pytest.raises(SystemExit) as stopped:
        main([*words, "--out", str(tmp_path / "out")])
    assert stopped.value.code == 2
    assert "give --overwrite" in capsys.readouterr().err


def test_many_inputs_and_few_samples_leave_a_structure():
    rng = np.random.default_rng(11)
    u, y = rng.normal(size=(110, 5)), np.zeros(110)
    for t in range(1, 110):
        y[t] = 0.7 * y[t - 1] + u[t - 1] @ [1, 0.5, 0, 0, -0.3]
    columns = {f"u{j}": u[:, j].copy() for j in range(5)}
    (found,) = identify(Recording(time=np.arange(110.0), columns={**columns, "y": y})).values()
    assert found.trained[0].fit > 99


def test_an_input_that_rests_in_the_test_is_a_signal():
    n = 150
    data = recorded(np.full(n, 0.5), np.full(n, 0.1), w=np.zeros(n))
    found = signals_of({"rest": data}, ("u", "w"), ("y",), resting=True)
    assert found.inputs == ("u", "w")
    assert (found.records[0][0].u[:, 0] == 0.5).all()


def test_a_single_large_correlation_is_not_white():
    rng = np.random.default_rng(13)
    e = rng.normal(size=2001)
    (white,) = residual_tests(e, {})
    (coloured,) = residual_tests(e[1:] - 0.15 * e[:-1], {})
    assert white.white
    assert coloured.outside < 0.1
    assert not coloured.white


def test_a_test_that_lacks_an_input_is_named():
    u = levels(np.random.default_rng(12), 200)
    tests = {"walk.csv": Recording(time=np.arange(200.0), columns={"y": u, "w": u})}
    with pytest.raises(RecordingError, match=r"walk\.csv: no column 'u', found "):
        identify(recorded(u, bent(u), 1.0), tests=tests)
