"""The C++ core against the plain-NumPy reference, sample by sample, in every mode.

The reference takes a tenth of a millisecond and more a sample. After 10,000 samples every mode
has met two changes of the plant; that rounding does not add up either is left to `make soak`.
"""

import numpy as np
import pytest

from leglab.identification import (
    Basis,
    Bsnn,
    BsnnArx,
    BsnnArxSettings,
    ChangeDetection,
    Constant,
    Hammerstein,
    Lags,
    Rls,
    Signal,
    Spline,
    SplineNarx,
    SplineNarxSettings,
)
from tests.reference import identification_oracle as oracle
from tests.reference.identification_narx_oracle import SplineNarx as OracleNarx

TOLERANCE = 1e-12

# The bound of "exponential, bounded" is reached while silent.
RLS = {
    "none": Rls(initial_gain=5.6),
    "exponential": Rls(forgetting="exponential", forgetting_factor=0.995),
    "exponential, bounded": Rls(
        initial_gain=1.0, forgetting="exponential", forgetting_factor=0.98, gain_bound=2.0
    ),
    "directional": Rls(forgetting="directional", forgetting_factor=0.99),
    "variable": Rls(forgetting="variable", forgetting_factor=0.95, noise_variance=1e-4),
    "variable, reset on change": Rls.adaptive(),
    "variable, prior restored": Rls(
        initial_gain=10.0,
        forgetting="variable",
        forgetting_factor=0.98,
        noise_variance=1e-4,
        restore_interval=3,
        restore_gain=2.0,
    ),
    "inflate on change": Rls(change=ChangeDetection(action="inflate", gain=50.0, ratio=2.0)),
}


@pytest.fixture(
    scope="module",
    params=[10_000, pytest.param(100_000, marks=pytest.mark.soak)],
    ids="{:,}".format,
)
def samples(request):
    return request.param


def record(samples, inputs=1, seed=3):
    """Noisy nonlinear plant that changes three times; (u, y)."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(-0.2, 1.1, (samples, inputs))
    noise = 0.01 * rng.standard_normal(samples)
    y = np.zeros(samples)
    for t in range(2, samples):
        gain = 0.2 if t // (3 * samples // 10) % 2 == 0 else 0.4
        drive = np.tanh(3 * u[t - 1, 0]) + (0.5 * u[t - 1, 1] ** 2 if inputs > 1 else 0)
        y[t] = 1.2 * y[t - 1] - 0.5 * y[t - 2] - 0.05 * y[t - 1] ** 3 + gain * drive + noise[t]
    return u, y


def differ(have, want):
    """Largest difference, relative to one or to the size of what is wanted."""
    want = np.asarray(want)
    return float(np.max(np.abs(have - want) / np.maximum(1, np.abs(want))))


@pytest.fixture(scope="module")
def single(samples):
    return record(samples)


@pytest.mark.parametrize("mode", RLS)
def test_bsnn_arx_agrees(single, mode):
    u, y = single[0][:, 0], single[1]
    settings = BsnnArxSettings(network=BsnnArxSettings.paper_mode().network, rls=RLS[mode])
    model = BsnnArx(settings)
    model.randomise(np.random.default_rng(5))
    start = model.parameters
    network = oracle.Bsnn([oracle.Splines(settings.network.basis[0].knots, "paper")], [0.14])
    network.w1[0][:], network.b = start[6:14], oracle.REAL(start[14])
    other = oracle.BsnnArx(network, oracle.Rls(6, RLS[mode]))
    other.rls.theta[:] = start[:6]
    have = model.run(u, y)
    want = np.array([other.update(*sample) for sample in zip(u, y, strict=True)])
    assert differ(have, want) < TOLERANCE
    parameters = np.concatenate([other.rls.theta, network.w1[0], [network.b]])
    assert differ(model.parameters, parameters) < TOLERANCE
    report = model.diagnostics()
    assert report["changes"] == other.rls.detector.changes
    assert report["bound_violations"] == network.violations
    assert report["largest_contraction"] == pytest.approx(float(network.largest), rel=1e-12)
    if "change" in mode:
        assert report["changes"] >= 2
    if "bounded" in mode:
        assert report["gain_trace"] <= 6 * 2.0 * (1 + 1e-12)


def test_two_layer_network_agrees(samples):
    u, y = record(samples, inputs=2)
    knots = (np.linspace(0, 0.9, 7), np.sinh(np.linspace(-1, 1.2, 8)) / 1.5)
    outside = ("clamp", "linear")
    bases = tuple(Basis(knots=tuple(k), outside=o) for k, o in zip(knots, outside, strict=True))
    network = Bsnn(
        basis=bases, learning_constant=(0.05, 0.02), two_layers=True, output_learning_constant=0.01
    )
    settings = BsnnArxSettings(
        na=2, nb=4, nk=0, network=network, rls=Rls.adaptive(), opening=3.0, fading=500.0
    )
    model = BsnnArx(settings)
    model.randomise(np.random.default_rng(5))
    start = model.parameters
    reference = oracle.Bsnn(
        [oracle.Splines(k, "full", o) for k, o in zip(knots, outside, strict=True)],
        [0.05, 0.02],
        0.01,
        two_layers=True,
    )
    reference.w1 = [start[6:14].astype(oracle.REAL), start[14:23].astype(oracle.REAL)]
    reference.b, reference.w2 = oracle.REAL(start[23]), start[24:].astype(oracle.REAL)
    rls = oracle.Rls(6, settings.rls)
    rls.theta[:] = start[:6]
    other = oracle.BsnnArx(reference, rls, na=2, nb=4, nk=0, opening=3.0, fading=500.0)
    have = model.run(u, y)
    want = np.array([other.update(*sample) for sample in zip(u, y, strict=True)])
    assert differ(have, want) < TOLERANCE
    assert model.diagnostics()["changes"] == rls.detector.changes >= 2
    weights = np.concatenate([*reference.w1, [reference.b], reference.w2])
    assert differ(model.parameters[6:], weights) < TOLERANCE


# The splines of one lag sum to one and can form any line, so a lag and a constant beside them
# are redundant: "redundant" is what is deployed, the others have unique parameters.
FEATURES = {
    "output splines": (
        Spline(signal="y", lag=1, basis=Basis.uniform(0, 1.5, 5, outside="linear")),
        Lags(signal="y", first=2, count=2), Lags(signal="u", first=0, count=4),
    ),
    "varying gain": (
        Spline(signal="u", lag=1, basis=Basis.asinh(-0.2, 1.1, 7, width=0.2), times=("y", 1)),
        Spline(signal="y", lag=2, basis=Basis.uniform(0, 1.5, 5, outside="quadratic")),
        Lags(signal="y", first=3), Lags(signal="u", first=1, count=2),
    ),
    "hammerstein": (
        Hammerstein(signal="u", basis=Basis.uniform(-0.1, 1.0, 8)),
        Lags(signal="y", count=2), Constant(),
    ),
    "redundant": (
        Spline(signal="y", lag=1, basis=Basis.uniform(0, 1.5, 5)),
        Lags(signal="y", count=3), Lags(signal="u", first=0, count=4), Constant(),
    ),
}  # fmt: skip
SCALES = ((1.0, 2.0), (0.5, 0.5))


def _reference_features(features):
    def scaled(basis, signal):
        centre, half = SCALES[signal]
        return oracle.Splines((np.array(basis.knots) - centre) / half, outside=basis.outside)

    index = {"y": 0, "u": 1}
    for f in features:
        if isinstance(f, Constant):
            yield ("constant",)
        elif isinstance(f, Lags):
            yield ("lags", index[f.signal], f.first, f.count)
        elif isinstance(f, Spline):
            factor = f.times and (index[f.times[0]], f.times[1])
            signal = index[f.signal]
            yield ("spline", signal, f.lag, scaled(f.basis, signal), factor)
        else:
            yield ("hammerstein", 1, f.first, f.count, scaled(f.basis, 1), f.learning_constant)


@pytest.mark.parametrize("after", [0, 2000], ids=["equation error", "output error"])
@pytest.mark.parametrize("kind", FEATURES)
def test_spline_narx_agrees(single, kind, after):
    u, y = single[0][:, 0], single[1]
    # Only F(0) decides along redundant directions: the larger, the worse conditioned.
    gain = 1.0 if kind == "redundant" else 100.0
    settings = SplineNarxSettings(
        output=Signal(name="y", lower=-1, upper=3),
        inputs=(Signal(name="u", lower=0, upper=1),),
        features=FEATURES[kind],
        rls=Rls.adaptive(gain) if after == 0 else Rls(initial_gain=gain),
        output_error_after=after,
        resynchronise_above=0.3,
    )
    model = SplineNarx(settings)
    rls = oracle.Rls(len(model.theta), settings.rls)
    features = list(_reference_features(FEATURES[kind]))
    other = OracleNarx(features, rls, SCALES, after, 0.3 / 2.0)
    have = model.run(u, y)
    want = np.array([other.update(*sample) for sample in zip(u, y, strict=True)])
    assert differ(have, want) < TOLERANCE
    if kind != "redundant":
        assert differ(model.parameters, np.concatenate([rls.theta, *other.w])) < TOLERANCE
    assert model.diagnostics()["changes"] == rls.detector.changes
    assert model.diagnostics()["resynchronised"] == other.resynchronised
