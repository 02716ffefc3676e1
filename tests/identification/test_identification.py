"""The identifiers' front-end: shapes, modes of use, files, conversions and bad input."""

from dataclasses import replace

import control
import numpy as np
import pytest

from leglab.base.errors import LeglabError
from leglab.identification import (
    Basis,
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
    load,
    restore,
    save,
)

PAPER = BsnnArxSettings.paper_mode()
NARX = SplineNarxSettings(
    output=Signal(name="angle", lower=-1, upper=3),
    inputs=(Signal(name="valve"), Signal(name="pressure", lower=0, upper=2)),
    features=(
        Spline(signal="angle", basis=Basis.uniform(-1, 3, 6, outside="linear")),
        Hammerstein(signal="valve", basis=Basis.uniform(-1, 1, 7)),
        Lags(signal="angle", count=2),
        Lags(signal="pressure", first=0, count=2),
        Constant(),
    ),
    output_error_after=300,
)
MODELS = {"BsnnArx": (BsnnArx, PAPER), "SplineNarx": (SplineNarx, NARX)}


def record(settings, joints=1, samples=600, seed=0):
    """Random inputs and a smooth response for each joint, with the axes of the front-end."""
    rng = np.random.default_rng(seed)
    inputs = 1 if settings is PAPER else 2
    u = rng.uniform(0, 0.8, (samples, joints, inputs))
    y = np.zeros((samples, joints))
    for t in range(2, samples):
        y[t] = (
            1.1 * y[t - 1]
            - 0.4 * y[t - 2]
            + np.tanh(u[t - 1, :, 0]) * np.linspace(0.2, 0.5, joints)
        )
    u = u[:, :, 0] if inputs == 1 else u
    return (u, y) if joints > 1 else (u[:, 0], y[:, 0])


@pytest.fixture(params=MODELS)
def kind(request):
    return MODELS[request.param]


def test_run_is_update_in_a_loop(kind):
    model, settings = kind
    u, y = record(settings)
    together, single = model(settings), model(settings)
    have = together.run(u, y)
    want = [single.update(*sample) for sample in zip(u, y, strict=True)]
    np.testing.assert_array_equal(have, want)
    assert together._bank.state() == single._bank.state()


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_joints_are_independent_identifiers(kind, scalar):
    model, settings = kind
    settings_here = replace(settings, scalar=scalar)
    u, y = record(settings, joints=6)
    bank = model(settings_here, joints=6)
    first = np.array([bank.update(*sample) for sample in zip(u[:50], y[:50], strict=True)])
    rest, trajectory = bank.run_recorded(u[50:], y[50:])
    assert trajectory.shape == (550, 6, bank.parameters.shape[1])
    np.testing.assert_array_equal(trajectory[-1], bank.parameters)
    for j in range(6):
        alone = model(settings_here)
        want = alone.run(u[:, j], y[:, j])
        np.testing.assert_array_equal(np.concatenate([first, rest])[:, j], want)
        np.testing.assert_array_equal(bank.parameters[j], alone.parameters)


def test_freeze_stops_learning_and_one_step_agrees(kind):
    model, settings = kind
    u, y = record(settings)
    m = model(settings)
    m.run(u[:400], y[:400])
    m.freeze()
    before = m.parameters
    ahead = m.one_step(u[400:], y[400:], resume=True)
    np.testing.assert_array_equal(m.run(u[400:], y[400:]), ahead)
    np.testing.assert_array_equal(m.parameters, before)
    m.freeze(False)
    m.run(u, y)
    assert np.any(m.parameters != before)


def test_free_run_feeds_back_its_own_output(kind):
    model, settings = kind
    u, y = record(settings)
    m = model(settings)
    m.run(u, y)
    state = m._bank.state()
    have = m.free_run(u, y[: m.lags])
    assert m._bank.state() == state
    np.testing.assert_array_equal(have[: m.lags], y[: m.lags])
    # One step ahead on its own output is the free run.
    np.testing.assert_array_equal(m.one_step(u, have), have)
    resumed = m.free_run(u[:5])
    m.freeze()
    want = [m.update(x, np.nan) for x in u[:1]]
    np.testing.assert_array_equal(resumed[:1], want)


def test_predict_takes_nothing(kind):
    model, settings = kind
    u, y = record(settings, joints=3)
    m = model(settings, joints=3)
    m.run(u[:500], y[:500])
    other = m.copy()
    have = other.predict(u[500])
    np.testing.assert_array_equal(have, m.update(u[500], y[500]))
    np.testing.assert_array_equal(other.update(u[500], y[500]), have)
    np.testing.assert_array_equal(other.run(u[501:], y[501:]), m.run(u[501:], y[501:]))


def test_save_and_load_resume_bit_exactly(kind, tmp_path):
    model, settings = kind
    u, y = record(settings, joints=2)
    m = model(settings, joints=2)
    m.run(u[:350], y[:350])
    save(m, tmp_path / "joint.id")
    want = m.run(u[350:], y[350:])
    other = load(tmp_path / "joint.id")
    assert type(other) is model
    assert other.settings == settings
    np.testing.assert_array_equal(other.run(u[350:], y[350:]), want)
    np.testing.assert_array_equal(other.parameters, m.parameters)
    restore(other, tmp_path / "joint.id")
    np.testing.assert_array_equal(other.run(u[350:], y[350:]), want)
    assert [path.name for path in tmp_path.iterdir()] == ["joint.id"]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: data[:-1], "truncated"),
        (lambda data: data[: data.index(b"\n") + 40], "truncated or damaged in its header"),
        (lambda data: b"", "no saved identifier"),
        (lambda data: b"\x80pickle" + data, "no saved identifier"),
        (lambda data: data.replace(b"identifier 1\n", b"identifier 99\n", 1), "version '99'"),
        (lambda data: data[:-9] + bytes([data[-9] ^ 1]) + data[-8:], "checksum"),
        (lambda data: data.replace(b'"state_version": 3', b'"state_version": 7'), "version 7"),
        (lambda data: data.replace(b'"BsnnArx"', b'"BsnnArk"', 1), "unknown model"),
    ],
)
def test_damaged_file_leaves_identifier_untouched(tmp_path, damage, message):
    path = tmp_path / "joint.id"
    m = BsnnArx(PAPER)
    m.run(*record(PAPER))
    save(m, path)
    path.write_bytes(damage(path.read_bytes()))
    other = BsnnArx(PAPER)
    state = other._bank.state()
    with pytest.raises(LeglabError, match=message):
        restore(other, path)
    assert other._bank.state() == state
    with pytest.raises(LeglabError, match=message):
        load(path)


def test_restore_refuses_other_settings_and_missing_files(tmp_path):
    path = tmp_path / "joint.id"
    save(BsnnArx(PAPER), path)
    with pytest.raises(LeglabError, match="settings"):
        restore(BsnnArx(replace(PAPER, na=2)), path)
    with pytest.raises(LeglabError, match="joints 1"):
        restore(BsnnArx(PAPER, joints=2), path)
    with pytest.raises(LeglabError, match="model 'BsnnArx'"):
        restore(SplineNarx(NARX), path)
    with pytest.raises(LeglabError, match="cannot be read"):
        load(tmp_path / "none.id")
    with pytest.raises(LeglabError, match="cannot be written"):
        save(BsnnArx(PAPER), tmp_path / "none" / "joint.id")


def test_transfer_function_of_the_arx_part():
    m = BsnnArx(PAPER)
    m.randomise(np.random.default_rng(1))
    g = m.transfer_function(timestep=0.005)
    assert g.dt == 0.005
    np.testing.assert_allclose(np.sort(m.poles()), np.sort(g.poles()))
    # The linear part alone, simulated: y from n.
    n = np.random.default_rng(2).standard_normal(100)
    want = np.zeros(100)
    a, b = m.theta[:3], m.theta[3:]
    for t in range(100):
        past = [n[t - k] if t >= k else 0.0 for k in (1, 2, 3)]
        want[t] = -sum(a[k] * want[t - 1 - k] for k in range(3) if t > k) + b @ past
    have = control.forced_response(g, U=n).outputs
    np.testing.assert_allclose(have, want, atol=1e-12)


def test_static_spline_is_the_network():
    m = BsnnArx(replace(PAPER, na=0, nb=1, nk=0))  # y = theta n(u), theta = 1
    rng = np.random.default_rng(3)
    m.randomise(rng)
    m.parameters = np.concatenate([[1.0], m.parameters[1:]])
    u = np.linspace(0, 0.8, 97)
    np.testing.assert_allclose(m.one_step(u, u, resume=True), m.static_spline()(u), atol=1e-14)


@pytest.mark.parametrize("signal", ["angle", "valve", "pressure"])
def test_linearise_is_the_derivative_of_the_prediction(signal):
    features = (
        *NARX.features,
        Spline(signal="valve", lag=1, times=("angle", 2), basis=Basis.asinh(-1, 1, 7, width=0.1)),
    )
    m = SplineNarx(replace(NARX, features=features))
    rng = np.random.default_rng(4)
    m.parameters = rng.standard_normal(m.parameters.shape)
    point = {"angle": 0.7, "valve": -0.25, "pressure": 0.9}
    gains = m.linearise(at=point)[["angle", "valve", "pressure"].index(signal)]
    assert np.count_nonzero(gains) >= 2
    order = list(point)

    def predict(lag, step):
        history = np.tile(list(point.values()), (m.lags + 1, 1))
        history[-1 - lag, order.index(signal)] += step
        return m.one_step(history[:, 1:], history[:, 0])[-1]

    for lag in range(1 if signal == "angle" else 0, m.lags + 1):
        slope = (predict(lag, 1e-6) - predict(lag, -1e-6)) / 2e-6
        assert gains[lag] == pytest.approx(slope, abs=1e-7)


def test_hammerstein_input_is_learned():
    """A dead zone before a linear system: the sensitivity form finds it, lags alone cannot."""
    u = np.random.default_rng(1).uniform(-1, 1, 6000)
    n, y = np.sign(u) * np.maximum(np.abs(u) - 0.2, 0), np.zeros(6000)
    for t in range(2, 6000):
        y[t] = 1.5 * y[t - 1] - 0.7 * y[t - 2] + 0.1 * n[t - 1] + 0.05 * n[t - 2]
    error = {}
    for name, drive in {
        "lags": Lags(signal="u", count=3),
        "hammerstein": Hammerstein(signal="u", basis=Basis.uniform(-1, 1, 8)),
    }.items():
        m = SplineNarx(SplineNarxSettings(features=(drive, Lags(signal="y", count=3), Constant())))
        m.run(u[:4500], y[:4500])
        error[name] = np.std(m.free_run(u[4500:], y[4500:4503]) - y[4500:])
    assert error["hammerstein"] < 0.2 * error["lags"]


def test_gain_that_is_set_is_that_of_bayesian_regression():
    rng = np.random.default_rng(3)
    n = 4
    basis = tuple(Signal(name=f"u{i}") for i in range(n))
    settings = SplineNarxSettings(
        inputs=basis, features=tuple(Lags(signal=s.name, first=0) for s in basis), rls=Rls()
    )
    model = SplineNarx(settings)
    root = rng.standard_normal((n, n))
    prior, mean = root @ root.T + 0.1 * np.eye(n), rng.standard_normal(n)
    model.parameters = mean
    model.set_gain(prior)
    np.testing.assert_allclose(model.gain(), prior, rtol=1e-12)
    phi, y = rng.standard_normal((30, n)), rng.standard_normal(30)
    skipped = 1  # the first sample fills the history
    for u, out in zip(phi, y, strict=True):
        model.update(u, float(out))
    information = phi[skipped:].T @ phi[skipped:] + np.linalg.inv(prior)
    wanted = np.linalg.solve(
        information, phi[skipped:].T @ y[skipped:] + np.linalg.solve(prior, mean)
    )
    np.testing.assert_allclose(model.parameters, wanted, rtol=1e-8)
    np.testing.assert_allclose(model.gain(), np.linalg.inv(information), rtol=1e-8, atol=1e-12)
    with pytest.raises(LeglabError, match="gain has shape"):
        model.set_gain(np.eye(n + 1))
    with pytest.raises(LeglabError, match="gain is nan"):
        model.set_gain(np.full((n, n), np.nan))


@pytest.mark.parametrize("held", [False, True])
def test_an_alarm_that_is_held_does_not_come(held):
    change = ChangeDetection(ratio=4.0, gain=1.0, fast_window=5, slow_window=50, hold_off=40)
    settings = SplineNarxSettings(
        inputs=(Signal(name="u"),),
        features=(Lags(signal="u", first=0),),
        rls=Rls(change=change),
    )
    model, rng = SplineNarx(settings), np.random.default_rng(4)
    for k in range(140):
        if k == 119 and held:
            model.hold_alarm()
        u = rng.standard_normal()
        model.update(u, (0.5 if k < 120 else -0.5) * u + 0.01 * rng.standard_normal())
    assert model.diagnostics()["changes"] == (0 if held else 1)
