from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leglab.base.errors import LeglabError
from leglab.references import Joint, make_reference, reference_names
from leglab.references.base import REFERENCES
from leglab.references.gait import GAIT

LEG = tuple(Joint(name=name, rest=0.05) for name in GAIT)
BENCH = (Joint(name="knee", rest=0.9, lower=0.0, upper=1.8),)
WALK = Path(__file__).with_name("walk.csv")
SMOOTH = {
    "file": {"file": str(WALK)},
    "walking_stride": {},
    "random_stride": {"seed": 5},
    "squat": {},
    "sine_sweep": {"duration": 6.0, "end_frequency": 3.0},
    "multisine": {"period": 2.5, "motion": 3},
    "step": {"start": 0.3, "hold": 0.7, "rise_time": 0.25},
}


def test_every_reference_is_tested_here():
    assert set(SMOOTH) == set(reference_names())
    assert all(REFERENCES.get(name).summary for name in SMOOTH)


@pytest.mark.parametrize("joints", [LEG, BENCH], ids=["leg", "bench"])
@pytest.mark.parametrize(("name", "config"), SMOOTH.items())
def test_derivatives_are_those_of_the_position(name, config, joints):
    reference = make_reference(name, joints, config)
    times = np.linspace(-0.2, 7.0, 1801)
    h = 1e-5
    before, now, after = (reference.sample(times + shift) for shift in (-h, 0, h))
    velocity = (after.position - before.position) / (2 * h)
    acceleration = (after.velocity - before.velocity) / (2 * h)
    # Central differences are off by h^2/6 of the third derivative, by h/2 of its jumps where
    # quintics meet (60 amplitude/rise^3), and by rounding.
    np.testing.assert_allclose(now.velocity, velocity, atol=2e-7)
    np.testing.assert_allclose(now.acceleration, acceleration, atol=0.01)


@pytest.mark.parametrize(("name", "config"), SMOOTH.items())
def test_acceleration_is_continuous(name, config):
    reference = make_reference(name, LEG, config)

    def largest_jump(step):
        times = np.arange(-0.1, 6.5, step)
        return np.abs(np.diff(reference.sample(times).acceleration, axis=0)).max()

    # A jump would stay as it is when the time step shrinks tenfold; a slope shrinks tenfold.
    assert largest_jump(1e-4) < 0.15 * largest_jump(1e-3)


@pytest.mark.parametrize(("name", "config"), SMOOTH.items())
def test_starts_at_rest(name, config):
    reference = make_reference(name, LEG, config)
    position, velocity, acceleration = reference.sample(np.array([-1.0, 0.0]))
    np.testing.assert_array_equal(position, 0.05)
    np.testing.assert_array_equal(velocity, 0)
    np.testing.assert_array_equal(acceleration, 0)


@pytest.mark.parametrize(("name", "config"), SMOOTH.items())
def test_samples_do_not_depend_on_their_neighbours(name, config):
    reference = make_reference(name, LEG, config)
    times = np.linspace(0, 5, 40)
    together = reference.sample(times)
    for i in (0, 7, 39):
        alone = reference.sample(times[i : i + 1])
        for one, all_ in zip(alone, together, strict=True):
            np.testing.assert_allclose(one[0], all_[i], rtol=1e-12, atol=1e-12)
    again = reference.sample(times)
    assert all((a == b).all() for a, b in zip(together, again, strict=True))


@pytest.mark.parametrize("name", ["walking_stride", "squat"])
def test_repeats_after_its_period(name):
    reference = make_reference(name, LEG)
    times = np.linspace(1.5, 4, 100)
    for one, two in zip(
        reference.sample(times), reference.sample(times + reference.period), strict=True
    ):
        np.testing.assert_allclose(one, two, atol=1e-10)


def test_walking_follows_the_gait_literature():
    """Landmarks of normal gait, Perry and Burnfield 2010, and Winter 2009, within 5 deg."""
    reference = make_reference("walking_stride", LEG, {"knee_bend": 0})
    percent = np.arange(100)
    angle = np.degrees(reference.sample(12 + 0.012 * percent).position)
    curve = dict(zip(GAIT, angle.T, strict=True))
    assert curve["knee"].max() == pytest.approx(60, abs=5)
    assert percent[curve["knee"].argmax()] == pytest.approx(72, abs=3)
    assert curve["knee"][:30].max() == pytest.approx(18, abs=5)  # loading response
    assert curve["hip_pitch"].min() == pytest.approx(-15, abs=5)
    assert percent[curve["hip_pitch"].argmin()] == pytest.approx(52, abs=4)
    assert np.ptp(curve["hip_pitch"]) == pytest.approx(42, abs=5)
    assert curve["ankle_pitch"].max() == pytest.approx(10, abs=5)
    assert curve["ankle_pitch"].min() == pytest.approx(-15, abs=5)
    assert percent[curve["ankle_pitch"].argmin()] == pytest.approx(63, abs=4)
    assert percent[curve["ankle_roll"].argmin()] == pytest.approx(52, abs=4)  # inversion


def test_walking_knee_stays_clear_of_the_end_stop():
    position = make_reference("walking_stride", BENCH).sample(np.linspace(2, 5, 1000)).position
    assert position.min() == pytest.approx(0.1, abs=0.03)
    assert position.max() == pytest.approx(1.1, abs=0.03)


def test_knee_bend_keeps_the_foot_level():
    times = np.linspace(2, 4, 50)
    names = [joint.name for joint in LEG]
    attitude = []
    for bend in (0.0, 0.3):
        angle = make_reference("walking_stride", LEG, {"knee_bend": bend}).sample(times).position
        hip, knee, ankle = (
            angle[:, names.index(name)] for name in ("hip_pitch", "knee", "ankle_pitch")
        )
        attitude.append(hip - knee + ankle)
    np.testing.assert_allclose(*attitude, atol=1e-12)


@settings(max_examples=20)
@given(st.floats(0, 2), st.floats(0.5, 3), st.floats(0, 1))
def test_walking_amplitude_scales_about_the_mean(amplitude, period, phase):
    config = {"amplitude": amplitude, "period": period, "phase": phase}
    joints = (Joint(name="knee"),)
    reference = make_reference("walking_stride", joints, config)
    times = 10 + period * np.arange(200) / 200
    position = reference.sample(times).position[:, 0]
    mean = np.radians(GAIT["knee"].mean) + 0.08
    assert position.mean() == pytest.approx(mean)
    full = make_reference("walking_stride", joints, {**config, "amplitude": 1.0})
    np.testing.assert_allclose(
        position - mean, amplitude * (full.sample(times).position[:, 0] - mean), atol=1e-12
    )


def test_order_of_joints_is_the_order_of_columns():
    times = np.linspace(0, 3, 30)
    forward = make_reference("walking_stride", LEG).sample(times).position
    backward = make_reference("walking_stride", LEG[::-1]).sample(times).position
    np.testing.assert_allclose(forward, backward[:, ::-1], atol=1e-14)


def test_other_joints_stay_at_rest():
    joints = (*BENCH, Joint(name="elbow", rest=0.4))
    for name in ("walking_stride", "squat"):
        samples = make_reference(name, joints).sample(np.linspace(0, 5, 50))
        np.testing.assert_array_equal(samples.position[:, 1], 0.4)
        assert np.ptp(samples.position[:, 0]) > 0.5
        with pytest.raises(LeglabError, match="none of which is among the joints elbow"):
            make_reference(name, joints[1:])


def test_squat_reaches_its_depth():
    samples = make_reference("squat", LEG, {"depth": 1.0, "period": 2.0}).sample(np.array([3.0]))
    bends = dict(zip(GAIT, samples.position[0] - 0.05, strict=True))
    assert bends["knee"] == pytest.approx(1.0)
    assert bends["hip_pitch"] == bends["ankle_pitch"] == pytest.approx(0.5)
    assert bends["hip_roll"] == 0


def test_sweep_covers_its_frequencies():
    config = {"start_frequency": 0.5, "end_frequency": 4.0, "duration": 30.0, "amplitude": 0.2}
    reference = make_reference("sine_sweep", BENCH, config)
    times = np.arange(0, 40, 0.001)
    position = reference.sample(times).position[:, 0] - 0.9
    assert np.abs(position).max() == pytest.approx(0.2, rel=1e-3)
    assert (position[times > 30] == 0).all()
    crossings = times[1:][np.diff(np.sign(position)) != 0]
    for now, expected in [(5, 0.5 * 8 ** (5 / 30)), (25, 0.5 * 8 ** (25 / 30))]:
        i = np.searchsorted(crossings, now)
        assert 0.5 / (crossings[i] - crossings[i - 1]) == pytest.approx(expected, rel=0.1)


def test_true_step_has_no_ramp():
    config = {"start": 1.0, "hold": 0.5, "rise_time": 0, "amplitude": -0.3}
    times = np.array([0.99, 1.0, 1.2, 1.49, 1.51, 1.99, 2.01])
    samples = make_reference("step", BENCH, config).sample(times)
    expected = 0.9 + np.array([0, -0.3, -0.3, -0.3, 0, 0, -0.3])
    np.testing.assert_allclose(samples.position[:, 0], expected)
    assert not samples.velocity.any()


@pytest.mark.parametrize("name", ["step", "sine_sweep", "multisine"])
def test_excitation_of_chosen_joints(name):
    samples = make_reference(name, LEG, {"joints": ["knee"]}).sample(np.linspace(0, 5, 99))
    moved = np.ptp(samples.position, axis=0) > 0.1
    assert [joint.name for joint, m in zip(LEG, moved, strict=True) if m] == ["knee"]
    np.testing.assert_array_equal(samples.position[:, ~moved], 0.05)


@pytest.mark.parametrize(
    ("name", "joints", "config", "message"),
    [
        ("walk", BENCH, {}, "unknown reference 'walk': choose one of"),
        ("squat", (), {}, "reference 'squat' needs at least one joint"),
        ("squat", BENCH, {"depht": 1}, "unknown setting of reference 'squat' 'depht'"),
        ("squat", BENCH, {"period": 0}, "setting 'period' is 0: input should be greater than 0"),
        ("step", BENCH, {"rise_time": 2}, "rise_time 2 s must not exceed hold 1 s"),
        ("step", BENCH, {"joints": ["hip"]}, "unknown joint of reference 'step' 'hip'"),
        ("sine_sweep", BENCH, {"fade": 15}, "fade 15 s must not exceed half"),
        ("sine_sweep", BENCH, {"end_frequency": 0.2}, "end_frequency 0.2 Hz must differ"),
    ],
)
def test_bad_settings(name, joints, config, message):
    with pytest.raises(LeglabError, match=message):
        make_reference(name, joints, config)


def test_range_is_checked():
    reference = make_reference("squat", BENCH, {"depth": 1.2})
    told = r"'squat': joint 'knee' goes to 1\.\d+ rad at .* s, its range is \[0, 1.8\] rad"
    with pytest.raises(LeglabError, match=told):
        reference.sample(np.linspace(0, 3, 100))


def test_speed_is_checked():
    joints = (Joint(name="hip_pitch"), Joint(name="knee", velocity_limit=2.0))
    with pytest.raises(LeglabError, match=r"joint 'knee' moves at -?\d.* its limit is 2 rad/s"):
        make_reference("walking_stride", joints).sample(np.linspace(0, 3, 300))


def test_bad_joints_and_times():
    with pytest.raises(LeglabError, match=r"joint 'knee': rest position 2 rad is outside \[0, 1"):
        Joint(name="knee", rest=2, lower=0, upper=1)
    with pytest.raises(LeglabError, match="velocity limit 0 rad/s is not > 0"):
        Joint(name="knee", velocity_limit=0)
    with pytest.raises(LeglabError, match=r"shape \(\)"):
        make_reference("squat", BENCH).sample(1.0)


def test_a_random_stride_is_reproducible_and_does_not_repeat():
    times = np.arange(0, 60, 0.01)

    def positions(**config):
        return make_reference("random_stride", LEG, config).sample(times).position

    np.testing.assert_array_equal(positions(seed=3), positions(seed=3))
    seeded = make_reference("random_stride", LEG, seed=3)
    np.testing.assert_array_equal(seeded.sample(times).position, positions(seed=3))
    own = make_reference("random_stride", LEG, {"seed": 3}, seed=4)
    np.testing.assert_array_equal(own.sample(times).position, positions(seed=3))
    make_reference("squat", LEG, seed=4)  # not random: the seed does not matter
    assert np.abs(positions(seed=3) - positions(seed=4)).max() > 0.1
    knee = positions(seed=3)[:, list(GAIT).index("knee")]
    # Whatever the lag between one and twenty strides, the motion is another one.
    part = knee[500:2000]
    differences = [np.std(knee[500 + lag : 2000 + lag] - part) for lag in range(90, 2400)]
    assert min(differences) > 0.1 * np.std(part)


@pytest.mark.parametrize("seed", range(8))
def test_a_random_stride_stays_within_the_regular_one(seed):
    """Deviations from the mean only shrink, speeds grow by the rate and the amplitude's change."""
    times = np.arange(2.0, 60, 0.005)
    regular = make_reference("walking_stride", LEG, {}).sample(times)
    random = make_reference("random_stride", LEG, {"seed": seed}).sample(times)
    tolerance = 1e-3  # [rad], the regular stride is sampled
    assert np.all(random.position.max(axis=0) <= regular.position.max(axis=0) + tolerance)
    assert np.all(random.position.min(axis=0) >= regular.position.min(axis=0) - tolerance)
    fastest = np.abs(regular.velocity).max(axis=0)
    assert np.all(np.abs(random.velocity).max(axis=0) <= 1.5 * fastest)


def test_a_random_stride_without_variation_is_the_walking_stride():
    times = np.arange(0, 6, 0.01)
    still = {"amplitude_variation": 0.0, "period_variation": 0.0}
    random = make_reference("random_stride", LEG, still).sample(times)
    regular = make_reference("walking_stride", LEG).sample(times)
    for ours, theirs in zip(random, regular, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_multisine_stays_within_range_speed_and_acceleration_and_reaches_one_of_them():
    joints = (
        Joint(name="wide", rest=0.0, lower=-3.0, upper=3.0, velocity_limit=2.0),
        Joint(name="at_its_stop", rest=1.0, lower=-0.2, upper=1.0, velocity_limit=50.0),
        Joint(name="slow", rest=0.1, lower=0.0, upper=0.4, velocity_limit=0.2),
        Joint(name="free"),
    )
    settings = {"amplitude": 0.4, "speed": 0.25, "period": 3.0}
    motion = make_reference("multisine", joints, settings)
    assert motion.period == 3.0
    times = np.arange(2.0, 5.0, 1e-4)  # a period, after the start
    position, velocity, acceleration = motion.sample(times)
    np.testing.assert_allclose(motion.sample(times + 3.0).position, position, atol=1e-12)
    for i, joint in enumerate(joints[:3]):
        width = joint.upper - joint.lower
        shares = (
            np.ptp(position[:, i]) / (0.4 * width),  # peak to peak: below twice the amplitude
            np.abs(velocity[:, i]).max() / (0.25 * joint.velocity_limit),
            np.abs(acceleration[:, i]).max() / (0.25 * joint.velocity_limit**2 / width),
        )
        assert max(shares) <= 1.001, joint.name
        assert max(shares) > 0.7, joint.name
        assert joint.lower <= position[:, i].min() <= position[:, i].max() <= joint.upper
    assert np.abs(position[:, 3]).max() == pytest.approx(0.2, rel=1e-3)
    other = make_reference("multisine", joints, {**settings, "motion": 1}).sample(times)
    assert np.abs(other.position - position).max() > 0.05
    shifted = make_reference("multisine", joints, {**settings, "phase": 0.25})
    np.testing.assert_allclose(
        shifted.sample(times).position, motion.sample(times + 0.75).position, atol=1e-12
    )


def test_a_file_is_played_in_its_units_and_repeats_where_it_closes():
    played = {"file": str(WALK), "lead": 0.5}
    once = make_reference("file", LEG, played)
    knee = list(GAIT).index("knee")
    # To the first sample in 0.5 s, then the clock of the file starts: it loses half of its lead.
    assert once.sample(np.array([0.5])).position[0, knee] == pytest.approx(np.radians(20))
    assert once.sample(np.array([1.75])).position[0, knee] == pytest.approx(
        np.radians(60), abs=1e-3
    )
    end = once.sample(np.array([3.0, 99.0]))
    assert end.position[:, knee] == pytest.approx(np.radians([20, 20]))
    assert not end.velocity.any()
    assert (once.sample(np.array([1.3])).position[0, list(GAIT).index("hip_yaw")]) == 0.05
    around = make_reference("file", LEG, {**played, "repeat": True})
    assert around.period == pytest.approx(2.0)
    times = np.linspace(1.5, 4, 100)
    for one, two in zip(around.sample(times), around.sample(times + 2.0), strict=True):
        np.testing.assert_allclose(one, two, atol=1e-9)
    direct = make_reference("file", LEG, {"file": str(WALK), "lead": 0}).sample(np.array([1.3]))
    assert direct.position[0, knee] == pytest.approx(
        np.radians(40 - 20 * np.cos(1.3 * np.pi) + 2 * np.sin(5.2 * np.pi)), abs=1e-3
    )


def test_smoothing_takes_noise_out_of_a_file(tmp_path):
    rng, t = np.random.default_rng(0), np.arange(0, 4, 0.005)
    wave = 0.9 + 0.3 * np.sin(2 * np.pi * t)
    rows = [f"{a},{b}" for a, b in zip(t, wave + 1e-3 * rng.normal(size=len(t)), strict=True)]
    noisy = tmp_path / "noisy.csv"
    noisy.write_text("time,knee\n" + "\n".join(rows))
    at = np.arange(0.5, 3.5, 0.001)
    wanted = -0.3 * (2 * np.pi) ** 2 * np.sin(2 * np.pi * at)

    def error(**config):
        found = make_reference("file", BENCH, {"file": str(noisy), "lead": 0, **config})
        return np.std(found.sample(at).acceleration[:, 0] - wanted)

    assert error(smooth=True) < 0.1 * np.std(wanted) < 5 * np.std(wanted) < error()


def test_a_file_that_cannot_be_played_is_refused(tmp_path):
    def refused(content, **config):
        file = tmp_path / "motion.csv"
        file.write_text(content)
        with pytest.raises(LeglabError) as caught:
            make_reference("file", BENCH, {"file": str(file), **config})
        return str(caught.value)

    rows = "\n".join(f"{t},{t / 10}" for t in range(6))
    assert "knee_position" in refused(f"time,kne\n{rows}")
    assert "bar" in refused(f"time,knee [bar]\n{rows}")
    assert "repeat" in refused(f"time,knee\n{rows}", repeat=True)
    assert "changed" in refused(f"time,knee\n{rows}", digest="0")
    assert "3 s" in refused(f"time,knee\n{rows}".replace("3,0.3", "3,"))
    assert "5 or more" in refused("time,knee\n0,0.1\n1,0.2")
    with pytest.raises(LeglabError, match="--reference FILE"):
        make_reference("file", BENCH)
