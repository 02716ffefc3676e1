"""Forces that the measured motion leaves over, and what they say beside replays."""

import numpy as np
import pytest

from leglab.diagnosis.balance.lacking import balanced_joints
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.former.discrepancy import from_errors
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.replay.residual import whitened
from leglab.diagnosis.replay.windows import Channel
from tests.rigs import PENDULUM, Truth, record
from tests.rigs.rough import ROTOR, as_made, record_rough

PUSH = 0.6  # N m, a tenth of what gravity does at most
OFFSET = ("force_offset", "hinge")


def problem_of(truth, **settings):
    logs = {k: record(PENDULUM, k, truth, seed=3, seconds=3.0) for k in ("multisine", "fast")}
    chosen = DiagnosisSettings(threads=1, **settings)
    return set_up(PENDULUM.model, logs, ("fast",), chosen)


@pytest.fixture(scope="module")
def pushed():
    """A pendulum with a constant torque that its model lacks."""
    return problem_of(Truth(offset=PUSH))


def lacking(problem, hypothesis, chosen=None):
    change = problem.library.change(hypothesis, problem.replay.machine)
    return problem.replay.lacking(change, chosen, problem.thresholds.force_blocks)


def test_a_constant_torque_is_left_over_in_every_part_of_every_window(pushed):
    left = lacking(pushed, Hypothesis())
    assert left.shape == (pushed.replay.windows, 1, pushed.thresholds.force_blocks)
    assert left.mean() == pytest.approx(PUSH, rel=0.02)
    # Velocities, smoothed over 21 ms, are known to some mrad/s; the inertia is 0.12 kg m^2.
    assert left.std() < 0.1 * PUSH
    with_it = lacking(pushed, Hypothesis({OFFSET: np.array([PUSH])}))
    np.testing.assert_allclose(with_it, left - PUSH, atol=1e-6)


def test_only_the_chosen_windows_are_looked_at(pushed):
    chosen = np.arange(pushed.replay.windows) % 3 == 0
    some = lacking(pushed, Hypothesis(), chosen)
    np.testing.assert_allclose(some, lacking(pushed, Hypothesis())[chosen])


def test_forces_come_with_a_replay_as_they_come_alone(pushed):
    change = pushed.library.change(Hypothesis(), pushed.replay.machine)
    chosen = np.arange(pushed.replay.windows) % 2 == 0
    blocks = pushed.thresholds.force_blocks
    both = pushed.replay.error(change, chosen=chosen, blocks=blocks)
    np.testing.assert_array_equal(both.left, lacking(pushed, Hypothesis(), chosen))
    np.testing.assert_array_equal(both.values, pushed.replay.error(change, chosen=chosen).values)


def test_forces_count_as_much_as_replays_once_the_model_is_not_exact(pushed):
    bins = pushed.replay.bins
    assert pushed.size == bins
    assert pushed.numbers == pushed.thresholds.rough_numbers
    trusting = pushed.trusting(pushed.discrepancy(Hypothesis()))
    blocks = pushed.thresholds.force_blocks
    assert trusting.size == bins + blocks
    assert trusting.numbers == 2.0 * pushed.thresholds.rough_numbers
    assert trusting.with_nuisances((), worth=30.0).worth == 60.0
    chosen = trusting.fitted
    white = trusting.residual(Hypothesis(), chosen)
    left = whitened(trusting.noise.forces[chosen], lacking(pushed, Hypothesis(), chosen))
    scale = np.sqrt(0.5 * trusting.size / blocks)
    np.testing.assert_allclose(white[:, bins:], scale * left)
    # Errors of their own usual size give both halves of the cost alike.
    replays, forces = (
        np.median((part**2).sum(axis=1)) for part in (white[:, :bins], white[:, bins:])
    )
    assert forces == pytest.approx(replays, rel=0.3)


def test_a_step_is_whitened_anew_as_a_whole(pushed):
    before = pushed.trusting(pushed.discrepancy(Hypothesis()))
    now = pushed.trusting(pushed.discrepancy(Hypothesis({OFFSET: np.array([PUSH])})))
    chosen = pushed.fitted
    turned = whitened(now.turn_from(before, chosen), before.residual(Hypothesis(), chosen))
    np.testing.assert_allclose(turned, now.residual(Hypothesis(), chosen), rtol=1e-6, atol=1e-6)


def test_variances_of_forces_go_with_those_of_replays():
    errors = np.random.default_rng(0).normal(size=(40, 1, 4))
    recording = np.repeat([0, 1], 20)
    errors[recording == 1] *= 3.0
    one = from_errors(errors, recording, np.ones((2, 1)), np.eye(1))
    both = from_errors(errors, recording, np.ones((2, 1)), np.eye(1))
    whole = type(one)(
        directions=one.directions, pattern=one.pattern, variance=one.variance, forces=both
    )
    other = whole.of([1, 1, 0])
    np.testing.assert_array_equal(other.forces.variance, both.variance[[1, 1, 0]])
    high = whole.at_least(whole.of([1, 0]))
    assert (high.forces.variance == both.variance.max()).all()
    assert (high.variance == one.variance.max()).all()
    assert whole.at_least(None) is whole


def test_a_cylinder_without_pressures_hides_its_joints_forces():
    machine = Machine("knee_bench")
    names = ("knee_position", "knee_pressure_a", "knee_pressure_b")
    seen = [Channel(column=name, joint="knee") for name in names]
    assert balanced_joints(machine, seen) == ("knee",)
    assert balanced_joints(machine, seen[:2]) == ()


@pytest.fixture(scope="module")
def rotor():
    """A rotor as its model has it, with a constant torque."""
    made = as_made(ROTOR)
    made["force"] += 0.1
    (logs,) = record_rough(ROTOR, [made], seed=3, seconds=3.0)
    logs = {kind: logs[kind] for kind in ("multisine", "fast")}
    return set_up(ROTOR.model, logs, ("fast",), DiagnosisSettings(threads=1))


def test_hypotheses_that_err_alike_in_every_motion_leave_the_same_over(rotor):
    """Half the drive and friction, twice the inertia, or an encoder that tells half the motion."""
    values = {key[0]: site.nominal for key, site in rotor.library.sites.items()}
    keys = {key[0]: key for key in rotor.library.sites}

    def left(**changed):
        told = {keys[name]: np.array([value]) for name, value in changed.items()}
        return lacking(rotor, Hypothesis(told))

    damping, coulomb = float(values["viscous_friction"][0]), float(values["coulomb_friction"][0])
    weak = left(actuator_gain=0.5, viscous_friction=0.5 * damping, coulomb_friction=0.5 * coulomb)
    inertia = ROTOR.armature[0] + ROTOR.links[0][2]
    heavy = left(armature=ROTOR.armature[0] + inertia)
    short = left(encoder_scale=0.5, viscous_friction=0.5 * damping)
    size = np.abs(heavy).mean()
    np.testing.assert_allclose(weak, heavy, atol=0.01 * size)
    np.testing.assert_allclose(short, heavy, atol=0.01 * size)
    # And none of them is what the model itself leaves over.
    assert np.abs(heavy - left()).mean() > 0.3 * size
