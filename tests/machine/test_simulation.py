"""Models by name, parameters by name, standing still, blowing up."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import leglab.models
from leglab.base.errors import LeglabError, SimulationError
from leglab.commissioning.calibration import holding_forces, settle, speed_limits, valve_maps
from leglab.machine.cylinder import Cylinder
from leglab.machine.library import model_names, model_summary
from leglab.machine.simulation import Simulation, load_model


@pytest.fixture(scope="module")
def bench_model() -> mujoco.MjModel:
    return load_model("knee_bench")


@pytest.fixture
def bench(bench_model: mujoco.MjModel) -> Simulation:
    return Simulation(bench_model)


# On the rail the ground carries what contact decides; leg_motor has no cylinders.
@pytest.mark.parametrize("name", sorted(set(model_names()) - {"leg_motor", "leg_rail"}))
def test_clamped_models_stand_still_once_settled(name):
    simulation = Simulation(load_model(name))
    settle(simulation)
    start = simulation.position().copy()
    simulation.step(round(1.0 / simulation.model.opt.timestep))
    np.testing.assert_allclose(simulation.position(), start, atol=2e-4)


@pytest.mark.parametrize("name", model_names())
def test_every_model_has_a_summary(name):
    assert len(model_summary(name)) > 10


def test_unknown_model_lists_the_known_ones():
    with pytest.raises(LeglabError, match="unknown model 'knee_bnech'.*knee_bench"):
        load_model("knee_bnech")


def test_missing_file_is_named(tmp_path):
    with pytest.raises(LeglabError, match="there.xml': there is no such file"):
        load_model(tmp_path / "there.xml")


def edited_bench(tmp_path, old: str, new: str):
    text = (Path(leglab.models.__path__[0]) / "knee_bench.xml").read_text()
    assert old in text
    path = tmp_path / "edited.xml"
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('key="bore"', 'key="boer"', "boer.*did you mean 'bore'"),
        (
            '<site site="knee_cylinder_rod"/>',
            '<site site="nowhere"/>',
            "unknown site 'nowhere'.*knee_cylinder_base, knee_cylinder_rod",
        ),
        ('tendon="knee_cylinder"', 'tendon="knee_cylindr"', "did you mean 'knee_cylinder'"),
        ("</mujoco>", "", "edited.xml"),
        ('axis="0 1 0"', 'axis="0 nan 0"', r"edited.xml, line \d+: attribute 'axis' is NaN"),
    ],
)
def test_bad_models_get_one_line(tmp_path, old, new, message):
    with pytest.raises(LeglabError, match=message) as caught:
        load_model(edited_bench(tmp_path, old, new))
    assert "\n" not in str(caught.value)


def test_parameters_by_name(bench):
    assert bench.parameter("knee_valve", "internal_leakage") == 1.7e-13
    bench.set_parameter("knee_valve", "internal_leakage", 5e-13)
    assert bench.parameter("knee_valve", "internal_leakage") == 5e-13
    bench.reset()
    assert bench.parameter("knee_valve", "internal_leakage") == 1.7e-13
    with pytest.raises(LeglabError, match="knee_valve.*lap = 5.*allowed"):
        bench.set_parameter("knee_valve", "lap", 5.0)
    with pytest.raises(LeglabError, match="unknown leglab.cylinder parameter 'leakage'"):
        bench.parameter("knee_valve", "leakage")
    with pytest.raises(LeglabError, match="unknown element 'hip_valve'.*knee_valve"):
        bench.parameter("hip_valve", "lap")
    with pytest.raises(LeglabError, match="unknown keyframe 'swing'"):
        bench.reset("swing")


def test_a_blown_up_simulation_names_time_and_joint(bench):
    bench.step(10)
    bench.data.qvel[0] = np.nan
    with pytest.raises(SimulationError, match=r"blew up at 0\.005 s.*joint 'knee' is nan"):
        bench.check()


def test_holding_force_is_gravity_and_spring_over_the_lever(bench):
    q = bench.position()[0]
    torque = 4.5 * 9.81 * 0.22 * np.sin(q)  # gravity extends the knee; the spring rests at 0.9
    assert holding_forces(bench)[0] == pytest.approx(torque / bench.levers()[0], rel=1e-9)


def test_speed_limit_is_the_no_load_speed(bench):
    values = bench.cylinder_parameters("knee_valve")
    lossy = ("lap", "edge_rounding", "internal_leakage", "viscous", "coulomb", "static")
    ideal = Cylinder({**values, **dict.fromkeys(lossy, 0)})
    piston = speed_limits(bench)[0] * abs(bench.levers()[0])
    assert ideal.steady_state(-0.9 * piston, 0.0).spool == pytest.approx(-0.9, abs=1e-3)


def test_calibration_leaves_the_machine_where_it_was(bench):
    before = bench.data.qpos.copy(), bench.data.qvel.copy()
    valve_map = valve_maps(bench)[0]
    np.testing.assert_array_equal(bench.data.qpos, before[0])
    np.testing.assert_array_equal(bench.data.qvel, before[1])
    # The knee's cylinder retracts to flex it: faster flexion needs a lower command.
    middle = valve_map.command[len(valve_map.position) // 2]
    assert np.all(np.diff(middle) < 0)


def test_cylinders_know_the_effective_mass_of_the_mechanism():
    simulation = Simulation(load_model("leg"), keyframe="swing")
    model, data = simulation.model, simulation.data
    data.qvel[:] = np.linspace(-1.0, 1.0, model.nv)
    mujoco.mj_forward(model, data)
    moment = np.diag(simulation.levers())  # each cylinder moves its joint alone
    solved = np.empty_like(moment)
    mujoco.mj_solveM(model, data, solved, moment)
    mass = 1.0 / np.einsum("ij,ij->i", moment, solved)
    speed, force = data.actuator_velocity.copy(), data.actuator_force.copy()
    simulation.step()
    gained = moment @ data.qvel - speed
    load = data.plugin_state[simulation.slots("load")]
    np.testing.assert_allclose(load, mass * gained / model.opt.timestep - force, rtol=1e-9)
