"""State-space models with curves: the core against NumPy, their fits, their files."""

import shutil
import subprocess

import numpy as np
import pytest
from scipy.signal import lfilter

from leglab import SettingsError
from leglab._native.structure import StateRuns
from leglab.identification import (
    Constant,
    Signal,
    SplineNarxSettings,
    SplineStateSpace,
    SplineStateSpaceSettings,
    StateSpace,
    load,
    save,
)
from leglab.identification.c_header import c_header
from leglab.identification.settings import Rls
from leglab.identification.structure import blocks, plans, search
from leglab.identification.structure.fit import Fit, Problem, Record, Stretch
from leglab.identification.structure.identified import disturbed_model, rms, settled
from leglab.identification.structure.library import Orders
from leglab.identification.structure.states import StatePath, refitted, segments_of

Y = Signal(name="y", lower=-3.0, upper=5.0)
U = (Signal(name="u", lower=-1.0, upper=3.0), Signal(name="v", lower=-2.0, upper=2.0))
STRUCTURE = StateSpace(states=2, delays=(0, 3), curves=2, splines=5)
SETTINGS = SplineStateSpaceSettings(output=Y, inputs=U, structure=STRUCTURE)


def some_parameters(rng, structure=STRUCTURE):
    theta = 0.4 * rng.normal(size=structure.count)
    theta[: structure.states**2] = [0.8, 0.2, -0.3, 0.7]
    return theta


def some_inputs(rng, n):
    return np.column_stack([rng.uniform(-1, 3, n), rng.uniform(-2, 2, n)])


def by_hand(structure, theta, u, x, before=None):
    """Outputs in plain NumPy, in units of the output; inputs before are the first by default."""
    parts = structure.parts(theta)
    scaled = (u - [s.centre for s in U]) / [s.half_range for s in U]
    deepest = max(structure.delays)
    scaled = np.vstack([np.tile(scaled[0] if before is None else before, (deepest, 1)), scaled])
    late = scaled[np.arange(len(u))[:, None] + deepest - structure.delays, [0, 1]]
    out = []
    for now in late:
        signals = np.concatenate([x, now])
        y = parts.C @ x + parts.D @ now + parts.d
        x = parts.A @ x + parts.B @ now
        for curve in parts.curves:
            z = float(curve.v @ signals)
            inside = min(max(z, -1.0), 1.0)
            spline = structure.basis.spline(curve.e)
            f = float(spline(inside)) + (z - inside) * float(spline(inside, 1))
            x = x + curve.w * f
            y += curve.o * f
        x = np.clip(x, -2, 2)
        out.append(Y.centre + Y.half_range * y)
    return np.array(out)


def test_the_core_simulates_as_numpy_does_and_knows_its_sensitivities():
    rng = np.random.default_rng(0)
    theta, u, x0 = some_parameters(rng), some_inputs(rng, 40), np.array([0.3, -0.2])
    y = rng.uniform(-3, 5, 40)
    y[[5, 30]] = np.nan
    v = np.array([0.4, -0.3, 0.2, 0.1])
    runs = StateRuns(SETTINGS, [(u, y, 0)], v)

    def residual(theta, x0):
        return (y - by_hand(STRUCTURE, theta, u, x0)) / Y.half_range

    error, count, products, gradient = runs.sums(np.append(theta, x0), True)
    wanted = residual(theta, x0)
    known = np.isfinite(wanted)
    assert count == 38
    assert error == pytest.approx(np.sum(wanted[known] ** 2), rel=1e-12)
    # Sensitivities of parameters, of the start, and of a further curve of v.
    richer = StateSpace(states=2, delays=(0, 3), curves=3, splines=5)
    columns = []
    step = 1e-6

    def slope(there, back):
        return (back - there)[known] / (2 * step)

    for k in range(STRUCTURE.count):
        d = step * np.eye(STRUCTURE.count)[k]
        columns.append(slope(residual(theta + d, x0), residual(theta - d, x0)))
    for k in range(2):
        d = step * np.eye(2)[k]
        columns.append(slope(residual(theta, x0 + d), residual(theta, x0 - d)))
    for target in range(3):
        for k in range(5):
            both = []
            for sign in (step, -step):
                curve = np.concatenate([v, np.eye(3)[target], sign * np.eye(5)[k]])
                run = by_hand(richer, np.append(theta, curve), u, x0)
                both.append((y - run) / Y.half_range)
            columns.append(slope(*both))
    psi = np.column_stack(columns)
    assert gradient == pytest.approx(psi.T @ wanted[known], rel=1e-4, abs=1e-5)
    assert products == pytest.approx(psi.T @ psi, rel=1e-4, abs=1e-4)


def test_the_identifier_runs_as_its_equations_and_finds_its_state_from_outputs():
    rng = np.random.default_rng(1)
    model = SplineStateSpace(SETTINGS)
    model.parameters = some_parameters(rng)
    u = some_inputs(rng, 300)
    from_rest = by_hand(STRUCTURE, model.parameters, u, np.zeros(2), before=np.zeros(2))
    assert model.free_run(u) == pytest.approx(from_rest, rel=1e-9)
    machine = by_hand(STRUCTURE, model.parameters, u, np.array([0.9, -0.8]))
    # The predictor linearises the curves; its error of the start decays.
    for run in (model.free_run(u, machine[: model.lags]), model.one_step(u, machine)):
        error = np.abs(run - machine)
        assert error[model.lags :].max() < 0.01 * np.ptp(machine)
        assert error[-100:].max() < 1e-9


def test_rest_and_slopes_are_those_of_the_simulation():
    rng = np.random.default_rng(2)
    model = SplineStateSpace(SETTINGS)
    model.parameters = some_parameters(rng)
    at = {"u": 1.2, "v": -0.5}
    y, _ = model.at_rest(at)
    assert y == pytest.approx(model.free_run(np.tile([1.2, -0.5], (3000, 1)))[-1])
    a, b, c, d = model.linearise(at=at)
    gain = c @ np.linalg.solve(np.eye(2) - a, b) + d
    for k, name in enumerate(at):
        step = 1e-5
        up, down = (model.at_rest({**at, name: at[name] + s})[0] for s in (step, -step))
        assert gain[0, k] == pytest.approx((up - down) / (2 * step), rel=1e-3, abs=1e-6)
        system = model.transfer_function(signal=name, at=at)
        assert float(np.real(system.dcgain())) == pytest.approx(gain[0, k])
        assert len(system.den[0][0]) == 3 + STRUCTURE.delays[k]
    model.parameters = model.parameters * np.r_[np.full(4, 3.0), np.ones(STRUCTURE.count - 4)]
    assert model.project_poles(0.9)
    assert np.abs(model.poles()).max() == pytest.approx(0.9)
    with pytest.raises(SettingsError, match="lacks input 'v'"):
        model.at_rest({"u": 0.0})


def test_a_saved_model_goes_on_to_the_bit_and_stays_finite(tmp_path):
    rng = np.random.default_rng(3)
    model = SplineStateSpace(SplineStateSpaceSettings(
        output=Y, inputs=U, structure=STRUCTURE, process_noise=1e-3, rls=Rls(initial_gain=1.0)
    ))  # fmt: skip
    model.parameters = some_parameters(rng)
    u, y = some_inputs(rng, 400), rng.uniform(-3, 5, 400)
    model.run(u[:200], y[:200])
    save(model, tmp_path / "a.leglab")
    other = load(tmp_path / "a.leglab")
    assert np.array_equal(model.run(u[200:], y[200:]), other.run(u[200:], y[200:]))
    for scale in (1e9, 1e-9, 1.0):
        wild = scale * rng.normal(size=(2000, 2))
        wild[rng.random((2000, 2)) < 0.02] = np.inf
        jumps = scale * np.repeat(rng.normal(size=200), 10)
        jumps[rng.random(2000) < 0.05] = np.nan
        model.run(wild, jumps, missing="skip")
    assert np.isfinite(model.parameters).all()
    assert np.isfinite(model.free_run(u)).all()


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("curves", [0, 2])
def test_the_c_header_runs_as_the_model_does(curves, tmp_path):
    rng = np.random.default_rng(4)
    structure = StateSpace(states=2, delays=(0, 3), curves=curves, splines=5)
    model = SplineStateSpace(SplineStateSpaceSettings(output=Y, inputs=U, structure=structure))
    model.parameters = some_parameters(rng, structure)
    (tmp_path / "model.h").write_text(c_header(model, "leg", 0.01))
    program = """
#include <stdio.h>
#include "model.h"
int main(void) {
  leg_state s = {0};
  double u[2];
  while (scanf("%lf %lf", u, u + 1) == 2) printf("%.17g\\n", leg_next(&s, u));
}
"""
    (tmp_path / "main.c").write_text(program)
    words = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "main.c", "-o", "run"]
    subprocess.run(words, cwd=tmp_path, check=True)
    u = 1.5 * some_inputs(rng, 200)
    done = subprocess.run(
        ["./run"], cwd=tmp_path, check=True, capture_output=True, text=True,
        input="\n".join(f"{a!r} {b!r}" for a, b in u.tolist()),
    )  # fmt: skip
    assert np.array(done.stdout.split(), float) == pytest.approx(model.free_run(u), rel=1e-9)


def wiener_hammerstein(u):
    inner = lfilter([0.2, 0.1], [1, -1.3, 0.5], u)
    return lfilter([0.3], [1, -0.7], np.clip(inner, -0.5, 0.5))


@pytest.fixture(scope="module")
def inner():
    """A machine whose bend lies between two filters, so that no lags of its signals show it."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.uniform(-1, 1, 200), 4)
    y = wiener_hammerstein(u) + 0.003 * rng.normal(size=800)
    return Problem([Record(u[:, None], y)], template_of(u, y))


def template_of(u, y):
    return SplineNarxSettings(
        output=Signal(name="y", lower=float(y.min()), upper=float(y.max())),
        inputs=(Signal(name="u", lower=float(u.min()), upper=float(u.max())),),
        features=(Constant(),),
    )


def test_a_bend_between_two_filters_is_fitted_to_the_noise(inner):
    plan = plans.Plan(plans.STATES, Orders(3, 0, (0,)), 0, 100.0, 1, 3000)
    found = search.searched(inner, plan)
    (structure,) = found.fit.features
    assert structure.curves == 1
    u = np.repeat(np.random.default_rng(6).uniform(-1, 1, 200), 4)
    y = wiener_hammerstein(u)
    model = inner.identifier(found.fit)
    error = rms(model.free_run(u, y[: model.lags]) - y, model.lags)
    assert error < 0.003  # the noise; the best linear model has .02
    assert found.path[0] > 5 * found.path[1]
    assert found.fit.error * inner.deviation == pytest.approx(0.003, rel=0.15)
    # The block that is held out is in no fit: another output there changes nothing.
    block = blocks.blocks(inner, 30, 8)[3]
    changed = inner.records[0].y.copy()
    changed[block.start : block.start + block.length] += 1.0
    other = Problem([Record(inner.records[0].u, changed)], inner.template)
    other.variance, other.deviation = inner.variance, inner.deviation
    fits = [
        StatePath(p, structure, 100.0, 3000, block, found.fit.theta).fit for p in (inner, other)
    ]
    assert np.array_equal(fits[0].theta, fits[1].theta)


def test_a_refit_stays_in_its_minimum_where_records_begin_far_from_rest():
    rng, records = np.random.default_rng(3), []
    for _ in range(4):
        u = np.repeat(rng.uniform(-1, 1, 11), 15)[:150]
        x, late, y = rng.uniform(-3, 3), 0.0, []
        for now in u:
            y.append(x + 0.02 * rng.normal())
            late += 0.2 * (now - late)
            x += 0.01 * (3 * late - x) - 0.004 * x * abs(x)
        records.append(Record(u[:, None], np.array(y)))
    y = np.concatenate([record.y for record in records])
    problem = Problem(records, template_of(np.array([-1.0, 1.0]), y))
    path = StatePath(problem, StateSpace(states=4, delays=(0,)), 10.0, 3000)
    for _ in range(2):
        path.grow()
    assert refitted(problem, path.fit, 10.0, 100_000).error < 1.1 * path.fit.error


def test_a_fit_in_a_wrong_minimum_gives_way_to_the_linear_model(inner):
    linear = search.searched(inner, plans.Plan("linear", Orders(2, 3, (0,)), 200))
    plan = plans.Plan(plans.STATES, Orders(3, 0, (0,)), 0, 100.0, 1, 3000)
    structure = StateSpace(states=3, delays=(0,), curves=1)
    lost = Fit((structure,), np.zeros(structure.count), 1.0)  # of zeros no descent knows a way
    better = tuple(tuple(0.01 * e for e in part) for part in linear.held_out)
    wrong = plans.Candidate(plan, lost, better, ())
    assert settled(inner, [wrong, linear])[0].plan == linear.plan
    found = search.searched(inner, plan)
    assert settled(inner, [found, linear])[0].plan == plan


def test_segments_are_outside_of_a_block_and_within_a_budget(inner):
    block = Stretch(0, 300, 100)
    parts = segments_of(inner, 3000, block)
    assert parts == [Stretch(0, 0, 300), Stretch(0, 400, 400)]
    long = Problem([Record(np.zeros((40_000, 1)), np.ones(40_000))], inner.template)
    parts = segments_of(long, 3000)
    assert sum(s.length for s in parts) <= 3000
    assert parts[0].start == 0
    assert parts[-1].start + parts[-1].length == 40_000
    short = Problem([Record(np.zeros((120, 1)), np.ones(120))] * 20, inner.template)
    assert len(segments_of(short, 3000)) == 20
    many = Problem([Record(np.zeros((120, 1)), np.ones(120))] * 30, inner.template)
    assert sum(s.length for s in segments_of(many, 3000)) > 2500
    assert len(segments_of(many, 100_000)) == 30  # the last fit takes all


def test_many_records_are_held_out_in_part(inner):
    def held_out(count):
        records = [Record(np.zeros((120, 1)), np.ones(120))] * count
        return [b.record for b in blocks.blocks(Problem(records, inner.template), 10, 8)]

    assert held_out(12) == list(range(12))
    assert len(set(held_out(100))) == 16
    assert (held_out(100)[0], held_out(100)[-1]) == (0, 99)


def test_learning_by_one_step_is_chosen_by_the_disturbance():
    """An integrator that is pushed about: its sensor is exact, its state is not."""
    rng = np.random.default_rng(7)
    u = np.repeat(rng.uniform(-1, 1, 150), 4)
    y = lfilter([0.1], [1, -0.95], u + 0.5 * rng.normal(size=600))
    problem = Problem([Record(u[:, None], y)], template_of(u, y))
    fit = StatePath(problem, StateSpace(states=1), 100.0, 3000).fit
    model = problem.identifier(fit)
    disturbed = disturbed_model(problem, model)
    assert disturbed.settings.process_noise > 0
    ahead, alone = (rms(m.one_step(u, y) - y, 20) for m in (disturbed, model))
    assert ahead < 0.5 * alone
    assert ahead < 1.3 * 0.05  # the disturbance of one sample
