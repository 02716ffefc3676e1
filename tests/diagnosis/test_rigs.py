"""Machines without hydraulics: what an independent simulator hid in them is named."""

import numpy as np
import pytest

from leglab.diagnosis.improve import write_improved
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.verdict.verdict import diagnose
from rigs import PENDULUM, SLIDE_AXIS, Truth, record
from rigs.agreement import open_loop_error
from tests.helpers.unpleasant import of_kinds

KINDS = ("multisine", "fast", "slow", "stairs")


def verdict(rig, truth, held_out="multisine"):
    return diagnose(rig.model, of_kinds(rig, truth, KINDS, seconds=6.0), held_out=(held_out,))


def values(result):
    return {p.name: p.value for p in result.effects[0].parameters}


@pytest.mark.parametrize("rig", [SLIDE_AXIS, PENDULUM])
def test_the_independent_simulator_agrees_with_the_nominal_models(rig):
    """Free of leglab altogether: the recorded command drives the bare model along the recording."""
    quiet = record(rig, "fast", Truth(), seed=1, seconds=1.0)
    # MuJoCo's friction loss yields a little where the slide turns round.
    assert open_loop_error(rig.model, quiet, (rig.joint,), ("drive",)) < 1e-3 * rig.reach


@pytest.mark.slow("whole diagnosis of a rig with all effects")
def test_direction_dependent_friction_of_a_motor_driven_axis_is_named(tmp_path):
    result, found = verdict(SLIDE_AXIS, Truth(forward=8.0, viscous_factor=1.05))
    assert result.verdict == "named"
    assert [effect.name for effect in result.effects] == ["asymmetric_friction"]
    assert "force_offset" not in result.effects[0].indistinguishable_from
    friction = values(result)
    difference = friction["viscous_forward"] - friction["viscous_backward"]
    # The joint's own damping, known to 10 % of 6 N s/m, may take part of both.
    assert difference == pytest.approx(8.0, rel=0.05)
    assert result.gap.closed_fraction > 0.9
    improved = Machine(write_improved(found, tmp_path))
    written = improved.parameter("axis_asymmetric_friction", "viscous_difference")
    assert written == pytest.approx(difference, rel=1e-6)


@pytest.mark.slow("whole diagnosis of a rig with all effects")
@pytest.mark.parametrize(
    ("rig", "truth", "name", "sizes"),
    [
        (SLIDE_AXIS, Truth(offset=2.0), "force_offset", {"force": 2.0}),
        (PENDULUM, Truth(gear_loss=0.15), "load_dependent_friction", {"actuator": 0.15, "bias": 0}),
        (PENDULUM, Truth(play=0.03), "backlash", {"width": 0.03}),
    ],
)
def test_a_single_fault_of_a_motor_driven_machine_is_named(rig, truth, name, sizes):
    result, _ = verdict(rig, truth)
    assert [effect.name for effect in result.effects] == [name]
    for parameter, size in sizes.items():
        assert values(result)[parameter] == pytest.approx(size, rel=0.05, abs=0.0 if size else 0.01)
    assert result.gap.closed_fraction > 0.9


@pytest.mark.xfail(
    strict=True, reason="told compliance and inertia are beyond 30 % of the true ones"
)
@pytest.mark.slow("whole diagnosis of a rig with all effects")
def test_a_soft_gear_of_a_pendulum_is_named():
    result, _ = verdict(PENDULUM, Truth(soft=(60.0, 0.3)))
    assert result.effects[0].name == "joint_flexibility"
    found = values(result)
    assert found["compliance"] == pytest.approx(1.0 / 60.0, rel=0.3)
    assert found["motor_inertia"] == pytest.approx(0.02, rel=0.3)
    assert result.gap.closed_fraction > 0.9


@pytest.mark.slow("whole diagnosis of a rig with all effects")
@pytest.mark.parametrize(
    ("rig", "size", "period", "second"),
    [(SLIDE_AXIS, 2.0, 0.031, 0.0), (PENDULUM, 0.2, 0.9, 0.35)],
)
def test_a_force_that_repeats_with_the_position_is_named_with_its_period(rig, size, period, second):
    result, _ = verdict(rig, Truth(ripple=(size, period, 0.7), second=second))
    assert [effect.name for effect in result.effects] == ["cogging"]
    found = values(result)
    assert found["period"] == pytest.approx(period, rel=0.03)
    assert np.hypot(found["sine"], found["cosine"]) == pytest.approx(size, rel=0.05)
    shares = np.hypot(found["second_sine"], found["second_cosine"])
    assert shares == pytest.approx(second, abs=0.05)
    assert result.gap.closed_fraction > 0.9


@pytest.mark.slow("whole diagnosis of a rig with all effects")
@pytest.mark.parametrize("rig", [SLIDE_AXIS, PENDULUM])
def test_a_good_machine_within_its_tolerance_lacks_nothing(rig):
    result, _ = verdict(rig, Truth(viscous_factor=1.05))
    assert result.verdict == "nothing_missing"
    assert result.effects == ()


@pytest.mark.slow("whole diagnosis of a rig with all effects")
def test_backlash_is_named_where_the_held_out_recording_shows_it_twice():
    """A slow swing changes the sign of the torque in two windows; none of the others gets worse."""
    result, _ = verdict(PENDULUM, Truth(play=0.03), "slow")
    assert [effect.name for effect in result.effects] == ["backlash"]
