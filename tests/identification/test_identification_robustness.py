"""What kills implementations like this: windup, wild values, bad samples, long silence."""

import numpy as np
import pytest

from leglab.identification import (
    Basis,
    BsnnArx,
    BsnnArxSettings,
    ChangeDetection,
    Constant,
    Guard,
    Hammerstein,
    Lags,
    Rls,
    Spline,
    SplineNarx,
    SplineNarxSettings,
)
from tests.reference import adversary

UPDATES = 1_000_000
SCALARS = ("float64", "float32")
RLS = {
    "none": Rls(),
    "exponential": Rls(forgetting="exponential", forgetting_factor=0.98),
    "directional": Rls(forgetting="directional", forgetting_factor=0.98),
    "adaptive": Rls.adaptive(),
    "restored": Rls(
        initial_gain=10.0, forgetting="variable", forgetting_factor=0.98, restore_interval=1
    ),
    "inflate": Rls(change=ChangeDetection(action="inflate", gain=10.0)),
}


def narx(scalar="float64", rls=None, after=0, **changes):
    """Every kind of feature at once."""
    basis = Basis.uniform(-1, 1, 6, outside="linear")
    features = (
        Spline(signal="y", lag=1, basis=basis),
        Spline(signal="u", lag=1, basis=Basis.asinh(-1, 1, 7, width=0.1), times=("y", 1)),
        Hammerstein(signal="u", basis=basis),
        Lags(signal="y", count=3),
        Constant(),
    )
    return SplineNarx(
        SplineNarxSettings(
            features=features,
            rls=rls or Rls(),
            output_error_after=after,
            pole_limit=0.999,
            scalar=scalar,
            **changes,
        )
    )


def assert_sound(model):
    """Parameters finite; F finite, its factor D positive, so F positive definite."""
    assert np.all(np.isfinite(model.parameters))
    assert np.all(np.isfinite(model.gain()))
    model._bank.load_state(model._bank.state())  # refuses a D that is not positive
    n, bound = len(model.gain()), model.settings.rls.gain_bound
    assert model.diagnostics()["gain_trace"] <= n * bound * (1 + 1e-5)


@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize("rls", RLS)
def test_bsnn_arx_survives(rls, scalar):
    network = BsnnArxSettings.paper_mode().network
    model = BsnnArx(BsnnArxSettings(network=network, rls=RLS[rls], scalar=scalar, opening=4.0))
    rng = np.random.default_rng(11)
    model.randomise(rng)
    for u, y in adversary.samples(UPDATES, rng):
        model.run(u, y, missing="skip")
        assert_sound(model)
    assert np.all(np.abs(model.weights) < 1)  # what (1 - |w|) is for


@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize("after", [0, 1000])
@pytest.mark.parametrize("plausible", [0.0, 5.0])
def test_spline_narx_survives(after, scalar, plausible):
    model = narx(scalar, Rls.adaptive(), after, plausible_range=plausible)
    rng = np.random.default_rng(12)
    for u, y in adversary.samples(UPDATES, rng):
        model.run(u, y, missing="skip")
        assert_sound(model)


@pytest.mark.parametrize("rls", ["exponential", "directional", "adaptive"])
def test_gain_stays_bounded_under_constant_input(rls):
    """15 s of constant input drive the trace of a plain implementation beyond 1e13."""
    model = narx(rls=RLS[rls])
    rng = np.random.default_rng(2)
    model.run(*rng.uniform(-1, 1, (2, 2000)))
    model.run(np.full(3000, 0.3), np.full(3000, 0.2))
    assert_sound(model)


def test_bound_lets_excited_directions_forget():
    """A bound on the gain must not stop the model from following what is excited."""
    rng = np.random.default_rng(3)
    u = rng.uniform(0, 0.5, 4000)  # half of the splines are never reached
    settings = SplineNarxSettings(
        features=(Spline(signal="u", lag=0, basis=Basis.uniform(-1, 1, 12)),),
        rls=Rls(forgetting="exponential", forgetting_factor=0.98, gain_bound=1e4),
    )
    model = SplineNarx(settings)
    model.run(u, u**2)
    before = model.run(u, -(u**2))  # the map changes sign
    assert np.sqrt(np.mean((before[-500:] + u[-500:] ** 2) ** 2)) < 1e-3
    assert_sound(model)


def test_prior_comes_back_where_nothing_excites():
    """Half of the splines are learned, then never reached again: they return to zero, F to F(0)."""
    rng = np.random.default_rng(3)
    settings = SplineNarxSettings(
        features=(Spline(signal="u", lag=0, basis=Basis.uniform(-1, 1, 12)),),
        rls=Rls(
            initial_gain=1000.0,
            forgetting="exponential",
            forgetting_factor=0.99,
            gain_bound=1e9,
            restore_interval=1,
        ),
    )
    model = SplineNarx(settings)
    u = rng.uniform(-1, 1, 2000)
    model.run(u, 1 + u**2)
    assert np.all(np.abs(model.theta) > 0.5)
    u = rng.uniform(0.5, 1, 20000)
    model.run(u, 1 + u**2)
    assert np.all(np.abs(model.theta[:5]) < 0.01)
    # Twelve updates apart, each gives back what its wait has forgotten: a little above F(0).
    assert np.all(np.diag(model.gain())[:5] < 1200.0)
    assert np.all(np.diag(model.gain())[:5] > 800.0)
    inside = u[u > 0.6][:100]
    np.testing.assert_allclose(model.run(inside, 1 + inside**2), 1 + inside**2, atol=2e-3)


BAD = [(np.nan, 0.1), (0.1, np.inf), (-np.inf, np.nan)]


@pytest.mark.parametrize("sample", BAD)
@pytest.mark.parametrize("make", [lambda: BsnnArx(BsnnArxSettings.paper_mode()), narx])
def test_bad_sample_leaves_parameters(make, sample):
    model = make()
    rng = np.random.default_rng(4)
    model.run(*rng.uniform(0, 0.5, (2, 500)))
    parameters, gain = model.parameters, model.gain()
    assert np.isfinite(model.update(*sample))
    np.testing.assert_array_equal(model.parameters, parameters)
    np.testing.assert_array_equal(model.gain(), gain)
    for u, y in rng.uniform(0, 0.5, (model.lags, 2)):  # the regressor is not yet clean
        model.update(u, y)
    np.testing.assert_array_equal(model.parameters, parameters)
    model.update(0.2, 0.3)
    assert np.any(model.parameters != parameters)
    report = model.diagnostics()
    start = model.lags if isinstance(model, SplineNarx) else 0  # filling the empty history
    assert (report["not_finite"], report["recovering"]) == (1, start + model.lags)


def test_guard_counts_saturated_stuck_and_implausible():
    guard = Guard(stuck_samples=5, input_limits=((-0.9, 0.9),))
    model = narx(guard=guard, plausible_range=4.0)
    rng = np.random.default_rng(5)
    model.run(*rng.uniform(-0.5, 0.5, (2, 100)))
    for u, y in [(0.9, 0.1), (-3.0, 0.1), (0.1, 5.0)]:
        model.update(u, y)
    for _ in range(30):  # y does not move although u does
        model.update(rng.uniform(-0.5, 0.5), 0.25)
    report = model.diagnostics()
    assert (report["saturated"], report["implausible"]) == (2, 1)
    assert report["stuck"] == 30 - 5
    # 100 less the empty history, and two before the sensor counts as stuck.
    assert report["learned"] == 100 - model.lags + 5 - model.lags
    parameters = model.parameters
    model.update(0.1, 0.25)
    np.testing.assert_array_equal(model.parameters, parameters)


def test_silence_is_not_a_stuck_sensor():
    model = narx(guard=Guard(stuck_samples=5))
    for _ in range(50):
        model.update(0.0, 0.0)
    assert model.diagnostics()["stuck"] == 0


def test_hopeless_parameters_are_given_up():
    """Where no update stays finite any more, the model starts anew instead of standing still."""
    model = narx(rls=Rls(), plausible_range=0.0)
    model.parameters = np.full(model.parameters.shape, 1e160)
    rng = np.random.default_rng(9)
    u, y = rng.uniform(-0.5, 0.5, (2, 500))
    model.run(u, y)
    report = model.diagnostics()
    assert report["restarts"] == 1
    assert np.max(np.abs(model.theta)) < 100


def test_free_run_of_an_unstable_model_overflows_quietly():
    for outside in ("clamp", "linear", "quadratic"):
        basis = Basis.uniform(-1, 1, 6, outside=outside)
        features = (Spline(signal="y", basis=basis), Spline(signal="y", lag=2, basis=basis))
        model = SplineNarx(SplineNarxSettings(features=(*features, Lags(signal="y")), rls=Rls()))
        model.parameters = np.arange(13) * 1e5 - 3e5
        y = model.free_run(np.ones(2000), [0.1, -0.2])
        assert not np.isfinite(y[-1])
        assert np.all(np.isfinite(model.one_step(np.ones(9), np.ones(9))))


def test_empty_history_teaches_nothing():
    """The machine does not start at the middle of its range."""
    u = np.random.default_rng(8).uniform(-1, 1, 300)
    y = np.full(300, 0.9)
    for t in range(2, 300):
        y[t] = 0.09 + 0.6 * y[t - 1] + 0.3 * y[t - 2] + 0.05 * u[t - 1]
    settings = SplineNarxSettings(
        features=(Lags(signal="y", count=2), Lags(signal="u"), Constant()), rls=Rls()
    )
    model = SplineNarx(settings)
    model.run(u, y)
    assert model.diagnostics()["recovering"] == model.lags
    np.testing.assert_allclose(model.theta, [0.6, 0.3, 0.05, 0.09], atol=1e-3)


def test_poles_are_kept_inside_the_limit():
    u = np.random.default_rng(6).uniform(-1, 1, 400)
    y = np.zeros(400)
    for t in range(2, 400):  # unstable: one pole at 1.02
        y[t] = 1.92 * y[t - 1] - 0.918 * y[t - 2] + 0.01 * u[t - 1]
    features = (Lags(signal="y", count=2), Lags(signal="u"))
    free = SplineNarx(SplineNarxSettings(features=features, rls=Rls()))
    held = SplineNarx(SplineNarxSettings(features=features, rls=Rls(), pole_limit=0.98))
    for model in (free, held):
        model.run(u, y)
    assert np.max(np.abs(free.poles())) == pytest.approx(1.02, abs=1e-3)
    assert np.max(np.abs(held.poles())) <= 0.98 + 1e-9
    assert held.diagnostics()["projected"] > 0
    assert free.project_poles(0.95)
    assert np.max(np.abs(free.poles())) == pytest.approx(0.95, abs=1e-9)
    assert not free.project_poles(0.96)


def test_outlier_and_quiet_data_raise_no_alarm():
    """The detector answers a change of the machine, not stationary noise."""
    rng = np.random.default_rng(7)
    u, y = rng.uniform(-1, 1, 20_000), np.zeros(20_000)
    for t in range(1, 20_000):
        y[t] = 0.8 * y[t - 1] + (0.2 if t < 15_000 else 0.4) * u[t - 1]
    y += 0.01 * rng.standard_normal(20_000)
    settings = SplineNarxSettings(features=(Lags(signal="y"), Lags(signal="u")), rls=Rls.adaptive())
    model = SplineNarx(settings)
    model.run(u[:15_000], y[:15_000])
    assert model.diagnostics()["changes"] == 0
    model.run(u[15_000:15_100], y[15_000:15_100])
    assert model.diagnostics()["changes"] == 1
