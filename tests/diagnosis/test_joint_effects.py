"""Effects on mechanics, friction, sensing and actuators: every one on every kind of machine."""

import warnings

import mujoco
import numpy as np
import pytest

import leglab.machine.plugin
from leglab.diagnosis.effects import all_effects
from leglab.diagnosis.effects.backlash import drive_torque
from leglab.diagnosis.effects.base import Effect
from leglab.diagnosis.effects.cylinder import CylinderEffect
from leglab.diagnosis.plant.model import Change, Machine, Measured
from tests.helpers.native_models import command_path, pendulum, slide

SERVO = '<position name="drive" joint="hinge" kp="40" kv="2" ctrlrange="-2 2"/>'
INTEGRATED = '<intvelocity name="drive" joint="axis" kp="60" actrange="-1 1" ctrlrange="-2 2"/>'
MODELS = {
    "slide": slide(joint='damping="3" frictionloss="0.5" armature="0.3"'),
    "integrated_slide": slide(actuator=INTEGRATED, joint='armature="0.2"'),
    "pendulum": pendulum(joint='armature="0.02" damping="0.1" stiffness="1" springref="20"'),
    "servo": pendulum(actuator=SERVO),
}
MINE = (
    "armature",
    "base_tilt",
    "backlash",
    "joint_flexibility",
    "spring_stiffness",
    "spring_hardening",
    "spring_offset",
    "quadratic_damping",
    "cogging",
    "viscous_friction",
    "coulomb_friction",
    "stiction",
    "asymmetric_friction",
    "load_dependent_friction",
    "encoder_offset",
    "encoder_scale",
    "sensor_delay",
    "actuator_gain",
    "force_offset",
    "command_deadband",
    "command_hysteresis",
    "command_bandwidth",
    "command_bias",
    "command_delay",
)


@pytest.fixture(scope="module")
def machines(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    found = {"knee_bench": Machine("knee_bench", timestep=1e-3)}
    for name, xml in MODELS.items():
        (folder / f"{name}.xml").write_text(xml)
        found[name] = Machine(folder / f"{name}.xml")
    return found


def commands(machine, seconds=1.2):
    t = machine.timestep * np.arange(round(seconds / machine.timestep))
    model = machine.base.model
    size = model.actuator_ctrlrange[0, 1] if model.actuator_ctrllimited[0] else 3.0
    if machine.path.name == "knee_bench.xml":
        size = 0.3  # the whole stroke takes a tenth of a second
    return 0.5 * size * (0.6 * np.sin(9 * t + 0.3) + 0.4 * np.sin(25 * t + 2))


def replay(machine, change, model=None):
    """Positions that a sensor shows, (n,), from the change's edits, parameters and signal paths."""
    variant = machine.variant(tuple(change.edits))
    state = variant.plugin_state.copy()
    for (element, name), value in change.parameters.items():
        state[variant.slot(element, name)] = value
    data = mujoco.MjData(model or variant.model)
    if model is None:
        model = variant.model
        data.plugin_state[:] = state
    starts = {"knee_bench": 0.9, "slide": 0.1, "integrated_slide": 0.1}
    data.qpos[0] = starts.get(machine.path.stem, 0.6)
    u = commands(machine)
    for path in change.commands.get(machine.actuators[0], ()):
        u = path(u, machine.timestep)
    if model.nhistory:  # as if the first command had always been there
        count = int(model.actuator_history[0, 0])
        times = -machine.timestep * np.arange(count, 0, -1.0)
        mujoco.mj_initCtrlHistory(model, data, 0, times, np.full(count, u[0]))
    shown = []
    for value in u:
        data.ctrl[0] = value
        mujoco.mj_step(model, data)
        shown.append(data.qpos[0])
    shown = np.array(shown)
    for column, functions in change.corrections.items():
        assert column == f"{machine.joints[0]}_position"
        for function, _ in functions:
            shown = function(shown, machine.timestep)
    return shown


def cases(machines_by_name):
    for name, machine in machines_by_name.items():
        for effect in all_effects():
            if effect.name in MINE and not isinstance(effect, CylinderEffect):
                for element in effect.elements(machine):
                    yield name, machine, effect, element


def nominal(effect: Effect, machine, element):
    return {p.name: p.nominal for p in effect.parameters(machine, element)}


def test_every_effect_of_the_table_is_there_where_it_can_be(machines):
    found = {(name, effect.name) for name, _, effect, _ in cases(machines)}
    everywhere = set(MINE) - {
        "backlash",
        "joint_flexibility",
        "spring_offset",
        "base_tilt",
        "command_bias",
        "actuator_gain",
        "viscous_friction",
        "coulomb_friction",
        "stiction",
        "command_deadband",
        "command_hysteresis",
        "command_bandwidth",
    }
    assert {(name, effect) for name in machines for effect in everywhere} - found == set()
    native = {"actuator_gain", "viscous_friction", "coulomb_friction", "stiction"}
    native |= {"command_deadband", "command_hysteresis", "command_bandwidth"}
    assert {(name, effect) for name in MODELS for effect in native} - found == set()
    assert {("pendulum", "spring_offset"), ("knee_bench", "spring_offset")} <= found
    assert {("pendulum", "base_tilt"), ("knee_bench", "base_tilt")} <= found
    assert {("slide", "backlash"), ("pendulum", "backlash"), ("servo", "backlash")} <= found
    assert ("integrated_slide", "command_bias") in found
    # Of a motor the bias is a force offset, and cylinders have their friction themselves.
    assert ("slide", "command_bias") not in found
    assert ("knee_bench", "stiction") not in found


def test_nominal_values_change_nothing(machines):
    for name, machine, effect, element in cases(machines):
        change = Change(machine)
        effect.apply(change, element, nominal(effect, machine, element))
        where = f"{effect.name} of {element} on {name}"
        plain = replay(machine, Change(machine))
        np.testing.assert_array_equal(replay(machine, change), plain, err_msg=where)


def test_every_trial_shows_and_severe_ones_show_more(machines):
    for name, machine, effect, element in cases(machines):
        plain = replay(machine, Change(machine))
        strengths = [p for p in effect.parameters(machine, element) if p.role == "strength"]
        for parameter in strengths:
            shifts = []
            for trial in parameter.trials:
                assert parameter.lower <= trial <= parameter.upper
                values = {**nominal(effect, machine, element), parameter.name: trial}
                change = Change(machine)
                effect.apply(change, element, values)
                moved = replay(machine, change)
                where = f"{effect.name} {parameter.name} = {trial:g} of {element} on {name}"
                assert np.isfinite(moved).all(), where
                shifts.append(
                    (abs(trial - parameter.nominal), np.sqrt(np.mean((moved - plain) ** 2)))
                )
            shifts.sort()
            if shifts:
                where = f"{effect.name} {parameter.name} of {element} on {name}: {shifts}"
                assert shifts[-1][1] > 1e-5, where
                assert shifts[-1][1] >= 0.99 * shifts[0][1], where


def test_what_is_written_moves_as_what_was_fitted(machines):
    """improved.xml: edits and instances with their parameters."""
    for name, machine, effect, element in cases(machines):
        parameters = effect.parameters(machine, element)
        values = nominal(effect, machine, element)
        values[parameters[0].name] = parameters[0].trials[-1]
        change, written = Change(machine), Change(machine)
        effect.apply(change, element, values)
        if change.corrections:
            continue  # a sensor fault leaves the motion alone
        wanted = replay(machine, change)
        effect.write(written, element, values)
        model = mujoco.MjModel.from_xml_string(compiled_xml(patched(machine, written)))
        bare = Change(machine)
        bare.edits = change.edits
        moved = replay(machine, bare, model)
        where = f"{effect.name} of {element} on {name}"
        # MuJoCo writes some attributes with six digits; its friction loss holds a little later.
        limit = 1e-5 if effect.name != "coulomb_friction" else 2e-3
        np.testing.assert_allclose(moved, wanted, atol=limit, err_msg=where)


def patched(machine, change):
    """The model with a change's edits and plugin parameters."""
    spec = machine.spec()
    spec.option.timestep = machine.timestep
    for _, edit in change.edits:
        edit(spec)
    for plugin in spec.plugins:
        for (owner, key), value in change.parameters.items():
            if owner == plugin.name:
                plugin.config = {**plugin.config, key: repr(value)}
    return spec


def compiled_xml(spec):
    spec.compile()
    return leglab.machine.plugin.to_xml(spec)


def test_sensor_faults_are_written_beside_the_model(machines):
    machine = machines["pendulum"]
    effects = {effect.name: effect for effect in all_effects()}
    change = Change(machine)
    effects["encoder_offset"].write(change, "hinge", {"offset": 0.03})
    effects["sensor_delay"].write(change, "hinge", {"delay": 0.004})
    model = mujoco.MjModel.from_xml_string(compiled_xml(patched(machine, change)))
    assert model.numeric("hinge_encoder_offset").data[0] == 0.03
    data = mujoco.MjData(model)
    shown, positions = [], []
    for _ in range(50):
        data.ctrl[0] = 1.0
        positions.append(data.qpos[0])
        mujoco.mj_step(model, data)
        shown.append(data.sensor("hinge_delayed_position").data[0])
    np.testing.assert_allclose(shown[10:], positions[6:-4], atol=1e-12)


def test_command_faults_compose_on_one_actuator_and_with_a_play(machines):
    machine = machines["pendulum"]
    joints = (effect for effect in all_effects() if not isinstance(effect, CylinderEffect))
    effects = {effect.name: effect for effect in joints if effect.elements(machine)}
    change = Change(machine)
    effects["backlash"].apply(change, "hinge", {"width": 0.05, "motor_inertia": 0.02})
    effects["command_deadband"].write(change, "drive", {"dead_band": 0.2})
    effects["command_hysteresis"].write(change, "drive", {"hysteresis": 0.3})
    spec = patched(machine, change)
    paths = [p for p in spec.plugins if p.plugin_name == "leglab.command_path"]
    assert len(paths) == 1
    assert {"dead_band", "hysteresis"} <= set(paths[0].config)
    mujoco.MjModel.from_xml_string(compiled_xml(spec))


@pytest.mark.parametrize("compliance", [1e-4, 1e-16])
def test_a_stiff_gear_is_twisted_by_its_torque_times_its_compliance(machines, compliance):
    """J o'' + c o' + k o = tau - J q'' of a slow torque: o = (tau - J q'')/k, however stiff."""
    machine, h = machines["pendulum"], 2e-3
    (effect,) = (e for e in all_effects() if e.name == "joint_flexibility" and e.elements(machine))
    change, t = Change(machine), h * np.arange(1000)
    values = nominal(effect, machine, "hinge") | {"compliance": compliance, "motor_inertia": 0.02}
    effect.apply(change, "hinge", values)
    command, none = np.sin(2.0 * t), np.zeros_like(t)
    measured = Measured(
        period=h,
        position={"hinge": none},
        velocity={"hinge": none},
        piston_velocity={},
        lever={},
        command={"drive": command},
        pressure={},
        samples=np.arange(1000),
    )
    with warnings.catch_warnings(action="error"):
        twist = change.starts["hinge_flexibility", "offset"](measured, change.variant, none)
    torque = drive_torque(measured, change.variant.model, "hinge")(np.arange(1000), none, none)
    assert np.abs(torque).max() > 0.5
    np.testing.assert_allclose(twist, compliance * torque, atol=0.01 * compliance)


def test_no_effect_replaces_another_of_its_name_and_no_element_is_served_twice(machines):
    kinds = {type(effect).__name__ for effect in all_effects() if effect.name == "backlash"}
    assert kinds == {"Backlash", "CylinderBacklash"}
    for machine in machines.values():
        keys = [(e.name, element) for e in all_effects() for element in e.elements(machine)]
        assert len(keys) == len(set(keys))


def test_the_dead_band_of_a_servo_adds_to_that_of_its_path(tmp_path):
    path = command_path(servo_dead_band=0.01, dead_band=0.3)
    (tmp_path / "servo.xml").write_text(pendulum(path, actuator=SERVO))
    machine = Machine(tmp_path / "servo.xml")
    # What the command meets is taken out of replays, what acts beside it stays.
    assert machine.parameter("path", "servo_dead_band") == 0.01
    assert machine.parameter("path", "dead_band") == 0.0
    (effect,) = (e for e in all_effects() if e.name == "command_deadband" and e.elements(machine))
    change = Change(machine)
    effect.apply(change, "drive", {"dead_band": 0.02})
    assert change.parameters == {("path", "servo_dead_band"): pytest.approx(0.03)}
    assert not change.edits
    # Its sizes are those of a joint's travel, and not of its range.
    (band,) = effect.parameters(machine, "drive")
    assert band.trials == pytest.approx((0.004, 0.016, 0.06))
