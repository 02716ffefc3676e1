"""The replication: plant, networks, scores and what the page reports."""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import approx_fprime

from leglab.base.errors import LeglabError
from replication import (
    deployed,
    experiments,
    networks,
    page,
    paper,
    replicate,
    run,
)
from replication.experiments import compare, multiplications
from replication.online import OnlineSettings, run_online
from replication.paper import score, table_1, worst_deviation
from replication.plant import (
    CUTOFF,
    HOLD,
    MEAN,
    VARIANCE,
    Plant,
    exact_free_run,
    simulate,
)


@pytest.fixture(scope="module")
def signals():
    u, y = simulate([paper.SEED])
    return u[0], y[0]


@pytest.fixture(scope="module")
def comparison(signals):
    return compare(*signals, instances=paper.INSTANCES, seed=paper.SEED)


def test_plant_agrees_with_an_adaptive_integrator():
    plant = Plant()
    u, y = simulate([7], 40)
    noise = np.random.default_rng(7).normal(MEAN, np.sqrt(VARIANCE), 80)
    state = np.zeros(3)
    for k, held in enumerate(noise):
        if k % 2 == 0:
            assert (u[0, k // 2], y[0, k // 2]) == pytest.approx(state[:2], abs=3e-6)

        def rates(_, x, held=held):
            spring = plant.k_1 * x[1] + plant.k_2 * x[1] ** 3 * np.sin(x[1]) ** 2
            filtered = 2 * np.pi * CUTOFF * (held - x[0])
            return filtered, x[2], (x[0] - plant.b * x[2] - spring) / plant.m

        solution = solve_ivp(rates, (0, HOLD), state, rtol=1e-10, atol=1e-12)
        state = solution.y[:, -1]


def test_realisations_do_not_depend_on_their_company():
    alone, together = simulate([5], 200), simulate([4, 5], 200)
    for a, b in zip(alone, together, strict=True):
        np.testing.assert_array_equal(a[0], b[1])


def test_change_acts_from_its_sample_on():
    _, y = simulate([0], 300)
    _, changed = simulate([0], 300, after=[Plant().changed("k_1", 2.0)], change_at=100)
    np.testing.assert_array_equal(y[0, :101], changed[0, :101])
    assert np.all(y[0, 102:110] != changed[0, 102:110])


def test_exact_plant_on_a_constant_input_meets_its_static_gain():
    y = exact_free_run(np.full((1, 2000), 0.7))[0, -1]
    plant = Plant()
    assert plant.k_1 * y + plant.k_2 * y**3 * np.sin(y) ** 2 == pytest.approx(0.7, rel=1e-9)


@pytest.mark.parametrize("problem", [networks._equation_error, networks._output_error])
def test_jacobian_of_the_networks(signals, problem):
    u, y = (signal[:150] - 0.6 for signal in signals)
    residuals, jacobian = problem(u, y)
    weights = np.random.default_rng(1).uniform(-0.5, 0.5, networks.N_PARAMETERS)
    numeric = approx_fprime(weights, residuals, 1e-7)
    np.testing.assert_allclose(jacobian(weights), numeric, atol=2e-6)


def test_networks_stop_after_ten_linearisations(signals, monkeypatch):
    calls = []
    gradient = networks._gradient
    monkeypatch.setattr(networks, "_gradient", lambda *a: calls.append(1) or gradient(*a))
    u, y = (signal[:400] for signal in signals)
    networks.train(u, y, output_error=False, rng=np.random.default_rng(0))
    assert len(calls) == networks.ITERATIONS


def test_score_of_a_known_residual():
    y = np.array([0.0, 1.0, 2.0, 3.0])
    got = score(y, np.column_stack([y, y + 0.5]))
    np.testing.assert_allclose(got.rms, [0.0, 0.5])
    np.testing.assert_allclose(got.r2, [1.0, 1.0 - 0.25 / 1.25])


@pytest.mark.slow("hundreds of networks")
def test_validation_means_lie_within_15_percent_of_the_paper(comparison):
    for model in paper.MODELS:
        got, printed = comparison.scores["validation"][model], paper.TABLE_1["validation"][model]
        assert np.mean(got.rms) == pytest.approx(printed.rms_mean, rel=0.15), model
        assert np.mean(got.r2) == pytest.approx(printed.r2_mean, rel=0.15), model
    assert worst_deviation(comparison.scores) < 0.15


@pytest.mark.slow("hundreds of networks")
def test_order_of_the_online_models_is_the_papers(comparison):
    rms = {m: np.mean(s.rms) for m, s in comparison.scores["validation"].items()}
    assert rms["BSNN-ARX"] < rms["ARX"] < rms["BSNN"]


@pytest.mark.slow("hundreds of networks")
def test_table_shows_every_model_and_the_printed_values(comparison):
    table = table_1(comparison.scores)
    assert all(f"| {model} |" in table for model in paper.MODELS)
    assert "(0.0116)" in table


def test_paper_s_advantage_reverses_with_the_initial_gain(signals):
    scores = run_online(*signals, 20, 0, OnlineSettings(initial_gain=1e4)).scores(signals[1])
    rms = {m: np.mean(s.rms) for m, s in scores["validation"].items()}
    assert rms["ARX"] < rms["BSNN-ARX"]


@pytest.mark.slow("hundreds of networks")
def test_printed_learning_constant_reverses_the_order():
    rows = experiments.orders(*simulate(range(10), paper.N_SAMPLES), 5, 0)
    assert len(rows) == 2 * len(experiments.INITIAL_GAINS)
    for row in rows:
        if row.learning_constant == paper.PRINTED_LEARNING_CONSTANT:
            assert row.arx < row.bsnn_arx
            assert row.better <= 1
        elif row.initial_gain <= 10:
            assert row.bsnn_arx < row.arx


def test_page_says_what_the_printed_constant_does(tmp_path, signals):
    rows = experiments.orders(*simulate(range(2), paper.N_SAMPLES), 2, 0)
    readings = experiments.readings(*signals, 2, 0)
    sheet = page.Page(tmp_path, "a page")
    page.printed_constant(sheet, rows, readings, 2)
    text = sheet.write().read_text()
    assert "gamma_2 = 0.004" in text
    assert "is reversed: on the noise" in text
    assert f"BSNN-ARX has {readings[2][4]:.4f}, ARX {readings[2][3]:.4f}" in text
    assert sum(line.startswith("| ") for line in text.splitlines()) == 10


def test_same_seed_same_bits(signals):
    first, second = (run_online(*signals, 5, 11) for _ in range(2))
    for model in experiments.ONLINE:
        np.testing.assert_array_equal(first.runs[model].validation, second.runs[model].validation)


def test_printed_eq_9_jumps_and_the_corrected_one_does_not():
    u, shapes = experiments.spline_shapes()
    steps = {name: np.max(np.abs(np.diff(shape))) for name, shape in shapes.items()}
    slope = 1.0 / 0.08  # steepest slope of the corrected spline
    assert steps["corrected"] <= 1.01 * slope * (u[1] - u[0])
    assert steps["printed"] > 0.3


def test_multiplications_are_those_of_section_3_2():
    assert multiplications(6, 8) == 238
    assert multiplications(6, 0) == 198


@pytest.mark.slow("hundreds of networks")
def test_deployed_free_run_is_near_the_floor():
    floor, rows = deployed.free_runs(range(10))
    free_run = {row[0]: row[3] for row in rows}
    assert free_run[deployed.DEPLOYED] <= 1.15 * floor
    assert free_run["ARX (na 3, nb 3)"] > 2.0 * floor


@pytest.mark.slow("hundreds of networks")
def test_deployed_forgetting_recovers_within_2_s():
    modes = deployed.forgetting_modes()
    chosen = {name: modes[name] for name in ("plain", deployed.DEPLOYED_MODE)}
    results = deployed.readaptation(range(20), chosen)
    for change, recovery in results[deployed.DEPLOYED_MODE].items():
        assert np.max(recovery.samples) <= 400, change
        assert recovery.pooled <= 400, change
        assert recovery.before <= 1.1 * results["plain"][change].before


@pytest.mark.parametrize("instances", [0, -1, 2.0, True])
def test_instances_must_be_a_positive_integer(instances, tmp_path):
    with pytest.raises(LeglabError, match="instances is"):
        replicate(instances, tmp_path)


@pytest.mark.slow("hundreds of networks")
def test_page_has_all_figures(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "REALISATIONS", 2)
    monkeypatch.setattr(run, "CHANGE_SEEDS", 2)
    monkeypatch.setattr(run, "LONG_RUN", 2 * paper.N_SAMPLES)
    lines = []
    result = replicate(3, tmp_path, progress=lines.append)
    text = result.page.read_text()
    assert lines
    for number in (7, 8, 9, 10, 11, 12, 13, 14, 16, 17):
        assert any(path.name.startswith(f"fig_{number:02d}") for path in result.figures)
    for path in result.figures:
        assert path.stat().st_size > 5000
        assert f"({path.name})" in text
    stored = json.loads(json.dumps(result.to_json(), allow_nan=False))
    assert stored["worst_deviation"] == result.worst_deviation
    scores = stored["scores"]["validation"]["BSNN-ARX"]
    assert scores["instances"] == 3
    assert len(stored["orders"]) == len(result.orders)
    assert scores["rms_mean"] == result.comparison.scores["validation"]["BSNN-ARX"].rms.mean()
