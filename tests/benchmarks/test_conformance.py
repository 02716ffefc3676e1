"""Cases of docs/concepts/physics.md, in the continuous model and in MuJoCo at 0.5 and 1 ms."""

import functools
import json
import math
from dataclasses import replace
from itertools import chain
from pathlib import Path

import pytest
from rich.console import Console

from benchmarks.verification import Check, cases, report
from benchmarks.verification.cases import (
    CASES,
    LEAKAGE,
    bulk_modulus,
    dynamic_viscosity_ratio,
    null_creep,
    stall_pressure,
    steady_speed,
    stiffness,
    walther,
)
from leglab.base.errors import LeglabError
from leglab.cli import main
from tests.tables import difference, made, printed

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "data" / "hydraulics_conformance.json").read_text()
)
GOOD = Check(case="a", quantity="q", solver="s", unit="m", expected=1.0, got=1.0, tolerance=1e-3)
STEADY = ("a no-load speed", "b load", "k worn stall", "null leak")


@functools.cache
def rows_of(name):
    return tuple(CASES[name]())


@pytest.mark.parametrize("name", CASES)
def test_every_row_passes(name):
    rows = rows_of(name)
    failed = [(r.quantity, r.solver, r.expected, r.got, r.deviation) for r in rows if not r.passed]
    assert rows
    assert not failed
    if name not in {"f viscosity", "f2 bulk modulus", "warming", "supply droop"}:
        assert {row.solver for row in rows} == {"continuous", "MuJoCo 1 ms", "MuJoCo 0.5 ms"}


@pytest.mark.parametrize(("got", "passes"), [(1.0009, True), (1.002, False), (math.nan, False)])
def test_a_wrong_value_fails(got, passes):
    assert replace(GOOD, got=got).passed is passes


# The closed forms themselves against the stored numbers, which three stiff solvers agreed on.


@pytest.mark.parametrize("entry", REFERENCE["a_velocity"])
def test_no_load_formula(entry):
    v, pa, pb = steady_speed(entry["xs"], tank=entry["pt"])
    assert (v, pa, pb) == pytest.approx(
        (entry["v_closed"], entry["pA_closed"], entry["pB_closed"]), rel=1e-12
    )
    assert v == pytest.approx(entry["v_sim"], rel=1e-3)


@pytest.mark.parametrize("entry", REFERENCE["b_load"])
def test_load_formula(entry):
    v = steady_speed(entry["xs"], float(entry["F"]))[0]
    assert v == pytest.approx(entry["v_closed"], rel=1e-12)


@pytest.mark.parametrize("entry", REFERENCE["c_omega_h"])
def test_resonance_formula(entry):
    assert math.sqrt(stiffness(entry["x"]) / entry["m"]) == pytest.approx(
        entry["w_closed"], rel=1e-12
    )


@pytest.mark.parametrize("entry", REFERENCE["e_drift"]["e4_null_leak_creep"])
def test_creep_formula(entry):
    # The stored one has the laminar transition of the orifice, the closed form has not.
    v, pa = null_creep(entry["F"])
    assert v == pytest.approx(entry["v_closed"], rel=1e-3)
    assert pa == pytest.approx(entry["pA_closed"], rel=1e-4)


@pytest.mark.parametrize("entry", REFERENCE["f_viscosity"])
def test_viscosity_formula(entry):
    grades = {"VG32": (32.0, 5.4), "VG46": (46.0, 6.8), "VG68": (68.0, 8.7)}
    for grade, points in grades.items():
        assert walther(entry["T"], *points) == pytest.approx(entry[grade], rel=1e-9)


@pytest.mark.parametrize("entry", REFERENCE["f2_beta"])
def test_bulk_modulus_formula(entry):
    for air, label in ((0.005, "0.5%"), (0.01, "1%"), (0.03, "3%")):
        for index in (1.0, 1.4):
            stored = entry[f"x{label}_n{index:.1f}"] * 1e9
            # The stored table holds the liquid share at its atmospheric volume.
            got = bulk_modulus(entry["p_bar"] * 1e5, air, index)
            assert got == pytest.approx(stored, rel=0.02)


@pytest.mark.parametrize("entry", REFERENCE["k_worn_stall"])
def test_stall_formula(entry):
    # The stored hot entry lets the orifice gain grow with 1/sqrt(rho) as well; K of
    # docs/concepts/physics.md is constant. At 80 degC that is 0.26 % of the pressure.
    ratio = dynamic_viscosity_ratio(entry["T"])
    density = ratio / (walther(entry["T"]) / walther(40.0))
    spool = entry["xs"] / math.sqrt(density)
    assert stall_pressure(spool, entry["leak_mult"] * LEAKAGE / ratio) == pytest.approx(
        entry["pA_closed"], rel=1e-6
    )


def test_rows_hold_the_stored_numbers():
    """What the continuous model gives equals the stored solutions, to four digits."""
    rows = {
        row.quantity: row
        for row in chain.from_iterable(rows_of(name) for name in STEADY)
        if row.solver == "continuous"
    }
    blocked = {r.quantity: r for r in rows_of("e blocked ports") if r.solver == "continuous"}
    for entry in REFERENCE["a_velocity"]:
        row = rows[f"speed at x_s = {entry['xs']:+g}, tank {entry['pt'] / 1e5:g} bar"]
        assert row.got == pytest.approx(entry["v_sim"], rel=4e-4)
    for entry in REFERENCE["k_worn_stall"]:
        label = f"leakage x{entry['leak_mult']} at {entry['T']} degC, x_s = {entry['xs']:g}"
        near = 1e-5 if entry["T"] == 40 else 3e-3  # see test_stall_formula
        assert rows[f"pressure A, {label}"].got == pytest.approx(entry["pA_sim"], rel=near)
    for bar, stored in ((160, "160bar"), (210, "210bar")):
        row = rows[f"supply flow at {bar} bar"]
        assert row.got == pytest.approx(REFERENCE[f"valve_null_leak_lpm_at_{stored}"], rel=1e-3)
    for entry in REFERENCE["e_drift"]["e3_both_blocked"]:
        row = blocked[f"way under {entry['F']:g} N, both ports blocked"]
        assert row.got == pytest.approx(entry["dx_sim"], rel=1e-3)
        assert row.expected == pytest.approx(entry["dx_lin"], rel=1e-9)


def test_the_page_shows_the_closest_rows(monkeypatch):
    (part,) = (part for part in made() if "physics_table" in part.command)
    shared = {name: functools.partial(rows_of, name) for name in CASES}
    monkeypatch.setattr(cases, "CASES", shared)
    changed = difference(part, printed(part.command))
    assert not changed, f"{changed}\nif this change is wanted: python -m tests.tables --write"


def test_verify_prints_tables_and_reports_a_failure(monkeypatch, tmp_path):
    bad = replace(GOOD, got=2.0, quantity="wrong one")
    monkeypatch.setattr(report, "shared_data", lambda part: tmp_path)
    monkeypatch.setattr(report, "replay_all", lambda folder: [])
    for rows, outcome in (([GOOD], True), ([GOOD, bad], False)):
        monkeypatch.setattr(report, "CASES", {"a": lambda rows=rows: iter(rows)})
        console = Console(record=True, width=160)
        assert report.verify(console=console) is outcome
        text = console.export_text()
        assert ("wrong one" in text) is not outcome


def test_checks_as_json(monkeypatch, tmp_path, capsys):
    bad = replace(GOOD, got=math.nan)
    monkeypatch.setattr(report, "replay_all", lambda folder: [])

    def missing(part):
        raise LeglabError("no recordings here")

    for rows, folder, status in (([GOOD], missing, 0), ([GOOD, bad], lambda part: tmp_path, 1)):
        monkeypatch.setattr(report, "CASES", {"a": lambda rows=rows: iter(rows)})
        monkeypatch.setattr(report, "shared_data", folder)
        if status:
            with pytest.raises(SystemExit) as exit_:
                main(["verify", "--json"])
            assert exit_.value.code == status
        else:
            main(["verify", "--json"])
        found = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
        assert found["passed"] is (status == 0)
        assert len(found["checks"]) == len(rows)
        assert found["left_out"] == (None if status else "no recordings here")
    assert found["checks"][1]["got"] is None
    assert found["checks"][1]["passed"] is False
