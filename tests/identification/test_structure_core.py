"""Free runs and their sums in the core, against NumPy."""

import numpy as np
import pytest

from leglab import SettingsError
from leglab.identification import (
    Basis,
    Constant,
    Lags,
    Signal,
    Spline,
    SplineNarx,
    SplineNarxSettings,
    Term,
)
from leglab.identification.structure import blocks
from leglab.identification.structure.fit import (
    Fit,
    Further,
    Problem,
    Record,
    Simulator,
    Stretch,
    fit,
    one_step,
    one_step_stretches,
)
from leglab.identification.structure.lags import promises

Y, U = Signal(name="y", lower=-2.0, upper=2.0), Signal(name="u", lower=-1.0, upper=3.0)
TERMS = (
    Term(signal="y", lag=1, times=("u", 1)),
    Term(signal="y", lag=1, degree=3),
    Term(signal="y", lag=2, curve="hinge", at=0.3),
    Term(signal="u", lag=0, curve="sign", width=0.2, change=True, times=("y", 2)),
    Term(signal="y", lag=1, curve="sign", at=0.1, width=0.5, change=True),
    Spline(signal="y", lag=1, basis=Basis.uniform(-1.5, 1.5, 5, outside="linear")),
)


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    u = rng.uniform(-1, 3, (60, 1))
    y = np.cumsum(rng.normal(0, 0.3, 60)) * 0.3
    template = SplineNarxSettings(output=Y, inputs=(U,), features=(Constant(),))
    return Problem([Record(u, y)], template)


def smooth(s):
    return s * (s + 0.5) / (s * (s + 0.5) + 0.5)


def by_hand(problem, features, theta, stretch):
    """Free run in plain Python, in units of the output."""
    record = problem.records[0]
    ys, us = record.y / 2.0, (record.u[:, 0] - 1.0) / 2.0
    own = list(ys[: stretch.start])

    def value(name, lag, t):
        return us[t - lag] if name == "u" else own[t - lag]

    for t in range(stretch.start, stretch.start + stretch.length):
        phi = []
        for f in features:
            if isinstance(f, Constant):
                phi.append(1.0)
            elif isinstance(f, Lags):
                phi += [value(f.signal, f.first + k, t) for k in range(f.count)]
            elif isinstance(f, Spline):
                x = 2.0 * value(f.signal, f.lag, t)
                low, high = f.basis.knots[0], f.basis.knots[-1]
                inside = min(max(x, low), high)
                for i in range(f.basis.count):
                    spline = f.basis.spline(np.eye(f.basis.count)[i])
                    phi.append(spline(inside) + (x - inside) * spline(inside, 1))
            else:
                x = value(f.signal, f.lag, t)
                at, width = f.at, f.width
                centre = 1.0 if f.signal == "u" else 0.0
                if f.change:
                    x, centre = x - value(f.signal, f.lag + 1, t), 0.0
                d = x - (at - centre) / 2.0
                w = width / 2.0
                g = {
                    "power": x**f.degree,
                    "hinge": max(d, 0.0),
                    "sign": np.sign(d) * smooth(abs(d) / w),
                }[f.curve]
                phi.append(g * (value(*f.times, t) if f.times else 1.0))
        own.append(float(np.dot(theta, phi)))
    return 2.0 * np.array(own[stretch.start :])


@pytest.mark.parametrize("term", TERMS, ids=lambda f: type(f).__name__ + getattr(f, "curve", ""))
def test_a_free_run_and_its_sensitivities_are_those_of_numpy(problem, term):
    features = (Lags(signal="y", count=2), Lags(signal="u", first=0, count=2), Constant(), term)
    settings = problem.model(features)
    theta = np.random.default_rng(1).normal(0, 0.2, sum(b.count for b in settings.blocks))
    stretch = Stretch(0, 4, 40)
    simulator = Simulator(settings, problem.records)
    model = problem.identifier(Fit(features, theta, 0.0))
    u, y = problem.records[0].u[:44, 0], problem.records[0].y
    run = model.free_run(u[4 - model.lags :], y[4 - model.lags : 4])[model.lags :]
    assert run == pytest.approx(by_hand(problem, features, theta, stretch), abs=1e-12)
    step = 1e-6
    columns = []
    for k in range(len(theta)):
        moved = [
            by_hand(problem, features, theta + s * step * np.eye(len(theta))[k], stretch)
            for s in (1, -1)
        ]
        columns.append((moved[0] - moved[1]) / (2 * step) / 2.0)  # scaled
    j = np.column_stack(columns)
    r = (problem.records[0].y[4:44] - run) / 2.0
    found = simulator.sums(theta, [stretch], sensitivities=True)
    assert found.products == pytest.approx(j.T @ j, rel=1e-5, abs=1e-6)
    assert found.gradient == pytest.approx(j.T @ r, rel=1e-5, abs=1e-6)
    assert (found.error, found.samples) == (pytest.approx(r @ r), 40)


def test_the_promise_of_a_feature_is_what_a_fit_makes_of_it(problem):
    rng = np.random.default_rng(2)
    u = rng.uniform(-1, 3, (400, 1))
    y = np.zeros(400)
    for t in range(1, 400):
        y[t] = 0.6 * y[t - 1] + 0.3 * max(u[t - 1, 0] - 1.0, 0) + 0.01 * rng.normal()
    template = problem.template
    own = Problem([Record(u, y)], template)
    linear = (Lags(signal="y", count=1), Lags(signal="u", first=1, count=1), Constant())
    stretches = [Stretch(0, s, 50) for s in range(5, 350, 25)]
    start = fit(own, linear, one_step(own, linear), stretches, 1.0)
    wanted = [Term(signal="u", lag=1, curve="hinge", at=a) for a in (-0.5, 1.0, 2.5)]
    gains = promises(own, start, Further(template, wanted), stretches, 1.0)
    assert int(np.argmax(gains)) == 1
    after = fit(own, (*linear, wanted[1]), np.append(start.theta, 0.0), stretches, 1.0)
    assert 1 - (after.error / start.error) ** 2 == pytest.approx(gains[1], abs=0.05)


def test_a_stop_holds_the_free_run_and_its_sensitivities(problem):
    features = (Lags(signal="y", count=1), Constant())
    held = problem.template.__class__(
        output=Y, inputs=(U,), features=features, free_run_limits=(-1.0, 1.0)
    )
    simulator = Simulator(held, problem.records)
    model = SplineNarx(held)
    model.parameters = np.array([2.0, 0.5])
    run = model.free_run(problem.records[0].u[:, 0], problem.records[0].y[:1])[1:]
    assert run.min() >= -1.0
    assert run.max() == 1.0
    found = simulator.sums(np.array([2.0, 0.5]), [Stretch(0, 2, 40)], sensitivities=True)
    assert np.isfinite(found.products).all()


def test_samples_that_are_missing_do_not_count(problem):
    y = problem.records[0].y.copy()
    y[20:25] = np.nan
    own = Problem([Record(problem.records[0].u, y)], problem.template)
    simulator = Simulator(own.model((Lags(signal="y", count=1), Constant())), own.records)
    found = simulator.sums(np.array([0.5, 0.0]), [Stretch(0, 2, 40)], sensitivities=True)
    assert found.samples == 35
    assert np.isfinite(found.error)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"signal": "y", "lag": 0}, "lag 0 of the output"),
        ({"signal": "u", "lag": -1}, "must be an integer"),
        ({"signal": "u", "curve": "bend"}, "curve 'bend'"),
        ({"signal": "u", "degree": 9}, "degree is 9"),
        ({"signal": "u", "width": -1.0}, "width is -1"),
        ({"signal": "u", "times": ("y", 0)}, "lag 0 of the output"),
        ({"signal": "v"}, "unknown signal 'v'"),
    ],
)
def test_a_wrong_term_is_refused(fields, message):
    with pytest.raises(SettingsError, match=message):
        SplineNarxSettings(output=Y, inputs=(U,), features=(Term(**fields),))


def test_no_fit_sees_the_block_that_is_held_out(problem):
    rng = np.random.default_rng(3)
    records = [Record(rng.normal(size=(n, 1)), rng.normal(size=n)) for n in (300, 200)]
    own = Problem(records, problem.template)
    depth = 4
    for count in blocks.BLOCKS:
        held = blocks.blocks(own, depth, count)
        assert sum(block.length for block in held) == 500 - 2 * depth
        for block in held:
            used = blocks.stretches(own, depth, 60, 10**6, block)
            used += one_step_stretches(own, depth, block)
            seen = [(s.start - depth, s.start + s.length) for s in used if s.record == block.record]
            assert len(used) > 100
            assert all(b <= block.start or a >= block.start + block.length for a, b in seen)
