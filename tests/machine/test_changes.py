"""Changes that reach the machine: what each scenario does to it, bodies and encoders included."""

import copy

import mujoco
import numpy as np
import pytest

from leglab import RunSettings, run_scenario
from leglab.base.errors import LeglabError
from leglab.base.scenario import ParameterChange, Scenario, get_scenario, scenario_names
from leglab.machine.changes import Bodies, NativeJoints, Schedule, fitted
from leglab.machine.sensors import Encoders, SensorConfiguration, held
from leglab.machine.simulation import Simulation, load_model
from tests.helpers.native_models import machine

# What the last sample of a recording must show: parameter -> value from the nominal one.
EFFECTS = {
    "external_leak": {
        "external_leakage_a": lambda old: 5e-13,
        "external_leakage_b": lambda _: 5e-13,
    },
    "viscosity_change": {
        "viscosity_40": lambda _: 100e-6,
        "viscosity_100": lambda _: 11.4e-6,
        "viscous": lambda old: old * 100 / 46,
        "internal_leakage": lambda old: old * 46 / 100,
    },
    "supply_drop": {"supply_pressure": lambda _: 10e6},
    "supply_droop": {"pump_flow": lambda old: 0.5 * old, "accumulator_volume": lambda old: old / 4},
    "air_in_oil": {"entrained_air": lambda _: 0.05},
    "valve_wear": {"lap": lambda _: 0.06, "hysteresis": lambda _: 0.06},
    "valve_null_shift": {"null_bias": lambda _: 0.03},
    "slow_valve": {"bandwidth_hz": lambda _: 40.0},
    "friction_rise": {name: lambda old: 3 * old for name in ("coulomb", "static", "viscous")},
    "stiction": {"static": lambda old: 4 * old},
    "spring_fatigue": {name: lambda old: old / 2 for name in ("k1", "k2")},
    "payload": {"added_mass": lambda _: 5.0},
    "encoder_shift": {"encoder_offset": lambda _: 0.03},
    "sensor_dropout": {"encoder_dropout": lambda _: 0.3},
    "seal_wear": {"internal_leakage": lambda old: 10 * old},
    "seal_wear_supply_drop": {
        "internal_leakage": lambda old: 10 * old,
        "supply_pressure": lambda _: 12e6,
    },
    "cold_oil": {"oil_temperature": lambda _: 0.0},
    "hot_oil": {"oil_temperature": lambda _: 80.0},
}


def test_every_scenario_with_a_change_is_tested_here():
    assert set(EFFECTS) | {"nominal", "cold_start"} == set(scenario_names())


@pytest.mark.parametrize("model", ["leg", "knee_bench"])
@pytest.mark.parametrize("name", EFFECTS)
def test_the_recording_shows_what_the_scenario_says(name, model):
    settings = RunSettings(scenario=name, model=model, duration=1.0)
    if (name, model) == ("supply_droop", "knee_bench"):
        with pytest.raises(LeglabError, match="'pump_flow' of '\\*', which no element"):
            run_scenario(settings)
        return
    recording = run_scenario(settings).recording
    for parameter, new in EFFECTS[name].items():
        columns = [c for c in recording.columns if c.endswith(f"_{parameter}")]
        if parameter == "oil_temperature":
            columns = [c for c in columns if not c.endswith("_valve_oil_temperature")]
        assert columns
        for column in columns:
            before, after = recording[column][recording.time < 0.5], recording[column][-1]
            np.testing.assert_array_equal(before, before[0])
            assert after == pytest.approx(new(before[0]), rel=1e-3, abs=1e-18)
            assert after != before[0]


@pytest.mark.parametrize("model", ["leg", "knee_bench"])
def test_what_the_cylinders_see_of_the_supply_falls(model):
    """Not only the parameter: on the leg the cylinders draw from an accumulator."""
    run = run_scenario(RunSettings(scenario="supply_drop", model=model, duration=4.0))
    seen = run.recording["supply_pressure"]
    assert seen[run.recording.time < 2.0].min() > 14.5e6
    assert seen[-500:].max() < 10.6e6


def test_a_cold_start_warms_up_by_itself():
    recording = run_scenario(
        RunSettings(scenario="cold_start", model="knee_bench", duration=10.0)
    ).recording
    temperature = recording["knee_oil_temperature"]
    assert temperature[0] == pytest.approx(0.0, abs=0.05)
    assert 3.0 < temperature[-1] < 20.0
    with pytest.raises(LeglabError, match="'cold_start' starts cold"):
        get_scenario("cold_start", ramp_duration=2.0)


def test_air_comes_in_at_the_same_pressure():
    """A step of the air alone would make the pressure jump: the amounts of oil are the state."""
    simulation = Simulation(load_model("knee_bench"))
    simulation.step(20)
    before = simulation.data.plugin_state.copy()
    simulation.set_parameter("knee_valve", "entrained_air", 0.05)
    assert (
        simulation.parameter("knee_valve", "amount_a")
        > before[simulation.slot("knee_valve", "amount_a")]
    )
    simulation.step()
    for name in ("pressure_a", "pressure_b"):
        slot = simulation.slot("knee_valve", name)
        assert simulation.data.plugin_state[slot] == pytest.approx(before[slot], rel=0.01)


def test_own_supply_pressure_counts_only_without_a_shared_supply():
    assert not Simulation(load_model("leg")).has("knee_valve", "supply_pressure")
    assert Simulation(load_model("leg")).has("supply", "supply_pressure")
    assert Simulation(load_model("knee_bench")).has("knee_valve", "supply_pressure")


def test_a_load_changes_the_mass_matrix_as_a_point_mass_does():
    model = load_model("knee_bench")
    simulation = Simulation(model)
    inertia = simulation.data.M[0]
    Bodies(model).set_parameter("shank", "added_mass", 5.0)
    simulation.reset()
    assert simulation.data.M[0] - inertia == pytest.approx(5.0 * 0.22**2)
    assert model.dof_M0[0] == pytest.approx(simulation.data.M[0])


@pytest.mark.parametrize("name", ["leg", "knee_bench"])
def test_taking_a_load_off_restores_the_model_bit_by_bit(name):
    model = load_model(name, visual=False)
    untouched = copy.copy(model)
    bodies = Bodies(model)
    bodies.set_parameter("shank", "added_mass", 5.0)
    assert model.body_subtreemass[0] == pytest.approx(untouched.body_subtreemass[0] + 5.0)
    bodies.restore()
    arrays = [n for n in dir(model) if isinstance(getattr(model, n, None), np.ndarray)]
    assert "body_invweight0" in arrays
    for array in arrays:
        np.testing.assert_array_equal(getattr(model, array), getattr(untouched, array), array)


def test_a_run_with_a_load_is_deterministic_and_matters():
    settings = RunSettings(scenario="payload", model="knee_bench", duration=2.0)
    first, again = run_scenario(settings), run_scenario(settings)
    assert first.recording == again.recording
    free = run_scenario(RunSettings(scenario="nominal", model="knee_bench", duration=2.0))
    moved = np.abs(first.history.position - free.history.position)
    assert np.all(moved[first.history.time <= 1.0] == 0)
    assert moved[-1] > 1e-3


@pytest.mark.parametrize(
    ("element", "name", "value", "message"),
    [
        ("shnk", "added_mass", 1.0, "unknown body 'shnk'.*did you mean 'shank'"),
        ("shank", "mass", 1.0, "unknown body parameter 'mass'"),
        ("shank", "added_mass", -1.0, r"'shank': added_mass = -1; allowed \[0, 1000\] kg"),
    ],
)
def test_bad_loads(element, name, value, message):
    with pytest.raises(LeglabError, match=message):
        Bodies(load_model("knee_bench")).set_parameter(element, name, value)


def test_a_body_that_cannot_move_carries_nothing():
    bodies = Bodies(load_model("leg"))
    assert "pelvis" not in bodies.elements
    assert "pelvis" in Bodies(load_model("leg_rail")).elements


def test_a_slipped_encoder_misleads_the_controller_and_the_recording():
    run = run_scenario(RunSettings(scenario="encoder_shift", model="knee_bench", duration=4.0))
    recording = run.recording
    difference = recording["knee_position"] - recording["knee_truth"]
    assert difference[recording.time < 2.0].mean() == pytest.approx(0.0, abs=1e-5)
    assert difference[recording.time >= 2.0].mean() == pytest.approx(0.03, abs=1e-5)
    free = run_scenario(RunSettings(scenario="nominal", model="knee_bench", duration=4.0))
    assert (run.history.position - free.history.position)[-500:].mean() < -0.005


def test_lost_readings_are_repeated_and_the_share_is_right():
    run = run_scenario(RunSettings(scenario="sensor_dropout", model="knee_bench", duration=8.0))
    lost = run.history.encoder_lost[:, 0]
    half = run.history.time >= 4.0
    assert not lost[~half].any()
    # 2001 draws: three standard deviations are 0.031.
    assert lost[half].mean() == pytest.approx(0.3, abs=0.031)
    position = run.recording["knee_position"]
    assert np.all(np.diff(position)[lost[1:]] == 0)


def test_an_encoder_without_faults_only_quantises():
    positions = np.array([9.0, 0.1, 0.2])
    encoders = Encoders(
        ("a", "b"),
        SensorConfiguration(encoder_counts=0),
        positions=positions,
        index=np.array([1, 2]),
        noise=np.zeros((4, 2)),
        seed=0,
    )

    def reading(k: int, *true: float) -> np.ndarray:
        positions[1:] = true
        encoders.sample()
        positions[1:] = np.nan  # a reading is of the sample, not of now
        encoders.read(k)
        return encoders.position

    np.testing.assert_array_equal(reading(0, 0.1, 0.2), [0.1, 0.2])
    encoders.set_parameter("b", "encoder_dropout", 1.0)
    encoders.set_parameter("a", "encoder_offset", -0.5)
    np.testing.assert_array_equal(reading(1, 1.0, 1.0), [0.5, 0.2])
    encoders.set_parameter("b", "encoder_dropout", 0.0)
    np.testing.assert_array_equal(reading(2, 1.0, 1.0), [0.5, 1.0])
    np.testing.assert_array_equal(encoders.shift[:3], [[0, 0], [-0.5, 0], [-0.5, 0]])
    # A viewer goes round: what a reading was shifted by last time does not add up.
    np.testing.assert_array_equal(reading(1, 1.0, 1.0), [0.5, 1.0])
    encoders.set_parameter("a", "encoder_offset", 0.0)
    np.testing.assert_array_equal(reading(2, 1.0, 1.0), [1.0, 1.0])
    for arguments, message in (
        (("c", "encoder_offset", 0.1), "unknown joint 'c'"),
        (("a", "offset", 0.1), "unknown encoder fault 'offset'"),
        (("a", "encoder_dropout", 1.1), r"'a': encoder_dropout = 1.1; allowed \[0, 1\]"),
    ):
        with pytest.raises(LeglabError, match=message):
            encoders.set_parameter(*arguments)


def test_held_equals_brute_force():
    rng = np.random.default_rng(0)
    reading, lost = rng.normal(size=200), rng.random(200) < 0.6
    lost[0] = False
    expected, last = [], None
    for value, missing in zip(reading, lost, strict=True):
        last = last if missing else value
        expected.append(last)
    np.testing.assert_array_equal(held(reading, lost), expected)


def test_a_ramp_reaches_bodies_and_encoders():
    model = load_model("knee_bench")
    bodies = Bodies(model)
    changes = (
        ParameterChange(
            parameter="added_mass", kind="set", value=4.0, start=1.0, ramp_duration=2.0
        ),
    )
    scenario = Scenario(name="x", duration=5.0, changes=changes)
    schedule = Schedule(scenario, Simulation(model), bodies)
    mass = model.body_mass[-1]
    for now, expected in ((0.5, 0.0), (2.0, 2.0), (3.0, 4.0), (4.0, 4.0)):
        schedule.apply(now)
        assert schedule.values == pytest.approx([expected])
        assert model.body_mass[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "shank")] == (
            mass + expected
        )


def test_a_user_reference_replaces_the_settings_of_the_scenarios_own():
    base = RunSettings(scenario="supply_droop", duration=1.0)
    run = run_scenario(base)
    assert run.configuration.settings["reference_config"] == {"period": 0.9}
    other = RunSettings(scenario="supply_droop", duration=1.0, reference="squat")
    assert run_scenario(other).configuration.settings["reference_config"] == {}


def test_a_joint_alone_is_not_one_whose_name_goes_on():
    inner = link("hip_yaw", "")
    drives = "".join(
        f'<motor name="{joint}_drive" joint="{joint}" ctrlrange="-1 1"/>'
        for joint in ("hip", "hip_yaw")
    )
    model = mujoco.MjModel.from_xml_string(machine(link("hip", inner), drives, []))
    legged = Simulation(model)
    for joint in ("hip", "hip_yaw"):
        scenario = fitted(get_scenario("friction_rise", element=joint), legged)
        changed = Schedule(scenario, legged, NativeJoints(legged)).others
        assert {element for element, _ in changed} == {joint}


def link(joint, inner):
    return f"""<body name="{joint}_body" pos="0 0 -0.3">
          <joint name="{joint}" axis="0 1 0" stiffness="1" damping="0.1" range="-1 1"/>
          <inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/>{inner}
        </body>"""


def test_a_joint_without_the_part_is_refused_where_others_have_it():
    with pytest.raises(LeglabError, match=r"of 'hip_yaw,hip_yaw_\*'.*parameter of .*knee_spring"):
        run_scenario(
            RunSettings(scenario="spring_fatigue", element="hip_yaw", controller="pd", duration=1.0)
        )
