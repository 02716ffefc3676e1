"""The C++ feed-forward against plain NumPy, and the valve table that both stand on."""

import numpy as np
import pytest

from leglab._native.identification import ValveMaps
from leglab.commissioning.setup import controller_setup
from leglab.control import Measurement, ReferencePoint
from leglab.control.backstepping.data import NominalCylinders
from leglab.control.feedforward.adaptive import AdaptiveFeedforward, LearningConfiguration
from leglab.control.feedforward.inverse_map import InverseMap
from leglab.control.feedforward.valve_table import ValveTable
from leglab.controllers.bsnn_arx_pressure import data_sheets
from leglab.identification import ChangeDetection, Rls
from leglab.machine.sensors import SensorConfiguration
from leglab.machine.simulation import Simulation, load_model
from tests.reference import feedforward_oracle as oracle

PERIOD = 0.002
SETTINGS = LearningConfiguration(stop_time=9.0, limit=0.9, rate_limit=40.0)
VALVES = np.array([[0.02, 0.03, 0.04, 0.3, -0.2], [-0.01, -0.02, 0.02, 0.0, 0.1]])
RLS = Rls(
    initial_gain=3.0,
    forgetting="variable",
    forgetting_factor=0.99,
    memory=500.0,
    noise_variance=1e-4,
    restore_interval=1,
    change=ChangeDetection(ratio=4.0, gain=3.0),
)


class CalibratedMap:
    """A valve map with overlap, a spring that shifts it, and a saturated end."""

    def __init__(self, sign):
        self.position = np.linspace(-1.0, 0.8, 7)
        shares = np.array([-1, -0.4, -0.1, -0.01, 0, 0.01, 0.1, 0.4, 1])
        self.velocity = 4.0 * shares
        opening = 0.03 * np.tanh(shares / 0.01) + 0.7 * shares
        load = 0.2 * self.position[:, None] * (1 + np.abs(shares))
        self.command = np.clip(sign * (opening + load), -1, 1)


def parts_of(feedforward, table, inverse_map, settings, position_gain, monkeypatch, **more):
    """The constants that the front-end hands to the core."""
    seen = {}
    real = feedforward.Feedforward
    monkeypatch.setattr(feedforward, "Feedforward", lambda parts: seen.update(parts) or real(parts))
    gains = position_gain, 0.1 * position_gain
    timing = {"control_period": PERIOD, "latency": 0.001, "velocity_delay": 0.004}
    made = AdaptiveFeedforward(inverse_map, table, *gains, settings, **timing, **more)
    monkeypatch.undo()
    return made, seen


@pytest.mark.parametrize(
    ("splines", "supervised", "forward", "worn"),
    [
        ((10, 4), True, False, False),
        ((0, 0), True, False, False),
        ((10, 4), False, False, False),
        ((10, 4), True, True, False),
        ((10, 4), True, False, True),
    ],
)
def test_core_agrees_with_numpy(splines, supervised, forward, worn, monkeypatch):
    import leglab.control.feedforward.adaptive as module

    signs = np.array([1.0, -1.0])
    maps = [CalibratedMap(sign) for sign in signs]
    table = ValveTable.of(maps, signs)
    inverse_map = InverseMap(2, RLS, velocity_splines=splines[0], position_splines=splines[1])
    route = "forward" if forward else "inverse"
    settings = SETTINGS.model_copy(update={"supervised": supervised, "route": route})
    more = {"valve_states": worn}
    made, parts = parts_of(module, table, inverse_map, settings, 2.0 * signs, monkeypatch, **more)
    made.reset()
    made.keep(700)
    learners = inverse_map.learner(), inverse_map.learner()
    other = oracle.Feedforward(parts, table, learners[0])
    if worn:
        made.propose(made.learner.copy(), 9.0, 1.0, VALVES)
        made.settle(1)
        other = oracle.WornFeedforward(parts, table, *learners, VALVES)

    rng = np.random.default_rng(4)
    mine, theirs, fallbacks = [], [], []
    for k in range(5000):
        t = k * PERIOD
        phase = np.array([3.0, 4.1]) * t + np.array([0.0, 1.0])
        reference = ReferencePoint(
            0.6 * np.sin(phase),
            0.6 * np.array([3.0, 4.1]) * np.cos(phase),
            -0.6 * np.array([9.0, 16.81]) * np.sin(phase),
        )
        # The machine lags behind by what nobody told the learner; half way that changes.
        lag = 0.01 if k < 2500 else -0.06
        position = 0.6 * np.sin(phase - lag) + 1e-4 * rng.standard_normal(2)
        if k in (0, 700):
            position[0] += 0.05  # an encoder slips for one reading, and at the start
        if k in (900, 901):
            position[1] = np.nan
        velocity = reference.velocity + 0.1 * rng.standard_normal(2)
        have = made.step(Measurement(t, position, velocity), reference)
        want, seen = other.step(t, position, reference)
        feedback = 2.0 * signs * (seen[0] - position + 0.1 * (seen[1] - velocity))
        # Without a measurement the feed-forward goes alone.
        command = other.command(made.report["feedforward"] + np.nan_to_num(feedback))
        mine.append(np.array([made.report["feedforward"], made.report["feedback"], have]))
        theirs.append(np.array([want, feedback, command]))
        fallbacks.append(np.array([made.report["fallback"], other.fallback]))
        if k % 500 < 480:  # mostly somebody else, more cautious, sends the commands
            command = want + 0.3 * signs * np.nan_to_num(reference.position - position)
            if 1200 < k < 1260:  # saturated, later just so
                command[0] = 1.5 if k < 1220 else settings.limit
            made.sent(command)
        other.sent = np.clip(command, -1, 1)
        if k == 1300:
            kept = made.kept()
            assert 500 < len(kept) == len(other.kept) < 700
    # Samples for whoever looks at them: regressor, output, error and 1; 700 at most after the rest.
    assert made.kept_count() == 700
    kept = np.concatenate([kept, made.kept()])
    output, predicted, usable = np.array(other.kept[: len(kept)]).swapaxes(0, 1)
    np.testing.assert_array_equal(kept[..., -1], usable)
    want = usable * output, usable * (output - predicted)
    np.testing.assert_allclose(np.moveaxis(kept[..., -3:-1], -1, 0), want, rtol=0, atol=2e-9)
    parameters = np.array(other.parameters[: len(kept)])
    told = np.einsum("njp,njp->nj", kept[..., :-3], parameters)
    np.testing.assert_allclose(told, usable * predicted, rtol=0, atol=2e-9)
    # Arrays of (step, joint); a difference names its first index.
    for name, have, want in zip(
        ("feedforward", "feedback", "command"),
        np.array(mine).swapaxes(0, 1),
        np.array(theirs).swapaxes(0, 1),
        strict=True,
    ):
        # The state of a valve, by which commands are sent, is learned.
        atol = 2e-9 if name == "feedforward" or (worn and name == "command") else 1e-12
        np.testing.assert_allclose(have, want, rtol=0, atol=atol, err_msg=name)
    have, want = np.array(fallbacks).swapaxes(0, 1)
    np.testing.assert_array_equal(have, want)
    fell_back = int(want.any(axis=1).sum())
    if worn:
        np.testing.assert_allclose(made.valves, other.shape, rtol=0, atol=2e-9)
        assert (np.abs(made.valves - VALVES) > 1e-3).any()
    assert made.learner.diagnostics(0)["learned"] > 1500
    assert made.learner.diagnostics(0)["dropped"] > 0
    if supervised and splines[0] and not forward:
        assert 0 < fell_back < 4000, "the case does not exercise the supervisor"


def pressure_pair(monkeypatch):
    """Two joints of the leg with pressures: range and signs, the core, a new oracle each call."""
    import leglab.control.feedforward.adaptive as module

    simulation = Simulation(load_model("leg", visual=False))
    machine = controller_setup(simulation, "leg", SensorConfiguration()).machine
    chosen = [1, 3]  # hip roll and knee, which a positive command moves to either side
    signs = np.asarray(machine.direction)[chosen]
    table = ValveTable.of([machine.valve_maps[j] for j in chosen], signs)
    sheets = [machine.cylinders.joints([j]) for j in chosen]
    cylinders = NominalCylinders(
        **{
            name: np.concatenate(
                [getattr(sheet, name) for sheet in sheets],
                axis=0 if name in ("position", "lever", "piston") else -1,
            )
            for name in vars(sheets[0])
        }
        | {"tank_pressure": np.array([3e5, 6e5])}
    )
    structure = {"velocity_splines": 10, "position_splines": 4}
    inverse_map = InverseMap(2, RLS, leaks=4.0, **structure)
    loads = InverseMap(2, RLS, **structure)
    more = {"loads": loads, "sheets": data_sheets(cylinders)}
    gain = 2.0 * signs
    made, parts = parts_of(module, table, inverse_map, SETTINGS, gain, monkeypatch, **more)

    def other():
        made.reset()
        learners = inverse_map.learner(), loads.learner()
        return oracle.PressureFeedforward(parts, table, *learners, cylinders)

    return simulation.joint_range()[chosen].T, signs, made, other


def test_core_with_pressures_agrees_with_numpy(monkeypatch):
    reach, signs, made, new = pressure_pair(monkeypatch)
    other = new()
    learners = other.learner, other.loads
    rng = np.random.default_rng(4)
    middle = reach.mean(axis=0)
    mine, theirs = [], []
    for k in range(600):
        t = k * PERIOD
        phase = np.array([3.0, 4.1]) * t + np.array([0.0, 1.0])
        reference = ReferencePoint(
            middle + 0.2 * np.sin(phase),
            0.2 * np.array([3.0, 4.1]) * np.cos(phase),
            -0.2 * np.array([9.0, 16.81]) * np.sin(phase),
        )
        lag = 0.01 if k < 350 else -0.06
        position = middle + 0.2 * np.sin(phase - lag) + 1e-5 * rng.standard_normal(2)
        pressure_a = 6e6 + 3e6 * np.sin(phase + 0.3) + 1e4 * rng.standard_normal(2)
        pressure_b = 9e6 - 4e6 * np.cos(phase) + 1e4 * rng.standard_normal(2)
        supply = 16e6 if k < 450 else 11e6
        if k in (300, 301):
            pressure_a[0] = supply = np.nan
        velocity = reference.velocity
        measured = Measurement(t, position, velocity, pressure_a, pressure_b, supply)
        made.step(measured, reference)
        other.take(pressure_a, pressure_b, supply)
        want, _ = other.step(t, position, reference)
        mine.append(made.report["feedforward"].copy())
        theirs.append(want)
        command = want + 0.3 * signs * (reference.position - position)
        made.sent(command)
        other.sent = np.clip(command, -1, 1)
    np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-8)
    for have, expected in zip((made.learner, made.loads), learners, strict=True):
        np.testing.assert_allclose(have.parameters, expected.parameters, rtol=0, atol=1e-6)
    assert np.abs(np.diff(theirs, axis=0)).max() > 1e-3
    for learner in (made.learner, made.loads):
        assert learner.diagnostics(0)["learned"] > 200
        assert np.abs(learner.parameters).max() > 1e-2


def test_valve_is_solved_for_any_speed_and_pressures(monkeypatch):
    reach, _, made, new = pressure_pair(monkeypatch)
    rng = np.random.default_rng(5)
    for _ in range(100):
        other = new()
        velocity = rng.choice([-1, 1], 2) * other.p["full_speed"] * 10 ** rng.uniform(-4, 0, 2)
        position, pressures = rng.uniform(*reach), rng.uniform(0.0, 15e6, (2, 2))
        supply, reference = rng.uniform(8e6, 20e6), (position, velocity, np.zeros(2))
        made.step(
            Measurement(0.0, position, velocity, *pressures, supply), ReferencePoint(*reference)
        )
        other.take(*pressures, supply)
        want, _ = other.step(0.0, position, reference)
        np.testing.assert_allclose(made.report["feedforward"], want, rtol=0, atol=1e-12)


def test_table_directions_are_inverse_to_each_other():
    table = ValveTable.of([CalibratedMap(-1.0)], np.array([-1.0]))
    core, out = ValveMaps(vars(table)), np.empty(1)
    for position in (-2.0, -0.93, 0.1, 0.79, 3.0):
        for share in (-1.7, -0.6, -0.004, 0.0, 0.02, 0.9, 1.4):
            command = oracle.table_command(table, 0, position, share)
            assert oracle.table_share(table, 0, position, command) == pytest.approx(share, abs=1e-9)
            core.command(np.array([position]), share * table.full_speed, out)
            told = oracle.table_command(table, 0, position, np.clip(share, -1, 1))
            assert out[0] == pytest.approx(told, abs=1e-12)


def test_table_is_monotone_without_its_saturated_ends():
    calibrated = CalibratedMap(1.0)
    assert (np.abs(calibrated.command) == 1.0).any()
    table = ValveTable.of([calibrated], np.array([1.0]))
    assert (np.diff(table.command, axis=2) > 0).all()
    measured = np.abs(calibrated.command) < 0.999
    np.testing.assert_allclose(table.command[0][measured], calibrated.command[measured], atol=1e-12)
    # Where the valve was at its limit, the map goes on as steeply as it came.
    row = table.command[0, -1]
    slopes = np.diff(row) / np.diff(table.share)
    assert row[-1] > 1.0
    assert slopes[-1] == pytest.approx(slopes[-2], rel=0.2)


def test_a_row_that_is_all_saturated_takes_its_neighbours():
    calibrated = CalibratedMap(1.0)
    calibrated.command[0] = 1.0
    table = ValveTable.of([calibrated], np.array([1.0]))
    np.testing.assert_array_equal(table.command[0, 0], table.command[0, 1])
