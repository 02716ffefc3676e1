"""Hidden states of play and friction, from the motion, against those of a simulation."""

import mujoco
import numpy as np
import pytest

from leglab import DiagnosisSettings, Recording, diagnose
from leglab._native import hydraulics as native
from leglab.base.recording import SIMULATION
from leglab.diagnosis.effects.backlash import motor_states
from leglab.diagnosis.plant.model import Machine, Measured
from leglab.diagnosis.replay.starts import FLOW, Instances
from tests.helpers.native_models import backlash, friction, pendulum
from tests.helpers.plugin_models import Slots, compiled

H = 1e-3


def swing(xml, element, names, n=3000, pace=1.0, start=0.0):
    """Motion at sample times and plugin states along a swing; velocities as MuJoCo has them."""
    model, data = compiled(xml)
    data.time = start
    slots = Slots(model, data, element)
    rows = []
    for k in range(n):
        data.ctrl[0] = 2.0 * np.sin(7e-3 * pace * k) + np.sin(23e-3 * pace * k)
        before = data.qpos[0], data.qvel[0], data.ctrl[0], *(slots[name] for name in names)
        mujoco.mj_step(model, data)
        rows.append([*before, data.qvel[0]])
    table = np.array(rows).T
    # On a sample the velocity is the mean of those half a step before and after.
    velocity = 0.5 * (table[1] + table[-1])
    measured = Measured(
        period=H,
        position={"hinge": table[0]},
        velocity={"hinge": velocity},
        piston_velocity={},
        lever={},
        command={"drive": table[2]},
        pressure={},
        samples=np.arange(500, n - 10, 37),
        start=start,
    )
    return measured, table[3:-1], model


SERVO = '<position name="drive" joint="hinge" kp="30" kv="1" forcerange="-6 6"/>'


@pytest.mark.parametrize("actuator", ['<motor name="drive" joint="hinge" gear="1.5"/>', SERVO])
def test_the_motor_is_found_in_the_play(actuator):
    width = 0.06
    xml = pendulum(backlash(width=width, stiffness=2e5), actuator=actuator)
    measured, (offset, speed), model = swing(xml, "play", ("offset", "motor_velocity"))
    found, velocity = motor_states(measured, model, "hinge", width, 0.02)
    at = measured.samples
    assert np.abs(offset[at]).min() < 0.4 * width  # some samples lie within the play
    # Impacts fall between samples, so a few are off; the flank itself gives way a little.
    good = np.abs(found - offset[at]) < 0.05 * width
    assert good.mean() > 0.9
    assert np.median(np.abs(velocity - speed[at])[good]) < 0.02
    # Seating by the load alone would put them all on a flank.
    assert np.mean(np.abs(np.abs(found) - width / 2) < 1e-9) < 0.98


# What improved.xml has after several diagnoses: friction by direction and load beside breakaway.
IMPROVED = {
    "joint": "hinge",
    "coulomb": 0.15,
    "static": 0.15,
    "coulomb_difference": 0.2,
    "actuator_load_coefficient": 0.1,
    "bias_load_coefficient": 0.08,
}


def test_friction_in_a_model_starts_with_its_bristle_and_load(tmp_path):
    """With all parameters, sliding, sticking and reversing, at a time when it has drifted."""
    own = {"static": 1.0, "stribeck_velocity": 0.2, "stribeck_exponent": 1.0, "sigma_0": 2e3}
    own |= {"direction_asymmetry": 0.15, "wear": 1.2, "drift_amplitude": 0.3, "drift_period": 9.0}
    xml = pendulum(friction(**IMPROVED | own, sigma_1=20))
    names = ("load", "bristle")
    measured, truth, _ = swing(xml, "friction", names, n=6000, pace=0.3, start=4.0)
    assert 0.1 < np.mean(np.abs(measured.velocity["hinge"]) < 3e-3) < 0.3  # sticks at times
    (tmp_path / "improved.xml").write_text(xml)
    machine = Machine(tmp_path / "improved.xml")
    state = np.tile(machine.base.plugin_state, (measured.samples.size, 1))
    found = Instances(machine=machine, measured=measured, variant=machine.base, state=state)
    found.reconstruct()
    for name, true in zip(names, truth, strict=True):
        error = np.abs(found.get("friction", name) - true[measured.samples])
        # Load is interpolated, and the plugin's is that of the step before.
        assert error.max() < 0.05 * np.abs(true).max(), name
        assert np.median(error) < 0.01 * np.abs(true).max(), name


def test_an_improved_model_lacks_nothing_on_new_recordings(tmp_path):
    """Wrong bristles had left five times the noise, and the diagnosis without an explanation."""
    xml = pendulum(friction(**IMPROVED, sigma_0=200, sigma_1=2))
    (tmp_path / "improved.xml").write_text(xml)
    recordings = {}
    for seed in range(3):
        model, data = compiled(xml)
        rows, rng = [], np.random.default_rng(seed)
        for t in H * np.arange(3500):
            wanted = 1.3 * (np.sin((1.2 + 0.3 * seed) * t) ** 3 + 0.4 * np.sin(4.1 * t) ** 3)
            data.ctrl[0] = np.clip(20.0 * (wanted - data.qpos[0]) - data.qvel[0], -6.0, 6.0)
            rows.append([t, data.qpos[0] + 1e-4 * rng.standard_normal(), data.ctrl[0]])
            mujoco.mj_step(model, data)
        time, position, command = np.array(rows).T
        recordings[f"{seed}"] = Recording(
            time=time,
            columns={"hinge_position": position, "drive_command": command},
            metadata={SIMULATION: {"timestep": H, "integrator": "implicitfast"}},
        )
    effects = ("coulomb_friction", "stiction", "asymmetric_friction", "load_dependent_friction")
    settings = DiagnosisSettings(effects=effects, threads=1)
    result, _ = diagnose(tmp_path / "improved.xml", recordings, held_out=("2",), settings=settings)
    assert result.verdict == "nothing_missing"
    assert result.gap.before < 1.2


def test_the_flow_from_a_supply_changes_with_these_parameters_alone():
    machine = Machine("leg").base
    ((supply, (cylinder, *_)),) = [pair for pair in machine.drawn_by.items() if pair[1]]
    whole = {}
    for element in (supply, cylinder):
        start, table = machine.elements[element]
        whole[element] = machine.plugin_state[start : start + len(table.parameters)].copy()
    walk = np.cumsum(np.random.default_rng(0).normal(size=(3, 1, 400)), axis=2)
    spools, caps, rods = (
        np.clip(0.05 * walk[0], -1.0, 1.0),
        5e6 + 1e5 * walk[1],
        4e6 + 1e5 * walk[2],
    )

    def pressure(parameters):
        out = np.empty(spools.shape[1])
        native.supply_pressure(whole[supply], parameters[None], spools, caps, rods, 2e-3, 4, out)
        return out

    changed = set()
    for i, name in enumerate(machine.elements[cylinder][1].parameters):
        other = whole[cylinder].copy()
        other[i] = 1.1 * other[i] or 0.05
        if (pressure(other) != pressure(whole[cylinder])).any():
            changed.add(name)
    assert changed == set(FLOW)
