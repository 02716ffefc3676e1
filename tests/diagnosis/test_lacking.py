"""Forces that the measured motion leaves over."""

import numpy as np
import pytest

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.replay.lacking import balanced_joints
from leglab.diagnosis.replay.windows import Channel
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.thresholds import FORCE_BLOCKS
from rigs import PENDULUM, Truth, record
from rigs.rough import ROTOR, as_made, record_rough

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
    return problem.replay.lacking(change, chosen)[0]


def test_a_constant_torque_is_left_over_in_every_part_of_every_window(pushed):
    left = lacking(pushed, Hypothesis())
    assert left.shape == (pushed.replay.windows, 1, FORCE_BLOCKS)
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
    both = pushed.replay.error(change, chosen=chosen, forces=True)
    np.testing.assert_array_equal(both.left, lacking(pushed, Hypothesis(), chosen))
    np.testing.assert_array_equal(both.values, pushed.replay.error(change, chosen=chosen).values)


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
