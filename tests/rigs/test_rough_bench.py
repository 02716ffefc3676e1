"""The rough bench: its equations against leglab's own bench and scipy, its specimens and faults."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from leglab.base.errors import LeglabError
from rigs import bench as faulty_bench
from rigs._native import rough_bench as native
from rigs.bench import FaultyBench, references
from rigs.rough_bench import (
    FAULTS,
    NOMINAL,
    RoughBench,
    effect_of,
    exact_specimen,
    record,
    rough_case,
    specimen,
    with_fault,
)


@pytest.fixture
def _bare_sensors(monkeypatch):
    for name in ("POSITION_NOISE", "PRESSURE_NOISE"):
        monkeypatch.setattr(faulty_bench, name, 0.0)
    monkeypatch.setattr(faulty_bench, "ENCODER_STEP", 1e-12)


@pytest.mark.parametrize(
    ("motion", "asymmetry"), [("multisine", 0.0), ("steps", 0.0), ("walk", 0.0), ("steps", 0.2)]
)
@pytest.mark.usefixtures("_bare_sensors")
def test_the_bench_moves_as_leglab_s_own(motion, asymmetry):
    """Same commands, open loop, over 6 s. Measured: 0.06 mrad, 0.02 bar rms, steps being worst."""
    reference = references(np.random.default_rng(3), duration=6.0)[motion]
    faults = {("knee_valve", "flow_asymmetry"): asymmetry}
    own = FaultyBench(parameters=faults).record(reference, np.random.default_rng(0))
    command = np.ascontiguousarray(own["knee_valve_command"])
    values = {"gain_positive": 1.0 + asymmetry, "gain_negative": 1.0 - asymmetry}
    values["encoder_counts"] = 0.0
    q, _, a, b = native.play(values, float(reference[0]), command, 1e-3, 40)
    assert np.ptp(own["knee_position"]) > 0.4
    np.testing.assert_allclose(q, own["knee_position"], atol=1.5e-4)
    for found, chamber in ((a, "knee_pressure_a"), (b, "knee_pressure_b")):
        assert np.sqrt(np.mean((found - own[chamber]) ** 2)) < 0.05e5


def stretch(values, command):
    """States over 30 ms from a drop at rest: RK4 of the bench, and Radau on its derivative."""
    start = native.rest(values, 0.7)
    count, step = 600, 5e-5
    ours = native.integrate(values, start, command, step / 2, 2 * count)
    ours = ours.reshape(2 * count, -1)[1::2]
    theirs = solve_ivp(
        lambda t, y: native.derivative(values, t, np.ascontiguousarray(y), command),
        (0.0, count * step),
        start,
        method="Radau",
        t_eval=step * np.arange(1, count + 1),
        rtol=1e-9,
        atol=1e-12,
        max_step=2e-4,
    ).y.T
    return ours, theirs


@pytest.mark.parametrize("seed", range(6))
def test_the_integrator_agrees_with_radau(seed):
    values = dict(specimen(seed).values)
    ours, theirs = stretch(values, 0.06)
    assert np.ptp(theirs[:, 0]) > 0.005
    np.testing.assert_allclose(ours[:, 0], theirs[:, 0], atol=2e-6)
    np.testing.assert_allclose(ours[:, 4:6], theirs[:, 4:6], atol=3e3)


def test_the_derivative_holds_the_energy_of_the_falling_shank():
    """Without cylinder and springs the pendulum m g c, J: q'' = -m g c/J sin q."""
    none = dict.fromkeys(("area_a", "area_b", "k1", "k2", "d1", "viscous", "sigma_1"), 0.0)
    none |= {"sigma_0": 1e-9, "mass": 3.0}
    state = np.zeros(10)
    state[0] = 0.6
    slope = native.derivative(none, 0.0, state, 0.0)
    assert slope[1] == pytest.approx(-9.81 * 3.0 * 0.22 / 0.40 * np.sin(0.6), rel=1e-9)


def test_every_law_is_drawn_and_specimens_differ():
    drawn = [specimen(seed) for seed in range(60)]
    for name, count in {
        "friction_law": 4,
        "edge_law": 3,
        "orifice_law": 3,
        "oil_law": 4,
        "valve_law": 2,
        "spring_law": 2,
    }.items():
        assert {bench[name] for bench in drawn} == set(range(count))
    assert all(0.3e-3 <= bench["command_delay"] <= 1.5e-3 for bench in drawn)
    leakage = np.array([bench["internal_leakage"] for bench in drawn]) / NOMINAL["internal_leakage"]
    assert leakage.min() < 0.8
    assert leakage.max() > 1.25
    assert specimen(4) == specimen(4)
    assert specimen(4) != specimen(5)


def test_an_exact_specimen_keeps_the_laws_of_the_model():
    bench = exact_specimen(3)
    assert all(bench[name] == NOMINAL[name] for name in NOMINAL if name.endswith("_law"))
    assert bench["command_delay"] == bench["cogging"] == bench["hysteresis"] == 0.0
    assert 0.0 < abs(bench["k1"] / NOMINAL["k1"] - 1.0) < 0.06


@pytest.mark.slow("thirty faults of a rig")
@pytest.mark.parametrize("name", sorted(FAULTS))
def test_every_fault_shows_and_keeps_the_knee_in_range(name):
    motions = references(np.random.default_rng(6), duration=1.0)
    motions = {name: motions[name] for name in ("walk", "steps")}
    bench = specimen(11)
    healthy = record(bench, None, motions, np.random.default_rng(7))
    faulty, hidden = with_fault(bench, name, np.random.default_rng(8))
    ill = record(faulty, None, motions, np.random.default_rng(7))
    assert np.isfinite(hidden.value)
    worst = 0.0
    for motion, recording in ill.items():
        q = recording["knee_position"]
        assert q.min() > 0.0
        assert q.max() < 1.8
        scale = {"knee_position": 1e-3, "knee_pressure_a": 1e5, "knee_pressure_b": 1e5}
        for column, unit in scale.items():
            values = recording[column]
            assert np.isfinite(values).all()
            change = np.sqrt(np.mean((values - healthy[motion][column]) ** 2)) / unit
            worst = max(worst, change)
    assert worst > 0.3  # mrad or bar


def test_a_fault_leaves_the_specimen_alone():
    bench = specimen(2)
    before = dict(bench.values)
    with_fault(bench, "payload", np.random.default_rng(0))
    assert bench.values == before


def test_gross_sizes_lie_above_just_visible_ones():
    for name, fault in FAULTS.items():
        draws = {
            sizes: [abs(fault.draw(np.random.default_rng(i), sizes)) for i in range(40)]
            for sizes in ("gross", "visible")
        }
        ends = sorted((fault.low, fault.high))
        assert ends[0] <= min(draws["gross"]) <= max(draws["gross"]) <= ends[1], name
        outside = [x for x in draws["visible"] if not ends[0] <= x <= ends[1]]
        assert outside, name


def test_a_case_follows_from_its_seed():
    case = rough_case(5, ("internal_leakage",), duration=0.3)
    again = rough_case(5, ("internal_leakage",), duration=0.3, healthy=False)
    assert set(case.recordings) == set(case.healthy) == {"multisine", "slow", "steps", "walk"}
    assert not again.healthy
    for name, recording in case.recordings.items():
        np.testing.assert_array_equal(
            recording["knee_pressure_a"], again.recordings[name]["knee_pressure_a"]
        )
    (hidden,) = case.severities
    assert hidden.parameter == "internal_leakage"
    assert hidden.value > 2.9 * specimen(5)["internal_leakage"]


def test_a_recording_is_measured_by_its_sensors():
    bench = specimen(1)
    reference = references(np.random.default_rng(1), duration=0.5)["walk"]
    recording = bench.follow(reference, np.random.default_rng(2))
    count = 2.0 * np.pi / bench["encoder_counts"]
    counts = recording["knee_position"] / count
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    shifted = bench.changed(pressure_offset_a=bench["pressure_offset_a"] + 4e5)
    shown = shifted.follow(reference, np.random.default_rng(2))
    difference = shown["knee_pressure_a"] - recording["knee_pressure_a"]
    np.testing.assert_allclose(difference, 4e5, rtol=1e-9)
    late = bench.changed(command_delay=bench["command_delay"] + 0.005)
    moved = late.follow(reference, np.random.default_rng(2))
    assert not np.array_equal(moved["knee_position"], recording["knee_position"])


def test_play_lets_the_piston_move_before_the_joint():
    # The piston pushes against 0.4 mm of play, the joint is still at rest.
    loose = RoughBench().changed(play=4e-4)
    state = native.rest(dict(loose.values), 0.9)
    state[9] = 0.1
    slope = native.derivative(dict(loose.values), 0.0, state, 0.0)
    free = native.derivative(dict(loose.values), 0.0, native.rest(dict(loose.values), 0.9), 0.0)
    assert slope[8] == pytest.approx(0.1)
    assert slope[1] == pytest.approx(free[1])


def test_unknown_names_are_refused():
    with pytest.raises(LeglabError, match="'rust'"):
        with_fault(RoughBench(), "rust", np.random.default_rng(0))
    with pytest.raises(LeglabError, match="'tiny'"):
        with_fault(RoughBench(), "payload", np.random.default_rng(0), sizes="tiny")
    with pytest.raises(KeyError, match="viscosity"):
        native.rest({"viscosity": 1.0}, 0.9)


def test_faults_go_by_the_names_of_the_diagnosis():
    assert effect_of("asymmetric_seal_friction") == "asymmetric_friction"
    assert effect_of("payload") == "payload"
