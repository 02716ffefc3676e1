"""Machines with motors that differ from their models, by simulators of another kind."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from leglab.diagnosis.rough import rough_search
from leglab.diagnosis.workflow import DiagnosisSettings, set_up
from tests.rigs import PENDULUM, Truth, record
from tests.rigs.rough import RIGS, as_made, faults_of, hide, machine, record_rough

ARMATURE, VISCOUS = ("armature", "hinge"), ("viscous_friction", "hinge")


@pytest.mark.parametrize("name", RIGS)
def test_the_independent_simulator_agrees_with_the_nominal_models(name):
    """Free of leglab altogether: the recorded commands drive the bare model along the recording."""
    rig = RIGS[name]
    quiet = record_rough(rig, [as_made(rig)], seed=0, seconds=1.0)[0]["fast"]
    model = mujoco.MjModel.from_xml_path(str(rig.model))
    model.opt.timestep = 2e-5
    data = mujoco.MjData(model)
    positions = np.stack([quiet[f"{joint}_position"] for joint in rig.joints], axis=1)
    commands = np.stack([quiet[f"{drive}_command"] for drive in rig.drives], axis=1)
    data.qpos[:] = positions[0]
    off = []
    for measured, command in zip(positions, commands, strict=True):
        off.append(measured - data.qpos)
        data.ctrl[:] = command
        mujoco.mj_step(model, data, 50)
    assert np.sqrt(np.mean(np.square(off))) < 1e-3  # rad, of 0.5 to 1.8


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


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"motor": 0.05, "viscous": 0.3}, [ARMATURE, VISCOUS]),
        ({"viscous": 0.3}, [VISCOUS]),
    ],
)
def test_two_effects_are_tried_at_once_and_one_where_that_is_all(changed, expected):
    """Neither of two alone explains the machine; of one, no pair explains more than it costs."""
    rig = replace(PENDULUM, **changed)
    kinds = ("multisine", "fast")
    logs = {k: record(rig, k, Truth(), seed=i, seconds=3.0) for i, k in enumerate(kinds)}
    settings = DiagnosisSettings(
        effects=("armature", "viscous_friction", "quadratic_damping"), threads=1
    )
    problem = set_up(PENDULUM.model, logs, (), settings)
    rng = np.random.default_rng(0)
    *_, fit, named, rounds = rough_search(problem, 1, rng, lambda _: None)
    assert sorted(named) == expected
    assert fit.free == frozenset(expected)
    if len(expected) == 2:
        pair = rounds[-1].contenders
        assert {c.key for c in pair[:2]} == set(expected)
        # Rivals of each, beside the other, challenge them afterwards.
        rivals = {c.key[0]: c.fit.free for c in pair[2:]}
        assert rivals["quadratic_damping"] & frozenset(expected)
