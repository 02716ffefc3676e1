"""Runs on machines of MuJoCo's own actuators: closed forms, an integrator of our own, faults."""

import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leglab import RunSettings, data, run_scenario
from leglab.base.errors import LeglabError
from leglab.cli import main
from leglab.commissioning.calibration import (
    free_inertia,
    settle,
    speed_limits,
    valve_maps,
)
from leglab.commissioning.pd_gains import native_plant, tune
from leglab.machine.changes import NativeJoints
from leglab.machine.sensors import SensorConfiguration
from leglab.machine.simulation import Simulation, load_model
from leglab.report.figures import tracking_figure
from leglab.report.film.look import Rect
from leglab.report.film.traces import ErrorTrace
from leglab.report.film.track import load_track
from leglab.report.folder_index import write_index
from leglab.runs.folder import read_runs
from leglab.runs.loop import Loop
from rigs import MOTOR_ARM, SERVO_ARM
from tests.helpers.native_models import GRAVITY, INERTIA, MASS, REACH, pendulum

EXACT = {"position_noise": 0.0, "encoder_counts": 0}
HINGE = MASS * REACH**2 + INERTIA + 0.02  # inertia about the hinge, armature included
MOTOR = '<motor name="drive" joint="hinge" ctrlrange="-6 6" gear="2"/>'

ARM = """
  <mujoco>
    <compiler angle="radian"/>
    <option timestep="0.001" integrator="implicitfast"/>
    <worldbody>
      <body name="upper">
        <joint name="shoulder" type="hinge" axis="0 1 0" armature="0.05" damping="0.6"
               frictionloss="{loss}" stiffness="{stiffness}"/>
        <inertial pos="0 0 -0.2" mass="2.5" diaginertia="0.03 0.03 0.001"/>
        <body name="forearm" pos="0 0 -0.4">
          <joint name="elbow" type="hinge" axis="0 1 0" armature="0.03" damping="0.3"
                 range="-1.5 1.8"/>
          <inertial pos="0 0 -0.17" mass="1.5" diaginertia="0.015 0.015 0.001"/>
        </body>
      </body>
    </worldbody>
    <actuator>{actuators}</actuator>
  </mujoco>"""
TWO_MOTORS = """
  <motor name="upper_drive" joint="shoulder" ctrlrange="-60 60"/>
  <motor joint="elbow" ctrlrange="-5 5" gear="-5"/>"""


AXIS = """
  <mujoco model="axis">
    <worldbody>
      <body name="carriage">
        <joint name="axis" type="slide" axis="1 0 0" armature="0.4" damping="6"/>
        <geom type="box" size="0.05 0.04 0.02" mass="2"/>
      </body>
    </worldbody>
    <actuator><motor name="drive" joint="axis" ctrlrange="-80 80"/></actuator>
  </mujoco>"""


def saved(tmp_path, text, name="machine.xml"):
    path = tmp_path / name
    path.write_text(text)
    return str(path)


def arm(tmp_path, actuators=TWO_MOTORS, *, loss=0.0, stiffness=0.0):
    return saved(tmp_path, ARM.format(actuators=actuators, loss=loss, stiffness=stiffness))


def hinge(tmp_path, actuator=MOTOR, extra=""):
    joint = f'armature="0.02" damping="0.1" {extra}'
    return saved(tmp_path, pendulum(actuator=actuator, joint=joint, timestep=5e-4))


ACTUATORS = {
    "motor": MOTOR,
    "motor of the other sense": '<motor joint="hinge" ctrlrange="-6 6" gear="-2"/>',
    "motor with a lopsided range": '<motor joint="hinge" ctrlrange="-4 10" gear="1.5"/>',
    "motor limited by its force": '<motor joint="hinge" gear="2" forcerange="-6 6"/>',
    "position servo": '<position joint="hinge" kp="80" kv="3"/>',
    "position servo with a gear": '<position joint="hinge" kp="20" kv="1" gear="2"/>',
    "slow position servo": '<position joint="hinge" kp="80" kv="3" timeconst="0.01"/>',
    "velocity servo": '<velocity joint="hinge" kv="5" ctrlrange="-8 8"/>',
    "general, affine gain": '<general joint="hinge" ctrlrange="-1 1" gaintype="affine" '
    'gainprm="12 2 0.3" biastype="affine" biasprm="0.5 -4 -0.6"/>',
    "general of negative gain": '<general joint="hinge" ctrlrange="-3 3" gainprm="-4"/>',
    "filtered general": '<general joint="hinge" ctrlrange="-1 1" gainprm="12" '
    'dyntype="filterexact" dynprm="0.008"/>',
}


@pytest.fixture(params=ACTUATORS.values(), ids=ACTUATORS.keys())
def actuator(request):
    return request.param


def test_a_settled_machine_stands_still_in_any_pose(tmp_path, actuator):
    simulation = Simulation(load_model(hinge(tmp_path, actuator)))
    for pose in (-1.0, 0.0, 0.6):
        simulation.data.qpos[:] = pose
        mujoco.mj_forward(simulation.model, simulation.data)
        settle(simulation)
        assert abs(simulation.data.qacc[0]) < 1e-9
        # The torque is the pendulum's weight, by hand.
        weight = MASS * GRAVITY * REACH * np.sin(pose)
        assert simulation.data.qfrc_actuator[0] == pytest.approx(weight, abs=1e-9)


def test_the_calibrated_map_is_weight_and_damping_by_hand(tmp_path):
    simulation = Simulation(load_model(hinge(tmp_path)))
    (found,) = valve_maps(simulation)
    torque = MASS * GRAVITY * REACH * np.sin(found.position)[:, None] + 0.1 * found.velocity
    np.testing.assert_allclose(found.command, np.clip(torque / (2 * 6), -1, 1), atol=1e-9)
    # 12 N m on its inertia over half of a range of pi, slower than 12 N m against 0.1 N m s.
    (limit,) = speed_limits(simulation)
    assert limit == pytest.approx(np.sqrt(12 * np.pi / HINGE), rel=1e-6)


def test_the_map_moves_a_joint_at_constant_speed(tmp_path, actuator):
    """Whatever the kind of actuator: the command of the map leaves no acceleration."""
    simulation = Simulation(load_model(hinge(tmp_path, actuator, 'range="-69 69"')))
    (found,) = valve_maps(simulation)
    model, data, checked = simulation.model, simulation.data, 0
    for i, position in enumerate(found.position):
        for j, velocity in enumerate(found.velocity):
            if abs(found.command[i, j]) < 1:
                data.qpos[:], data.qvel[:] = position, velocity
                data.ctrl[:] = simulation.centre + simulation.half * found.command[i, j]
                if model.na:
                    data.act[:] = data.ctrl
                mujoco.mj_forward(model, data)
                assert abs(data.qacc[0]) < 1e-6
                checked += 1
    assert checked > 40
    assert np.abs(found.command).max() <= 1.0


def test_the_linear_plant_is_the_pendulum_by_hand(tmp_path):
    simulation = Simulation(load_model(hinge(tmp_path)))
    plant = native_plant(simulation, 0, 0.0)
    stiffness = MASS * GRAVITY * REACH
    np.testing.assert_allclose(plant.A, [[0, 1], [-stiffness / HINGE, -0.1 / HINGE]], rtol=1e-5)
    np.testing.assert_allclose(plant.B, [[0], [12 / HINGE]], rtol=1e-9)
    # A position servo's own loop is part of its plant.
    servo = hinge(tmp_path, '<position joint="hinge" kp="80" kv="3"/>')
    plant = native_plant(Simulation(load_model(servo)), 0, 0.0)
    expected = [[0, 1], [-(80 + stiffness) / HINGE, -3.1 / HINGE]]
    np.testing.assert_allclose(plant.A, expected, rtol=1e-5)
    np.testing.assert_allclose(plant.B, [[0], [80 * np.pi / 2 / HINGE]], rtol=1e-9)


def test_the_linear_plant_of_every_kind_is_the_step_of_the_model(tmp_path, actuator):
    """A small change of the command moves MuJoCo's joint as the linear plant says."""
    simulation = Simulation(load_model(hinge(tmp_path, actuator)))
    settle(simulation)
    plant = native_plant(simulation, 0, 0.0)
    start = simulation.data.ctrl.copy()
    settled = simulation.commands(start)
    # `slopes` holds for command 0: of an affine gain the resting command shifts it.
    simulation.data.ctrl[:] = simulation.centre + simulation.half * (settled + 1e-3)
    steps = 200
    simulation.step(steps)
    import control

    times = np.arange(steps + 1) * simulation.model.opt.timestep
    answer = control.step_response(plant, times).y[0, 0, -1] * 1e-3
    assert simulation.position()[0] == pytest.approx(answer, rel=0.02)


def test_tuned_gains_have_the_gain_margin_that_they_state(tmp_path):
    """A little within its margin the loop is stable, a little beyond it it oscillates."""
    path = hinge(tmp_path)
    gains = tune(Simulation(load_model(path)), 0, sensors=SensorConfiguration())
    assert gains["gain_margin_db"] >= 6.0
    assert gains["phase_margin_deg"] >= 45.0
    margin = 10 ** (gains["gain_margin_db"] / 20)
    late = {}
    for factor in (0.9 * margin, 1.15 * margin):
        settings = RunSettings(
            scenario="nominal",
            model=path,
            duration=3.0,
            timestep=1e-4,
            reference="step",
            reference_config={"amplitude": 0.05, "hold": 2.0, "rise_time": 0.3},
            sensors=EXACT,
            controller_config={
                "position_gain": [factor * gains["position"]],
                "velocity_gain": [factor * gains["velocity"]],
            },
        )
        error = run_scenario(settings).history.error[-250:]
        late[factor < margin] = float(np.ptp(error))
    assert late[True] < 1e-7
    assert late[False] > 1e-3  # a limit cycle: the command saturates


def test_pd_on_a_joint_is_an_integrator_of_our_own(tmp_path):
    """Runge and Kutta's fourth order on the pendulum, with sampling, latency and filter by hand."""
    kp, kv, duration, period, latency = 0.8, 0.05, 2.0, 0.002, 0.001
    settings = RunSettings(
        scenario="nominal",
        model=hinge(tmp_path),
        duration=duration,
        timestep=1e-4,
        sensors=EXACT,
        controller_config={"position_gain": [kp], "velocity_gain": [kv]},
    )
    loop = Loop(settings)
    wanted = loop.reference.sample(np.arange(loop.count) * period)
    history = loop.run()

    def slope(state, torque):
        q, v = state
        return np.array([v, (torque - 0.1 * v - MASS * GRAVITY * REACH * np.sin(q)) / HINGE])

    def integrate(state, torque, span, steps=5):
        h = span / steps
        for _ in range(steps):
            k1 = slope(state, torque)
            k2 = slope(state + h / 2 * k1, torque)
            k3 = slope(state + h / 2 * k2, torque)
            k4 = slope(state + h * k3, torque)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return state

    state, sample = np.zeros(2), 0.0
    read, rate = 0.0, 0.0
    share = 1 - np.exp(-2 * np.pi * 60 * period)
    positions = []
    for k in range(loop.count):
        rate += share * ((sample - read) / period - rate)
        read = sample
        command = kp * (wanted.position[k, 0] - read) + kv * (wanted.velocity[k, 0] - rate)
        torque = 12 * np.clip(command, -1, 1)
        positions.append(state[0])
        state = integrate(state, torque, period - latency)
        sample = state[0]
        state = integrate(state, torque, latency)
    assert np.ptp(history.position) > 0.3
    np.testing.assert_allclose(history.position[:, 0], positions, atol=2e-4)


@pytest.mark.parametrize("model", [MOTOR_ARM.model, SERVO_ARM.model, "leg_motor"], ids=str)
def test_learning_beats_the_calibrated_map_and_that_beats_nothing(model):
    rms = {}
    for controller in ("pd", "static_feedforward", "bsnn_arx"):
        settings = RunSettings(scenario="nominal", model=str(model), controller=controller)
        run = run_scenario(settings)
        assert not run.history.failure
        late = run.history.error[run.history.time > 5]
        rms[controller] = float(np.sqrt(np.mean(late**2)))
    assert rms["bsnn_arx"] < 0.3 * rms["static_feedforward"]
    assert rms["static_feedforward"] < rms["pd"]
    assert rms["pd"] < 0.03


def test_a_servo_is_sent_its_reference():
    """With no gain at all, pd leaves a servo to follow what it is sent by itself."""
    none = {"position_gain": [0.0, 0.0], "velocity_gain": [0.0, 0.0]}
    common = {"scenario": "nominal", "duration": 4.0, "controller_config": none, "sensors": EXACT}
    loop = Loop(RunSettings(model=str(SERVO_ARM.model), **common))
    history = loop.run()
    np.testing.assert_allclose(history.control, history.reference.position, atol=1e-12)
    motors = Loop(RunSettings(model=str(MOTOR_ARM.model), **common)).run()
    np.testing.assert_array_equal(motors.control, 0.0)


def test_a_velocity_servo_is_sent_its_speed(tmp_path):
    none = {"position_gain": [0.0], "velocity_gain": [0.0]}
    model = hinge(tmp_path, '<velocity joint="hinge" kv="5" ctrlrange="-4 8"/>')
    settings = RunSettings(
        scenario="nominal", model=model, duration=3.0, controller_config=none, sensors=EXACT
    )
    history = Loop(settings).run()
    np.testing.assert_allclose(history.control, history.reference.velocity, atol=1e-12)


def test_recordings_have_the_controls_of_the_model(tmp_path):
    path = arm(tmp_path)
    run = run_scenario(
        RunSettings(scenario="nominal", model=path, controller="static_feedforward", duration=2.0)
    )
    recording = run.recording
    assert recording.actuators == ("upper_drive", "elbow")  # the unnamed one as its joint
    assert not any("pressure" in name or "oil" in name for name in recording.columns)
    # What MuJoCo makes of the recorded controls, open loop, is the recorded motion.
    model = load_model(path)
    data = mujoco.MjData(model)
    at = []
    for row in recording.stack(recording.actuators, "command"):
        at.append(data.qpos.copy())
        data.ctrl[:] = row
        mujoco.mj_step(model, data, 2)
    true = recording.stack(("shoulder", "elbow"), "truth")
    np.testing.assert_allclose(np.array(at), true, atol=1e-9)
    # Shares of the range, and what reaches the joint.
    np.testing.assert_allclose(recording.command_of("shoulder"), run.history.command[:, 0])
    np.testing.assert_allclose(
        recording["shoulder_effort"][1:], recording["upper_drive_command"][:-1], rtol=1e-12
    )
    np.testing.assert_allclose(
        recording["elbow_effort"][1:], -5 * recording["elbow_command"][:-1], rtol=1e-12
    )
    units = recording.metadata["units"]
    assert units["elbow_effort"] == "N m"
    assert units["elbow_command"] == "ctrl"
    assert all("energy_j" not in phase for phase in run.metrics["phases"])
    json.dumps(run.metrics)


def test_faults_reach_the_joints_and_leave_with_the_run(tmp_path):
    path = arm(tmp_path, loss=0.5, stiffness=2.0)
    for scenario, field, factor in (
        ("friction_rise", "dof_damping", 3.0),
        ("friction_rise", "dof_frictionloss", 3.0),
        ("spring_fatigue", "jnt_stiffness", 0.5),
    ):
        loop = Loop(RunSettings(scenario=scenario, model=path, duration=0.2))
        before = getattr(loop.simulation.model, field).copy()
        seen = []
        loop.watch = lambda k, seen=seen, loop=loop, field=field: seen.append(
            getattr(loop.simulation.model, field).copy()
        )
        for _ in range(loop.count):
            loop.step()
        np.testing.assert_allclose(seen[0], before)
        np.testing.assert_allclose(seen[-1], factor * before)
        loop.close()
        np.testing.assert_array_equal(getattr(loop.simulation.model, field), before)
    one = Loop(RunSettings(scenario="friction_rise", model=path, duration=0.2, element="elbow"))
    for _ in range(one.count):
        one.step()
    np.testing.assert_allclose(one.simulation.model.dof_damping, [0.6, 0.9])


def test_the_outermost_body_and_joint_take_what_a_leg_calls_by_name(tmp_path):
    path = arm(tmp_path)
    payload = Loop(RunSettings(scenario="payload", model=path, duration=1.0))
    assert [change.element for change in payload.scenario.changes] == ["forearm"]
    slip = Loop(RunSettings(scenario="encoder_shift", model=path, duration=1.0))
    assert [change.element for change in slip.scenario.changes] == ["elbow"]
    chosen = Loop(
        RunSettings(scenario="encoder_shift", model=path, duration=1.0, element="shoulder")
    )
    for _ in range(chosen.count):
        chosen.step()
    assert chosen.machine.encoders.shift[-1].tolist() == [0.03, 0.0]


def test_a_weak_actuator_is_a_fault_of_its_force(tmp_path):
    simulation = Simulation(load_model(arm(tmp_path)))
    joints = NativeJoints(simulation)
    joints.set_parameter("elbow", "actuator_gain", 0.7)
    simulation.data.ctrl[:] = 2.0
    mujoco.mj_forward(simulation.model, simulation.data)
    np.testing.assert_allclose(simulation.data.qfrc_actuator, [2.0, -5 * 2.0 * 0.7])
    with pytest.raises(LeglabError, match="elbow.*actuator_gain = -1; allowed"):
        joints.set_parameter("elbow", "actuator_gain", -1.0)
    joints.restore()
    mujoco.mj_forward(simulation.model, simulation.data)
    np.testing.assert_allclose(simulation.data.qfrc_actuator, [2.0, -10.0])


def test_a_specimen_differs_in_friction_and_force_and_is_the_seeds(tmp_path):
    path = arm(tmp_path, loss=0.5)
    common = {"scenario": "nominal", "model": path, "duration": 0.1, "tolerance": 0.1}
    found = {}
    for seed in (1, 2, 1):
        loop = Loop(RunSettings(**common, seed=seed))
        model = loop.simulation.model
        values = [model.dof_damping, model.dof_frictionloss, model.actuator_gainprm[:, 0]]
        flat = np.concatenate(values)
        nominal = loop.preparation.nominal.model.dof_damping
        np.testing.assert_array_equal(nominal, [0.6, 0.3])
        if seed in found:
            np.testing.assert_array_equal(flat, found[seed])
        found[seed] = flat.copy()
        loop.reset()  # the specimen again, not a specimen of the specimen
        again = [model.dof_damping, model.dof_frictionloss, model.actuator_gainprm[:, 0]]
        np.testing.assert_array_equal(np.concatenate(again), flat)
    assert (found[1] != found[2])[[0, 1, 2, 4, 5]].all()


MIXED = """
  <mujoco>
    <extension>
      <plugin plugin="leglab.cylinder">
        <instance name="ram">
          <config key="bore" value="0.025"/><config key="rod" value="0.014"/>
          <config key="stroke" value="0.4"/><config key="mid_length" value="0"/>
        </instance>
      </plugin>
    </extension>
    <option timestep="0.0005" integrator="implicitfast"/>
    <worldbody>
      <body name="carriage">
        <joint name="axis" type="slide" axis="1 0 0" range="-0.15 0.15" damping="50"/>
        <inertial pos="0 0 0" mass="20" diaginertia="1 1 1"/>
        <body name="arm">
          <joint name="hinge" type="hinge" axis="0 1 0" damping="0.3"/>
          <inertial pos="0 0 -0.2" mass="1" diaginertia="0.02 0.02 0.02"/>
        </body>
      </body>
    </worldbody>
    <actuator>
      <motor name="drive" joint="hinge" ctrlrange="-20 20"/>
      <plugin name="valve" joint="axis" plugin="leglab.cylinder" instance="ram"/>
    </actuator>
  </mujoco>"""


def test_a_machine_of_cylinders_and_motors_runs(tmp_path):
    path = saved(tmp_path, MIXED)
    for controller in ("pd", "static_feedforward", "bsnn_arx"):
        run = run_scenario(
            RunSettings(scenario="seal_wear", model=path, controller=controller, duration=4.0)
        )
        assert not run.history.failure
        assert (np.sqrt(np.mean(run.history.error**2, axis=0)) < [0.05, 0.01]).all()
        assert run.joints == ("hinge", "axis")
        assert "axis_pressure_a" in run.recording
        assert "hinge_pressure_a" not in run.recording
        assert set(run.metrics["phases"][0]["energy_j"]) == {"axis", "all"}
        leak = run.recording["valve_internal_leakage"]
        assert leak[-1] == pytest.approx(10 * leak[0])
    with pytest.raises(LeglabError, match="data sheets of cylinders, and actuator 'drive' is none"):
        run_scenario(
            RunSettings(scenario="nominal", model=path, controller="adaptive_backstepping")
        )


@pytest.mark.parametrize(
    ("actuators", "message"),
    [
        ('<motor name="m" joint="elbow"/>', "actuator 'm' has no ctrlrange.*give it a ctrlrange"),
        (
            '<motor joint="elbow" ctrlrange="-1 1"/><position joint="elbow" kp="2"/>',
            "joint 'elbow' is driven by actuators 'elbow' and 'elbow'; allowed: one",
        ),
        (
            '<intvelocity name="m" joint="elbow" kp="2" actrange="-1 1" ctrlrange="-1 1"/>',
            "actuator 'm' has dynamics other than none.*allowed: motor, position",
        ),
        (
            '<muscle name="m" joint="elbow" ctrlrange="0 1" lengthrange="0.1 1"/>',
            "actuator 'm' has a gain that is neither.*allowed: motor",
        ),
    ],
)
def test_what_cannot_be_commanded_is_named_in_one_line(tmp_path, actuators, message):
    with pytest.raises(LeglabError, match=message) as caught:
        Simulation(load_model(arm(tmp_path, actuators)))
    assert "\n" not in str(caught.value)


def test_a_scenario_of_oil_names_those_that_fit(tmp_path, capsys):
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as stopped:
        main(["run", "seal_wear", "--model", "leg_motor", "--out", str(out)])
    assert stopped.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "'internal_leakage'" in line
    able = line.partition("scenarios for this machine: ")[2].split(", ")
    assert set(able) >= {"nominal", "payload", "friction_rise", "encoder_shift", "sensor_dropout"}
    assert not {"cold_oil", "supply_drop", "valve_wear", "seal_wear"} & set(able)
    assert not out.exists()
    for name in able:  # and they do run
        run = run_scenario(RunSettings(scenario=name, model="leg_motor", duration=0.4))
        assert not run.history.failure


def test_the_command_line_runs_compares_and_draws(tmp_path, capsys):
    model = str(Path(SERVO_ARM.model))
    out = tmp_path / "run"
    main(["run", "payload", "--model", model, "--duration", "1", "--out", str(out)])
    assert {"commands.png", "tracking.png", "metrics.json", "run.json"} <= {
        path.name for path in out.iterdir()
    }
    assert not (out / "pressures.png").exists()
    told = json.loads((out / "run.json").read_text())
    assert told["settings"]["reference"] == "multisine"
    assert told["elements"]["elbow_drive"]["gain"][0] == 60.0
    main(["report", str(out), "--no-video", "--out", str(tmp_path / "page")])
    page = (tmp_path / "page" / "report.html").read_text()
    assert "Chamber pressures" not in page
    assert "The supply gave" not in page


def test_a_slide_with_the_default_timestep_runs_and_its_errors_are_told_in_mm(tmp_path, capsys):
    """As a user's first file: no option at all."""
    model = saved(tmp_path, AXIS, "axis.xml")
    out, settings = tmp_path / "run", ["--model", model, "--duration", "1", "--no-figures"]
    main(["run", "payload", *settings, "--out", str(out)])
    told = capsys.readouterr().out
    assert "latency is 0.002 s: rounded up to whole steps of the model's timestep 0.002" in told
    sensors = json.loads((out / "run.json").read_text())["settings"]["sensors"]
    assert (sensors["control_period"], sensors["latency"]) == (0.002, 0.002)
    main(["report", str(out), "--no-video"])
    page = (out / "report.html").read_text()
    run = data.read(out / "recording.parquet")
    (drawn,) = tracking_figure(run).axes[1:]
    main(["compare", "payload", "--controllers", "pd", "--seeds", "1", "--jobs", "1", *settings,
          "--out", str(tmp_path / "both")])  # fmt: skip
    compared = capsys.readouterr().out
    track = load_track(out)
    panel = ErrorTrace([track], [(0, 0, 0)], Rect(0, 0, 100, 100), (0.0, 1.0))
    texts = (told, page, drawn.get_ylabel(), compared, panel._note, repr(read_runs([out])[0]))
    for text in texts:
        assert re.search(r"\bmm\b", text), text
        assert "mrad" not in text
    assert "angle [rad]" not in page
    write_index(tmp_path, tmp_path / "index.html")
    assert "mrad or mm" in (tmp_path / "index.html").read_text()


def test_the_inertia_with_the_others_free_is_smaller_than_held(tmp_path):
    simulation = Simulation(load_model(arm(tmp_path)))
    # Hanging straight down: m11 m22 - m12^2 over m22, by hand.
    m22 = 0.03 + 0.015 + 1.5 * 0.17**2
    m12 = 0.015 + 1.5 * (0.17**2 + 0.4 * 0.17)
    m11 = 0.05 + 0.03 + 2.5 * 0.2**2 + 0.015 + 1.5 * (0.4**2 + 0.17**2 + 2 * 0.4 * 0.17)
    assert free_inertia(simulation, 0) == pytest.approx(m11 - m12**2 / m22, rel=1e-9)


def test_ilc_feeds_a_servo_once(tmp_path):
    """The map of a servo holds what its loop needs: sent again, the joint would be far off."""
    model = hinge(tmp_path, ACTUATORS["position servo"])
    settings = {"scenario": "nominal", "model": model, "duration": 3.0}
    static, learned = (
        np.sqrt(np.mean(run_scenario(RunSettings(controller=c, **settings)).history.error ** 2))
        for c in ("static_feedforward", "ilc")
    )
    assert learned < 1.5 * static
