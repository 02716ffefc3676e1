"""The self-test on rough specimens: cases, what is kept, scores and figures."""

import json
from dataclasses import asdict, replace
from functools import partial

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.self_test import rough as rough_selftest
from benchmarks.self_test.figures import confusion_figure, reliability_figure, save_figures
from benchmarks.self_test.outcomes import run_missing
from benchmarks.self_test.rough import (
    NOTHING,
    RoughOutcome,
    RoughTestCase,
    RoughTestSettings,
    confusions,
    interval,
    missed,
    reliability,
    reliability_rows,
    rough_cases,
    rough_self_test,
    run_case,
    scores,
    told_period,
)
from leglab.base.errors import LeglabError
from rigs.rough_bench import FAULTS, RoughCase, effect_of, specimen

KNOWN = ("internal_leakage", "payload", "stiction", "asymmetric_friction")


def outcome(kind, faults, claims, *, number=0, verdict="named", tied=(), **content):
    effects = [
        {
            "name": name,
            "element": "knee_valve",
            "confidence": confidence,
            "indistinguishable_from": list(tied),
            "parameters": {"size": {"value": 2.0, "interval": [1.0, 3.0]}},
        }
        for name, confidence in claims
    ]
    return RoughOutcome(
        kind=kind,
        number=number,
        specimen=number,
        faults=faults,
        severities=tuple(("size", 2.5) for _ in faults),
        diagnosis={"verdict": verdict, "effects": effects, **content},
        ranking=(("payload", "shank", 90.0), ("stiction", "knee_valve", 20.0)),
        seconds=30.0,
    )


def rows(outcomes, **settings):
    return {row[0]: row[1:] for row in scores(outcomes, RoughTestSettings(**settings))}


def test_cases_cycle_through_the_faults_that_have_a_name():
    counts = {"single": 7, "null": 2, "torque": 2, "pair": 3}
    cases = rough_cases(counts, RoughTestSettings(seed=2), KNOWN)
    singles = [case.faults for case in cases if case.kind == "single"]
    assert {len(faults) for faults in singles} == {1}
    named = {"internal_leakage", "payload", "stiction", "asymmetric_friction"}
    named |= {"asymmetric_seal_friction"}
    assert {faults[0] for faults in singles} == named
    assert [c.faults for c in cases if c.kind == "null"] == [(), ()]
    assert all(c.faults == ("position_torque",) for c in cases if c.kind == "torque")
    # Two faults of a pair never go by one name, or a single name would count as both.
    pairs = rough_cases({"pair": 40}, RoughTestSettings(seed=2), KNOWN)
    assert all(len({effect_of(fault) for fault in c.faults}) == 2 for c in pairs)
    # Each cycle has every fault once, in an order of its own.
    names = len(named)
    many = rough_cases({"single": 6 * names}, RoughTestSettings(seed=2), KNOWN)
    cycles = [fault for case in many for fault in case.faults]
    orders = {tuple(cycles[k : k + names]) for k in range(0, 6 * names, names)}
    assert len(orders) > 1
    assert all(set(order) == named for order in orders)
    other = rough_cases(counts, RoughTestSettings(seed=3), KNOWN)
    specimens = [case.specimen for case in (*cases, *other)]
    assert len(set(specimens)) == len(specimens)


def test_scores_count_the_first_name_and_its_confidence():
    seen = [
        outcome("single", ("payload",), [("payload", 0.95)]),
        outcome("single", ("payload",), [("payload", 0.79), ("stiction", 0.3)]),
        outcome("single", ("asymmetric_seal_friction",), [("asymmetric_friction", 0.8)]),
        outcome("single", ("payload",), [("stiction", 0.6), ("payload", 0.9)], verdict="partial"),
        outcome("single", ("payload",), [], verdict="unexplained"),
    ]
    table = rows(seen)
    assert table["single fault: right name first"] == ("3 (60%)", "23% to 88%", "5", "90 %")
    assert table["... with confidence 0.8 or more"][0] == "2 (40%)"
    # All five have the same specimen, so that one of the two rows is missing.
    edges = "the model's" if specimen(0)["edge_law"] == 0.0 else "other"
    question = "... a valve with {} metering edges: right name first"
    assert table[question.format(edges)][0] == "3 (60%)"
    assert len([q for q in table if "metering edges" in q]) == 1
    # Whatever the verdict, a wrong name above 0.5 is wrong.
    assert table["... a wrong name above 0.5"][0] == "1 (20%)"
    assert table["... a wrong name above 0.8"][0] == "0 (0%)"
    assert table["names given with 0.9 or more that are right"][:3] == (
        "2 (100%)",
        "34% to 100%",
        "2",
    )
    assert rows(seen, healthy=False)["single fault: right name first"][3] == "85 %"


def test_scores_count_alarms_pairs_and_failures():
    seen = [
        outcome("null", (), [("payload", 0.51)], verdict="unexplained"),
        outcome("null", (), [("payload", 0.5)], number=1),
        outcome("null", (), [], number=2),
        outcome("pair", ("payload", "stiction"), [("payload", 0.9), ("stiction", 0.2)]),
        outcome("pair", ("payload", "stiction"), [("payload", 0.9)], tied=("stiction",), number=1),
        outcome("pair", ("payload", "stiction"), [("payload", 0.95)], number=2),
        RoughOutcome(
            kind="null",
            number=3,
            specimen=0,
            faults=(),
            severities=(),
            diagnosis={},
            ranking=(),
            seconds=1.0,
            error="ValueError: no",
        ),
    ]
    table = rows(seen)
    assert table["nothing hidden: a name above 0.5"][:3] == ("1 (33%)", "6% to 79%", "3")
    assert table["pair: both named"][0] == "2 (67%)"
    assert table["diagnoses that failed"][0] == "1"
    assert table["95 % intervals of right names hold the truth"][0] == "4 (100%)"


def test_a_torque_is_told_by_its_period():
    def torque(period, text):
        case = outcome("torque", ("position_torque",), [], gap={"closed_fraction": 0.7})
        return RoughOutcome(
            **{
                **vars(case),
                "severities": (("period", period),),
                "diagnosis": {**case.diagnosis, "remaining": text},
            }
        )

    seen = [
        torque(0.449, {"words": "a torque that repeats every 0.449 rad of the knee, 6 N m"}),
        torque(0.449, {"shape": {"period": 0.46}}),
        torque(0.449, {"shape": {"period": 0.465}}),
        torque(0.449, "no shape"),
    ]
    assert [o.period_right for o in seen] == [True, True, False, False]
    assert rows(seen)["... gap closed, median"] == ("0.70", "", "4", "0.8")
    assert told_period({"ripple_period": {"value": 0.3, "unit": "rad"}}) == 0.3


def test_the_interval_is_wilson_s():
    z = 1.959963984540054
    for good, count in ((9, 10), (0, 7), (80, 100)):
        share, spread = good / count, z**2 / count
        middle = (share + spread / 2) / (1 + spread)
        half = z / (1 + spread) * np.sqrt(share * (1 - share) / count + spread / count / 4)
        assert interval(good, count) == pytest.approx((middle - half, middle + half))


def test_claims_of_all_cases_are_binned_by_confidence():
    seen = [
        outcome("single", ("payload",), [("payload", 0.9), ("stiction", 0.05)]),
        outcome("single", ("payload",), [("payload", 1.0)]),
        outcome("null", (), [("stiction", 0.95)]),
        outcome("pair", ("payload", "stiction"), [("stiction", 0.6)]),
    ]
    bins = {(one.low, one.high): one for one in reliability(seen)}
    assert (bins[0.9, 1.0].count, bins[0.9, 1.0].right) == (3, 2)
    assert bins[0.9, 1.0].mean == pytest.approx(0.95)
    assert (bins[0.0, 0.1].count, bins[0.0, 0.1].right) == (1, 0)
    assert (bins[0.5, 0.7].count, bins[0.5, 0.7].right) == (1, 1)
    assert sum(one.count for one in bins.values()) == 5
    assert [row[2] for row in reliability_rows(reliability(seen))] == [
        "0%",
        "",
        "",
        "100%",
        "",
        "",
        "67%",
    ]


def test_confusions_and_the_table_of_what_was_missed():
    seen = [
        outcome("single", ("payload",), [("payload", 0.9)]),
        outcome("single", ("stiction",), [("payload", 0.61)], verdict="partial"),
        outcome("single", ("internal_leakage",), [], verdict="unexplained"),
        outcome("null", (), []),
        outcome("pair", ("payload", "stiction"), [("payload", 0.9)]),
    ]
    counts = confusions(seen)
    assert counts == {
        ("payload", "payload"): 1,
        ("stiction", "payload"): 1,
        ("internal_leakage", NOTHING): 1,
        (NOTHING, NOTHING): 1,
    }
    assert missed(seen) == [
        ("internal_leakage", NOTHING, "", "unexplained", "> 2"),
        ("stiction", "payload", "0.61", "partial", "2"),
    ]


def test_figures_show_every_case(tmp_path):
    seen = [
        outcome("single", (name,), [("payload", 0.95)], number=i) for i, name in enumerate(FAULTS)
    ]
    seen.append(outcome("null", (), []))
    figure = confusion_figure(confusions(seen))
    axes = figure.axes[0]
    rows = [label.get_text() for label in axes.get_yticklabels()]
    assert rows[0] == "internal leakage"
    assert rows[-1] == NOTHING
    assert len(set(rows)) == len(rows)
    numbers = [text.get_text() for text in axes.texts if " of " not in text.get_text()]
    assert sum(map(int, numbers)) == len(seen)
    shares = [text.get_text() for text in axes.texts if " of " in text.get_text()]
    assert shares[rows.index("payload")] == "1 of 1"
    assert shares[rows.index("stiction")] == "0 of 1"

    figure = reliability_figure(reliability(seen))
    upper, lower = figure.axes
    point = upper.lines[-1]
    assert point.get_xdata()[0] == pytest.approx(0.95)
    assert point.get_ydata()[0] == pytest.approx(1 / len(FAULTS))
    assert [text.get_text() for text in lower.texts] == [f"1/{len(FAULTS)}"]

    paths = save_figures(seen, tmp_path, "rough")
    assert sorted(path.name for path in paths) == [
        f"rough-{name}.{kind}" for name in ("confusion", "reliability") for kind in ("png", "svg")
    ]
    assert all(path.stat().st_size > 5000 for path in paths)


def test_labels_of_the_figures_do_not_overlap():
    seen = [
        outcome("single", (name,), [(name, 0.95 - 0.9 * (i % 7) / 7)], number=i)
        for i, name in enumerate((*FAULTS, *FAULTS, *FAULTS))
    ]
    for figure in (reliability_figure(reliability(seen)), confusion_figure(confusions(seen))):
        renderer = figure.canvas.get_renderer() if hasattr(figure.canvas, "get_renderer") else None
        figure.draw_without_rendering()
        for axes in figure.axes:
            for labels in (axes.get_xticklabels(), axes.get_yticklabels(), axes.texts):
                boxes = [label.get_window_extent(renderer) for label in labels if label.get_text()]
                for i, one in enumerate(boxes):
                    assert all(not one.overlaps(other) for other in boxes[i + 1 :])
                    assert one.x0 >= 0.0
                    assert one.y1 <= figure.bbox.height


def test_nothing_gives_no_figure(tmp_path):
    assert reliability_figure(reliability([outcome("null", (), [])])) is None
    assert save_figures([], tmp_path, "rough") == []


def run_all(path, cases, run, **rest):
    return run_missing(
        path,
        cases,
        run,
        parse=rough_selftest._OUTCOME.validate_python,
        done=lambda o: not o.error,
        processes=1,
        **rest,
    )


def test_an_interrupted_test_goes_on_where_it_was(tmp_path):
    path = tmp_path / "outcomes.jsonl"
    cases = [
        RoughTestCase(kind=kind, number=n, specimen=n, faults=("payload",))
        for kind, count in (("single", 4), ("null", 2))
        for n in range(count)
    ]
    ran = []

    def run(given):
        case = RoughTestCase(**given["case"])
        ran.append((case.kind, case.number))
        made = outcome(case.kind, case.faults, [("payload", 0.9)], number=case.number)
        failed = case.number == 3 and len(ran) <= 6
        return {**asdict(made), "error": "Broken: pipe" if failed else ""}

    first = run_all(path, cases, run)
    # Kinds keep pace with each other.
    assert ran == [
        ("single", 0),
        ("null", 0),
        ("single", 1),
        ("single", 2),
        ("null", 1),
        ("single", 3),
    ]
    assert [(o.kind, o.number) for o in first] == [(c.kind, c.number) for c in cases]
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:2], lines[3][:40], *lines[4:]]) + "\n")
    told = []
    again = run_all(path, cases, run, progress=lambda *state: told.append(state))
    # What was lost, cut off or had failed.
    assert sorted(ran[6:]) == [("single", 1), ("single", 2), ("single", 3)]
    assert told[0] == (3, 6, "")
    assert told[-1][:2] == (6, 6)
    assert again[0] == first[0]
    assert not any(o.error for o in again)


def test_outcomes_of_other_faults_are_not_taken_for_those_of_a_case(tmp_path, monkeypatch):
    """A file of an earlier order of faults: its cases have the same numbers."""
    ran = []

    def outcome_of(given):
        case = RoughTestCase(**given["case"])
        ran.append(case.number)
        return asdict(outcome(case.kind, case.faults, [], number=case.number))

    monkeypatch.setattr(rough_selftest, "outcome_of", outcome_of)

    def run():
        return rough_self_test(tmp_path, 3, processes=1, kinds=("single",))

    first = run()
    assert sorted(ran) == [0, 1, 2]
    (path,) = tmp_path.iterdir()
    other = replace(first[1], faults=("payload",) if "payload" not in first[1].faults else ())
    rows = [first[0], other, first[2]]
    path.write_text("".join(json.dumps(asdict(one)) + "\n" for one in rows))
    assert run() == first
    assert sorted(ran) == [0, 1, 1, 2]


def test_a_case_is_diagnosed_with_its_healthy_recordings_when_asked(monkeypatch):
    asked = []

    def diagnosed(model, recordings, *, healthy):
        asked.append((sorted(recordings), healthy))
        return {"verdict": "named", "effects": [], "smaller": ["command_delay"], "ranking": []}

    made = []

    def rough_case(specimen, faults, **options):
        made.append((specimen, faults, options))
        healthy = {"b": 2} if options["healthy"] else {}
        return RoughCase(recordings={"a": 1}, healthy=healthy, severities=())

    monkeypatch.setattr(rough_selftest, "diagnosed", diagnosed)
    monkeypatch.setattr(rough_selftest, "rough_case", rough_case)
    case = RoughTestCase(kind="null", number=0, specimen=77, faults=())
    found = run_case(case, RoughTestSettings())
    assert asked[-1] == (["a"], {"b": 2})
    assert found.diagnosis["smaller"] == ["command_delay"]
    assert not found.error
    run_case(case, RoughTestSettings(healthy=False, rough=False, sizes="visible"))
    assert asked[-1] == (["a"], {})
    assert made[-1] == (77, (), {"sizes": "visible", "healthy": False, "exact": True})

    def broken(*_, **__):
        raise LeglabError("no window is left")

    monkeypatch.setattr(rough_selftest, "diagnosed", broken)
    assert run_case(case, RoughTestSettings()).error == "LeglabError: no window is left"


def test_what_cannot_be_asked_is_refused(tmp_path):
    with pytest.raises(LeglabError, match="'tiny'"):
        RoughTestSettings(sizes="tiny")
    with pytest.raises(LeglabError, match="'double'"):
        rough_self_test(tmp_path, kinds=("double",))
    assert not list(tmp_path.iterdir())


@pytest.mark.slow("a whole diagnosis of a rough bench")
def test_a_case_goes_through_the_diagnosis(monkeypatch):
    """Two short recordings of a rough specimen with a strong fault, a real diagnosis."""
    whole = rough_selftest.rough_case
    monkeypatch.setattr(
        rough_selftest, "rough_case", lambda *a, **k: whole(*a, **{**k, "duration": 2.0})
    )
    five = ("internal_leakage", "valve_bias", "payload", "coulomb_friction", "command_delay")
    monkeypatch.setattr(
        rough_selftest, "diagnosed", partial(rough_selftest.diagnosed, effects=five)
    )
    case = RoughTestCase(kind="single", number=0, specimen=5, faults=("internal_leakage",))
    found = run_case(case, RoughTestSettings(healthy=False))
    assert found.error == ""
    assert found.severities[0][0] == "internal_leakage"
    assert {"verdict", "effects", "gap", "notes"} <= found.diagnosis.keys()
    assert len(found.ranking) == 5
    kept = json.loads(json.dumps(asdict(found)))
    assert rough_selftest._OUTCOME.validate_python(kept) == found


@pytest.mark.parametrize(
    ("options", "settings"),
    [
        (["--rough"], RoughTestSettings(seed=4)),
        (["--rough", "--no-healthy"], RoughTestSettings(healthy=False, seed=4)),
        (
            ["--sizes", "visible"],
            RoughTestSettings(rough=False, healthy=False, sizes="visible", seed=4),
        ),
    ],
)
def test_the_command_line_runs_it(monkeypatch, tmp_path, capsys, options, settings):
    asked = []

    def fake(folder, count, settings, *, processes, scheduler, progress):
        asked.append((folder, count, settings, processes, scheduler))
        return [outcome("single", ("payload",), [("payload", 0.9)])]

    monkeypatch.setattr(rough_selftest, "rough_self_test", fake)
    words = ["diagnosis_self_test", "--cases", "3", "--seed", "4", "--out", str(tmp_path)]
    monkeypatch.setattr("sys.argv", ["benchmarks", *words, "--jobs", "1", *options])
    main()
    assert asked == [(tmp_path, 3, settings, 1, None)]
    assert "| confidence | names | right |" in capsys.readouterr().out
    assert (tmp_path / f"{settings.name}-confusion.png").is_file()


@pytest.mark.parametrize(
    ("options", "reason"),
    [(["--cases", "-5"], "cases is -5; allowed: 1 or more"), (["--jobs", "0"], "jobs is 0")],
)
def test_the_command_line_refuses_what_cannot_be(monkeypatch, tmp_path, capsys, options, reason):
    words = ["diagnosis_self_test", "--out", str(tmp_path / "out"), *options]
    monkeypatch.setattr("sys.argv", ["benchmarks", *words])
    with pytest.raises(SystemExit, match="2"):
        main()
    assert reason in capsys.readouterr().err
