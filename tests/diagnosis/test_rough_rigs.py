"""Machines with motors that differ from their models, by simulators of another kind."""

import numpy as np
import pytest

from leglab.diagnosis.search.pipeline import DiagnosisSettings
from leglab.diagnosis.verdict.verdict import diagnose
from rigs.agreement import open_loop_error
from rigs.rough import RIGS, SERVO_LINK, as_made, faults_of, hide, machine, record_rough


@pytest.mark.parametrize("name", RIGS)
def test_the_independent_simulator_agrees_with_the_nominal_models(name):
    """Free of leglab altogether: the recorded commands drive the bare model along the recording."""
    rig = RIGS[name]
    quiet = record_rough(rig, [as_made(rig)], seed=0, seconds=1.0)[0]["fast"]
    assert open_loop_error(rig.model, quiet, rig.joints, rig.drives) < 1e-3  # rad, of 0.5 to 1.8


@pytest.mark.parametrize("name", RIGS)
def test_every_fault_moves_the_machine_and_no_two_machines_are_alike(name):
    rig = RIGS[name]
    healthy = machine(rig, np.random.default_rng(1))
    other = machine(rig, np.random.default_rng(2))
    ill = []
    for fault in faults_of(rig):
        values = {key: value.copy() for key, value in healthy.items()}
        hide(rig, values, fault, len(rig.joints) - 1, np.random.default_rng(3))
        ill.append(values)
    first, *others = record_rough(rig, [healthy, other, *ill], seed=0, seconds=1.0)
    joint = f"{rig.joints[-1]}_position"
    drive = f"{rig.drives[-1]}_command"
    for one in others:
        moved = np.abs(one["fast"][joint] - first["fast"][joint]).max()
        driven = np.abs(one["fast"][drive] - first["fast"][drive]).max()
        assert moved > 3e-4 or driven > 3e-3 * rig.torque[-1]


@pytest.mark.slow("whole diagnosis of a rough rig")
def test_the_dead_band_of_a_servo_is_one_of_its_error():
    """Found from recordings of the independent simulator, and no command of zero is special."""
    made = as_made(SERVO_LINK)
    made["dead"][0] = 0.02  # rad
    made["noise"][0] = 3e-5
    (logs,) = record_rough(SERVO_LINK, [made], seed=1, seconds=3.0)
    result, _ = diagnose(SERVO_LINK.model, logs, settings=DiagnosisSettings(threads=1))
    (effect,) = result.effects
    assert result.verdict == "named"
    assert (effect.name, effect.element) == ("command_deadband", "servo")
    assert effect.confidence > 0.95
    assert effect.parameters[0].value == pytest.approx(0.02, rel=0.02)
