"""Effects on cylinders, valves and pressure sensors: against closed forms, and replayed."""

import mujoco
import numpy as np
import pytest

from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.likelihood.sizes import Motion, Shown, sized
from leglab.diagnosis.plant.model import Machine, Measured
from leglab.diagnosis.replay import starts
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.machine.cylinder import Cylinder
from leglab.machine.parameters import State
from leglab.machine.simulation import actuator_moments
from rigs.bench import NOMINAL, FaultyBench, references

VALVE = "knee_valve"


@pytest.fixture(scope="module")
def machine():
    return Machine("knee_bench", timestep=1e-3)


def changed(library, machine, key, values):
    """The cylinder under an effect, as the core computes it."""
    change = library.change({key: np.array(values)}, machine)
    table = machine.base.elements[VALVE][1].parameters
    names = [name for name, entry in table.items() if not isinstance(entry, State)]
    return Cylinder({name: change.parameter(VALVE, name) for name in names})


@pytest.fixture(scope="module")
def healthy():
    """Recordings of a machine that is exactly the model, and what a fault makes of the same."""

    def record(faults):
        motions = references(np.random.default_rng(3), duration=3.0)
        plant = FaultyBench()
        faults(plant)
        rng = np.random.default_rng(4)
        return {name: plant.record(motions[name], rng) for name in ("multisine", "steps")}

    return record


def problem_of(recordings, *effects):
    settings = DiagnosisSettings(effects=effects or None, threads=1)
    return set_up("knee_bench", recordings, (), settings)


def replayed(recordings, key, values):
    """Mean square of the whitened errors without and with an effect at its true values."""
    truth = Hypothesis({key: np.array(values)})
    problem = problem_of(recordings, key[0]).about(truth)
    return (float(problem.window_cost(h).mean()) for h in (Hypothesis(), truth))


def test_friction_of_the_seals_differs_by_direction(machine):
    library = Library(machine)
    # 1200 and 500 N s/m, 180 and 90 N: extending and retracting.
    cylinder = changed(
        library, machine, ("asymmetric_friction", VALVE), [1200.0, 500.0, 180.0, 90.0]
    )
    stiction = 50.0 * np.exp(-((0.02 / 0.014) ** 2))  # breakaway stays 50 N above
    assert cylinder.native.steady_friction(0.02, 0.0, 0.0) == pytest.approx(24 + 180 + stiction)
    assert cylinder.native.steady_friction(-0.02, 0.0, 0.0) == pytest.approx(-10 - 90 - stiction)


@pytest.mark.parametrize("gains", [(1.3, 1.0), (1.0, 0.7), (1.2, 0.8)])
def test_each_direction_of_the_valve_has_its_gain(machine, gains):
    library = Library(machine)
    plain = changed(library, machine, ("valve_gain_asymmetry", VALVE), [1.0, 1.0])
    other = changed(library, machine, ("valve_gain_asymmetry", VALVE), gains)
    for spool, gain in ((0.6, gains[0]), (-0.6, gains[1])):
        # Far from the lap the edges of the other direction leak a thousandth.
        before, after = (c.native.flows(spool, 16e6, 7e6, 7e6)[0] for c in (plain, other))
        assert after == pytest.approx(gain * before, rel=2e-3)


def test_one_gain_of_a_valve_is_a_special_case_of_two_on_the_same_valve(machine):
    contains = Library(machine).contains
    assert contains(("valve_gain_asymmetry", VALVE), ("valve_gain", VALVE))
    assert not contains(("valve_gain", VALVE), ("valve_gain_asymmetry", VALVE))
    # What all like parts share has no element.
    assert not contains(("valve_gain_asymmetry", "every"), ("valve_gain", VALVE))


@pytest.mark.parametrize(("simple", "first"), [("viscous_friction", 0), ("coulomb_friction", 2)])
def test_friction_alike_in_both_directions_of_a_joint_is_that_of_its_cylinder(
    healthy, simple, first
):
    recordings = healthy(lambda plant: None)
    joint, seal = ("asymmetric_friction", "knee"), (simple, VALVE)
    problem = problem_of(recordings, joint[0], "viscous_friction", "coulomb_friction")
    library = problem.library
    factor = library.as_simpler((joint, first), (seal, 0))
    both = np.zeros(4)
    both[first : first + 2] = 2.0
    nominal = library.sites[seal].nominal
    models = Hypothesis(), Hypothesis({joint: both}), Hypothesis({seal: nominal + 2.0 * factor})
    without, *moved = (problem.raw_errors(h)[:, 0] for h in models)
    joints, seals = (errors - without for errors in moved)
    # The lever changes over the stroke.
    assert float((seals * joints).sum() / (joints**2).sum()) == pytest.approx(1.0, abs=0.25)
    other = "coulomb_friction" if first == 0 else "viscous_friction"
    assert library.as_simpler((joint, first), ((other, VALVE), 0)) == 0.0


@pytest.mark.parametrize("damping", [0.7, 2.0, 5.0])
def test_a_slow_valve_is_told_by_its_lag(machine, damping):
    """On a slow ramp the spool is 2 zeta / w late, whatever the damping."""
    change = Library(machine).change(
        {("valve_bandwidth", VALVE): np.array([40.0, damping])}, machine
    )
    frequency, zeta = (change.parameter(VALVE, name) for name in ("bandwidth_hz", "damping_ratio"))
    time = 1e-3 * np.arange(400)
    moved = starts.spool(time, 2.0 * np.pi * frequency, zeta, 1e-3)
    assert zeta == pytest.approx(damping)
    # Held commands are half a sample late on the mean.
    late = 2.0 * 0.7 / (2.0 * np.pi * 40.0)
    assert time[-1] - moved[-1, 0] == pytest.approx(late, abs=6e-4)


def test_a_worn_edge_is_open_by_half_its_rounding_at_the_lap(machine):
    cylinder = changed(Library(machine), machine, ("valve_null_leakage", VALVE), [0.08])
    # Chambers at the tank's pressure: the edges to it pass nothing.
    at_lap, wide = (cylinder.native.flows(spool, 16e6, 0.0, 0.0)[0] for spool in (0.02, 1.0))
    assert at_lap / wide == pytest.approx(0.04 / (0.5 * (0.98 + np.hypot(0.98, 0.08))))


def test_stiction_has_the_shape_of_its_curve(machine):
    library = Library(machine)
    cylinder = changed(library, machine, ("stiction", VALVE), [400.0, 0.02, 0.7])
    level = 100.0 + 300.0 * np.exp(-((0.05 / 0.02) ** 0.7))
    assert cylinder.native.steady_friction(0.05, 0.0, 0.0) == pytest.approx(level + 35.0)


@pytest.mark.parametrize("speed", [0.01, -0.01])
def test_bristles_of_sliding_seals_carry_their_curve(machine, speed):
    """At a steady speed the bristle carries F_c + (F_s - F_c) exp(-|v/v_s|^n) of its direction."""
    shape = {"stribeck_exponent": 0.6, "coulomb_difference": 60.0, "static": 400.0}
    state = np.tile(machine.base.plugin_state, (2, 1))
    for name, value in shape.items():
        state[:, machine.base.slot(VALVE, name)] = value
    still = np.zeros(2000)
    measured = Measured(
        period=1e-3,
        position={"knee": still},
        velocity={"knee": still},
        piston_velocity={VALVE: still + speed},
        lever={VALVE: still + 0.04},
        command={VALVE: still},
        pressure={},
        samples=np.array([1500, 1900]),
    )
    one = starts.Instances(machine=machine, measured=measured, variant=machine.base, state=state)
    one.reconstruct()
    side = np.sign(speed)
    wanted = 100.0 + side * 30.0 + 300.0 * np.exp(-((0.01 / 0.014) ** 0.6))
    np.testing.assert_allclose(one.get(VALVE, "bristle") * 2e6, side * wanted, rtol=1e-9)


def seal(plant):
    plant.parameters.update(
        {
            (VALVE, "coulomb"): NOMINAL["coulomb"] + 75.0,
            (VALVE, "static"): NOMINAL["static"] + 75.0,
            (VALVE, "coulomb_difference"): 150.0,
            (VALVE, "viscous"): NOMINAL["viscous"] + 300.0,
            (VALVE, "viscous_difference"): 600.0,
        }
    )


def sensors(plant):
    plant.pressure_offset = (3e5, 0.0)


def gains(plant):
    plant.pressure_scale = (1.0, 0.93)


def curve(plant):
    plant.parameters[VALVE, "static"] = 300.0
    plant.parameters[VALVE, "stribeck_velocity"] = 0.02
    plant.parameters[VALVE, "stribeck_exponent"] = 1.0


def worn(plant):
    plant.parameters[VALVE, "edge_rounding"] = 4.0 * NOMINAL["edge_rounding"]


@pytest.mark.parametrize(
    ("name", "fault", "values"),
    [
        ("asymmetric_friction", seal, [1300.0, 700.0, 250.0, 100.0]),
        ("pressure_sensor_offset", sensors, [3e5, 0.0]),
        ("pressure_sensor_scale", gains, [1.0, 0.93]),
        ("stiction", curve, [300.0, 0.02, 1.0]),
        ("valve_null_leakage", worn, [4.0 * NOMINAL["edge_rounding"]]),
    ],
)
def test_a_replay_with_the_true_values_leaves_noise(healthy, name, fault, values):
    """Start states included: bristles and pressures are reconstructed under the effect."""
    without, true = replayed(healthy(fault), (name, VALVE), values)
    assert without > 5.0
    assert true < 1.3


def test_a_piston_is_found_on_the_flank_that_it_presses(healthy):
    """Windows of a slow motion under gravity: the replay with the true play leaves noise."""

    def worn(plant):
        plant.tuning[VALVE, "play"] = 5e-4

    recordings = {"multisine": healthy(worn)["multisine"]}
    problem = problem_of(recordings, "backlash")
    key = "backlash", VALVE
    change = problem.library.change({key: np.array([5e-4])}, problem.replay.machine)
    moments = [at for _, at, _ in problem.replay.along(change, problem.fitted)]
    state = np.tile(change.variant.plugin_state, (moments[0].samples.size, 1))
    state[:, change.variant.slot(VALVE, "play")] = 5e-4
    for chamber in ("pressure_a", "pressure_b"):
        column = moments[0].pressure[f"knee_{chamber}"]
        state[:, change.variant.slot(VALVE, chamber)] = column[moments[0].samples]
    one = starts.Instances(
        machine=problem.machine, measured=moments[0], variant=change.variant, state=state
    )
    one.reconstruct()
    assert (np.abs(one.get(VALVE, "play_offset")) > 2.5e-4).all()
    truth = Hypothesis({key: np.array([5e-4])})
    wrong = Hypothesis({key: np.array([2e-3])})
    costs = [problem.about(h).window_cost(h) for h in (truth, wrong)]
    assert np.median(costs[0]) < 1.3
    assert costs[0].mean() <= costs[1].mean()


def test_a_play_passes_the_forces_of_its_piston_on(healthy):
    """Along the measured motion, and where dry friction rests: a flank's first step is none."""
    recordings = {"steps": healthy(lambda plant: None)["steps"]}
    problem = problem_of(recordings)
    key = "backlash", VALVE
    tight, loose = (
        problem.replay.lacking(problem.library.change(h, problem.replay.machine), None)
        for h in (Hypothesis(), Hypothesis({key: np.array([3e-4])}))
    )
    assert np.median(np.abs(tight)) < 0.5  # N m, of some 30
    np.testing.assert_allclose(loose, tight, atol=1e-9)


def test_anchors_give_length_and_lever_by_the_law_of_cosines(machine):
    """No other test moves them: a turn of the wrong sign would be calibrated away."""
    fixed, moving, turn = 1.01, 0.98, 0.03
    change = Library(machine).change({("anchors", VALVE): np.array([fixed, moving, turn])}, machine)
    model = change.variant.model
    data = mujoco.MjData(model)
    base, rod = np.array([-0.045, 0.3]), np.array([-0.045, -0.02])  # x, z about the knee
    a, b = fixed * np.hypot(*base), moving * np.hypot(*rod)
    between = np.arctan2(*base) - np.arctan2(*rod)
    for angle in (0.2, 0.9, 1.6):
        data.qpos[:] = angle
        mujoco.mj_forward(model, data)
        turned = between - (angle + turn)
        length = np.sqrt(a**2 + b**2 - 2.0 * a * b * np.cos(turned))
        assert data.actuator_length[0] == pytest.approx(length, rel=1e-12)
        lever = -a * b * np.sin(turned) / length
        assert actuator_moments(model, data)[0, 0] == pytest.approx(lever, rel=1e-9)


def test_a_lighter_link_has_its_shape_and_another_density(machine):
    def dynamics(mass):
        change = Library(machine).change({("payload", "shank"): np.array([mass, 0.3])}, machine)
        model = change.variant.model
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = 0.7, 1.0
        mujoco.mj_forward(model, data)
        inertia = np.zeros((1, 1))
        mujoco.mj_fullM(model, data, inertia)
        return np.array([inertia[0, 0] - model.dof_armature[0], data.qfrc_bias[0]])

    before, loaded, lighter = (dynamics(mass) for mass in (0.0, 0.2, -0.2))
    assert loaded[0] - before[0] == pytest.approx(0.2 * 0.3**2, rel=1e-4)
    share = 0.2 / machine.base.model.body("shank").mass[0]
    np.testing.assert_allclose(lighter, (1.0 - share) * before, rtol=1e-9)


def test_a_light_thin_rod_on_a_slide_of_its_name_may_be_a_tenth_lighter(tmp_path):
    """A point taken off it would leave an inertia that no body has, and by the motion of its joint
    it had been lighter than nothing."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="rod", pos=[0.0, 0.0, 1.0])
    body.add_joint(name="rod", type=mujoco.mjtJoint.mjJNT_SLIDE)
    body.mass, body.ipos = 1e-3, [0.0, 0.0, -0.1]
    body.fullinertia = [1e-9, 1e-9, 1e-12, 0.0, 0.0, 0.0]
    body.explicitinertial = True
    spec.add_actuator(name="push", target="rod", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    spec.compile()
    path = tmp_path / "rod.xml"
    path.write_text(spec.to_xml())
    rod = Machine(path)
    strong = Motion(position=0.5, deflection=0.5, velocity=1.0, acceleration=0.1, force=1e3)
    seen = Shown({"rod": strong}, {"push": 1.0}, {}, period=1e-3, change=0.1, correlation=0.3)
    library = sized(Library(rod), rod, seen)
    lightest = library.sites["payload", "rod"].lower[0]
    assert lightest == pytest.approx(-1e-4)
    change = library.change({("payload", "rod"): np.array([lightest, 0.15])}, rod)
    assert change.variant.model.body("rod").mass[0] == pytest.approx(9e-4)
