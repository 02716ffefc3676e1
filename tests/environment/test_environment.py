"""The environment: dm_env's own contract, the runner's bits, the machine's state, Gymnasium."""

import os
import re
import subprocess
import sys
import textwrap
import warnings
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest
from absl.testing import absltest
from dm_control.rl import control
from dm_env import test_utils
from gymnasium.utils.env_checker import check_env

import leglab.environment
from leglab import RunSettings, run_scenario
from leglab.base.errors import LeglabError
from leglab.base.scenario import scenario_names
from leglab.machine.cylinder import Cylinder

KNEE = {"model": "knee_bench", "duration": 0.2}
ROOT = Path(__file__).parents[2]


def load(scenario: str = "seal_wear", **settings):
    return leglab.environment.load(scenario, **{**KNEE, **settings})


def episode(env, action=0.0) -> dict[str, np.ndarray]:
    """True positions and plugin states at every observation, commands, rewards."""
    step = env.reset()
    data = env.physics.data
    shape = env.action_spec().shape
    rows = {"qpos": [data.qpos.copy()], "plugin_state": [data.plugin_state.copy()]}
    rows |= {"command": [], "reward": [], "observation": [step.observation]}
    while not step.last():
        step = env.step(np.full(shape, action))
        rows["qpos"].append(data.qpos.copy())
        rows["plugin_state"].append(data.plugin_state.copy())
        rows["command"].append(data.ctrl.copy())
        rows["reward"].append(step.reward)
        rows["observation"].append(step.observation)
    rows["discount"] = [step.discount]
    return {name: np.array(values) for name, values in rows.items()}


class ValveEnvironment(test_utils.EnvironmentTestMixin, absltest.TestCase):
    def make_object_under_test(self):
        return load()

    def make_action_sequence(self):
        spec = self.environment.action_spec()
        random = np.random.default_rng(0)
        for _ in range(150):  # past the end of the episode
            yield random.uniform(-0.05, 0.05, spec.shape)


class ResidualEnvironment(ValveEnvironment):
    def make_object_under_test(self):
        return load(action="residual", randomize={"severity": (2.0, 50.0), "onset": (0.0, 0.2)})


class FlatEnvironment(ValveEnvironment):
    def make_object_under_test(self):
        return load(flat_observation=True)


@pytest.mark.parametrize(
    "settings",
    [
        {"scenario": "seal_wear", "model": "leg", "controller": "static_feedforward"},
        {"scenario": "sensor_dropout", "model": "leg", "controller": "static_feedforward"},
        {"scenario": "payload", "model": "leg", "controller": "bsnn_arx", "tolerance": 0.1},
        {"scenario": "nominal", "model": "leg_rail", "controller": "pd", "reference": "squat"},
        {"scenario": "cold_oil", "model": "knee_bench", "controller": "adaptive_backstepping"},
    ],
    ids=lambda settings: settings["scenario"],
)
def test_zero_residual_is_the_run_bit_for_bit(settings):
    settings = {**settings, "duration": 0.6, "seed": 3}
    run = run_scenario(RunSettings(**settings))
    env = leglab.environment.load(action="residual", **settings)
    assert isinstance(env, control.Environment)
    for _ in range(2):  # the second episode starts from a used machine
        rows = episode(env)
        joints = [env.physics.model.joint(name).qposadr[0] for name in run.joints]
        np.testing.assert_array_equal(rows["qpos"][:, joints], run.history.position)
        np.testing.assert_array_equal(rows["command"], run.history.command[:-1])
        assert rows["discount"] == 1.0  # the end of time, not of the leg
    pressure = run.history.states[f"{run.joints[0]}_pressure_a"]
    assert np.ptp(pressure) > 1e4  # it did move


def test_the_scenario_happens_to_the_plugins_state():
    env = load("seal_wear", severity=20.0)
    rows = episode(env)
    slot = env.task._simulation.slot("knee_valve", "internal_leakage")
    leakage = rows["plugin_state"][:, slot]
    np.testing.assert_allclose(leakage[[0, 40, 60, -1]], [1.7e-13, 1.7e-13, 3.4e-12, 3.4e-12])
    env.reset()
    assert env.physics.data.plugin_state[slot] == leakage[0]


def test_oil_warms_up_in_an_episode_and_is_cold_again_in_the_next():
    env = load("cold_start", duration=0.6, action="residual")
    slot = env.task._simulation.slot("knee_valve", "oil_temperature")
    first, second = episode(env), episode(env)
    warmth = first["plugin_state"][:, slot]
    assert warmth[0] == 0.0 < warmth[-1] < 1.0
    np.testing.assert_array_equal(first["plugin_state"], second["plugin_state"])


def test_state_and_copies_of_the_physics_hold_the_plugins():
    env = load()
    env.reset()
    for _ in range(60):
        env.step([0.05])
    physics = env.physics
    snapshot, copy = physics.get_state(), physics.copy()
    assert snapshot.size == physics.data.qpos.size + physics.data.qvel.size + (
        physics.data.act.size + physics.data.plugin_state.size
    )
    np.testing.assert_array_equal(copy.get_state(), snapshot)
    copy.set_control(physics.control())
    copy.step(round(env.control_timestep() / physics.timestep()))
    assert np.any(copy.data.plugin_state != physics.data.plugin_state)
    np.testing.assert_array_equal(physics.get_state(), snapshot)  # the copy is one
    env.step([physics.control()[0]])
    np.testing.assert_array_equal(copy.data.plugin_state, physics.data.plugin_state)
    physics.set_state(snapshot)
    np.testing.assert_array_equal(physics.get_state(), snapshot)


def test_same_seed_same_episodes_and_other_seed_others():
    def observed(**settings) -> np.ndarray:
        env = load(flat_observation=True, **settings)
        rows = [episode(env, 0.01)["observation"] for _ in range(2)]
        return np.array([[row["observations"] for row in each] for each in rows])

    fixed, again, other = observed(), observed(), observed(seed=1)
    np.testing.assert_array_equal(fixed, again)
    np.testing.assert_array_equal(fixed[0], fixed[1])
    assert np.any(fixed != other)
    random, repeated = (observed(randomize={}) for _ in range(2))
    np.testing.assert_array_equal(random, repeated)
    assert np.any(random[0] != random[1])


def test_randomised_episodes_stay_in_their_ranges_and_can_be_run_again():
    ranges = {"severity": (2.0, 50.0), "onset": (0.05, 0.15), "ramp_duration": (0.0, 0.05)}
    env = load(action="residual", randomize=ranges)
    drawn = []
    for _ in range(4):
        env.reset()
        drawn.append(env.task.episode)
    assert len({each.settings.seed for each in drawn}) == 4
    for each in drawn:
        assert 2.0 <= each.settings.severity <= 50.0
        assert 0.05 <= each.onset <= 0.15
        (change,) = each.scenario().changes
        assert (change.start, change.value) == (each.onset, each.settings.severity)
    env = load(action="residual", randomize=lambda random: {"severity": random.choice([5.0, 7.0])})
    rows = episode(env)
    run = run_scenario(env.task.episode.settings)
    np.testing.assert_array_equal(rows["qpos"], run.history.position)


def test_observations_are_named_and_within_their_bounds():
    leg = {"action": "residual", "model": "leg", "preview": (0.0, 0.01), "duration": 0.1}
    env = load(**leg, normalize=False)
    step = env.reset()
    spec = env.observation_spec()
    assert list(step.observation) == list(spec)
    assert step.observation["reference_preview"].shape == (2, 6)
    np.testing.assert_array_equal(
        step.observation["reference_preview"][0], step.observation["reference_position"]
    )
    rows = episode(env, 0.5)["observation"]
    for earlier, later in zip(rows[:-5], rows[5:], strict=True):
        np.testing.assert_array_equal(earlier["reference_preview"][1], later["reference_position"])
    assert 1e5 < rows[-1]["pressure_a"].min() < rows[-1]["supply_pressure"][0] < 3e7
    np.testing.assert_allclose(rows[-1]["position"], env.physics.position(), atol=1e-2)
    assert np.any(rows[-1]["previous_command"] != rows[-1]["controller_command"])
    # Scaled, all is about one, and the same motion.
    scaled = load(**leg)
    last = episode(scaled, 0.5)["observation"][-1]
    for name, spec in scaled.observation_spec().items():
        assert np.isfinite([spec.minimum, spec.maximum]).all()
        assert 1e-3 < np.abs(last[name]).max() <= 2.0, name
        spec.validate(last[name])
    low, high = env.physics.model.ptr.jnt_range.T
    np.testing.assert_allclose(
        (high + low) / 2 + (high - low) / 2 * last["position"], rows[-1]["position"], atol=1e-6
    )
    np.testing.assert_allclose(last["supply_pressure"], 1.0, atol=0.1)


def test_an_action_of_one_adds_the_residual_scale_and_valves_clip():
    zero, one = (
        episode(load(action="residual", residual_scale=0.05), action)["command"]
        for action in (0.0, 1.0)
    )
    assert one[0] - zero[0] == pytest.approx(0.05)
    assert episode(load(action="residual", residual_scale=2.0), 1.0)["command"].max() == 1.0
    assert np.all(episode(load(action="valve"), 0.03)["command"] == 0.03)


@pytest.mark.parametrize("share", [0.3, -0.3])
def test_a_torque_is_what_the_cylinder_gives(share):
    env = load("nominal", action="torque", model="knee_bench")
    simulation = env.task._simulation
    (sheet,) = (simulation.cylinder_parameters(name) for name in simulation.actuators)
    area = np.array(Cylinder(sheet).native.areas())
    env.reset()
    found = []
    for _ in range(60):
        env.step([share])
        state = simulation.data.plugin_state
        pressure = [state[simulation.slots(f"pressure_{side}")][0] for side in "ab"]
        force = pressure @ (area * [1, -1])
        found.append(force * simulation.levers()[0] / env.task.torque_limit[0])
    np.testing.assert_allclose(np.mean(found[20:]), share, rtol=0.1)


def test_rewards_are_in_range_fall_with_the_error_and_can_be_replaced():
    good = episode(load(action="residual"))["reward"]
    bad = episode(load(), 0.3)["reward"]
    assert np.all((good >= 0) & (good <= 1))
    assert np.all((bad >= 0) & (bad <= 1))
    assert good.mean() > 0.8 > 0.05 > bad[-1]
    random = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 6))
    env = load(model="leg", duration=1.0)
    env.reset()
    rewards = [env.step(action).reward for action in random]
    assert min(rewards) > 1e-3
    smooth = episode(load(action="residual", reward="smooth_tracking"))["reward"]
    assert np.all(smooth <= good)
    assert np.any(smooth < good)
    env = load(reward=lambda transition: -float(np.sum(transition.error**2)))
    rows = episode(env, 0.1)
    transition = env.task.transition()
    assert rows["reward"][-1] == -np.sum(transition.error**2)
    assert transition.action == transition.command == 0.1
    np.testing.assert_array_equal(transition.position, rows["qpos"][-1])


def test_an_error_beyond_the_limit_terminates():
    env = load(error_limit=0.05, duration=2.0)
    rows = episode(env, 1.0)
    assert rows["discount"] == 0.0
    assert abs(env.task.transition().error[0]) > 0.05
    assert len(rows["command"]) < 500
    assert env.step([0.0]).first()


def test_a_blow_up_terminates_without_reward_and_the_next_episode_is_sound():
    env = load()
    env.reset()
    before = env.step([0.0])
    env.physics.data.qvel[:] = 1e9
    step = env.step([0.0])
    assert step.last()
    assert (step.reward, step.discount) == (0.0, 0.0)
    assert np.isfinite(step.observation["position"]).all()
    np.testing.assert_array_equal(step.observation["position"], before.observation["position"])
    assert np.isfinite(episode(env)["qpos"]).all()
    assert not Path("MUJOCO_LOG.TXT").exists()


def test_render_gives_pictures_without_a_display(tmp_path):
    out = tmp_path / "film.mp4"
    environment = {**os.environ, "MUJOCO_GL": "egl"}
    environment.pop("DISPLAY", None)
    arguments = ["--duration", "0.4", "--model", "knee_bench", "--out", str(out)]
    result = subprocess.run(
        [sys.executable, ROOT / "examples" / "environment.py", *arguments],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    means = [float(text) for text in re.findall(r"mean reward (\d\.\d+)", result.stdout)]
    assert len(means) == 2
    assert all(0.5 < mean < 1.0 for mean in means)
    import imageio_ffmpeg

    frames = imageio_ffmpeg.read_frames(str(out))
    size = next(frames)["size"]
    first, *_, last = (np.frombuffer(f, np.uint8).astype(int) for f in frames)
    assert size == (480, 360)
    assert first.std() > 10  # something is to be seen
    assert np.abs(first - last).max() > 30  # and it moves


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"action": "residual", "randomize": {"severity": (2, 9)}},
        {"action": "torque"},
        {"flat_observation": True},
    ],
)
def test_gymnasium_finds_nothing_wrong(settings):
    env = gymnasium.make("leglab/SealWear-v0", **KNEE, **settings)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env.unwrapped, skip_render_check=True)  # that with pictures is below
    assert [str(w.message) for w in caught] == []
    env.close()


def test_gymnasiums_check_passes_with_pictures_and_without_a_display():
    code = """
        import gymnasium, leglab.environment
        from gymnasium.utils.env_checker import check_env
        env = gymnasium.make("leglab/SealWear-v0", model="knee_bench", duration=0.2)
        check_env(env.unwrapped)
    """
    told = ("DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")
    plain = {name: value for name, value in os.environ.items() if name not in told}
    arguments = [sys.executable, "-W", "error::UserWarning", "-c", textwrap.dedent(code)]
    found = subprocess.run(arguments, env=plain, capture_output=True, text=True)
    assert (found.returncode, found.stdout) == (0, ""), found.stderr


def test_gymnasium_ends_by_time_and_resets_to_the_run_of_its_seed():
    env = gymnasium.make("leglab/SealWear-v0", **KNEE, action="residual")
    run = run_scenario(
        RunSettings(scenario="seal_wear", controller="static_feedforward", seed=7, **KNEE)
    )
    observation, _ = env.reset(seed=7)
    positions = [env.unwrapped.physics.position()]
    terminated = truncated = False
    while not (terminated or truncated):
        assert observation in env.observation_space
        observation, _, terminated, truncated, _ = env.step(np.zeros(1))
        positions.append(env.unwrapped.physics.position())
    assert (terminated, truncated) == (False, True)
    np.testing.assert_array_equal(positions, run.history.position)


def test_gymnasium_observes_in_float32_and_flat_as_one_box():
    named = gymnasium.make("leglab/SealWear-v0", **KNEE)
    flat = gymnasium.make("leglab/SealWear-v0", **KNEE, flat_observation=True)
    assert isinstance(flat.observation_space, gymnasium.spaces.Box)
    assert {space.dtype for space in named.observation_space.values()} == {np.dtype(np.float32)}
    assert flat.observation_space.dtype == flat.action_space.dtype == np.float32
    parts, _ = named.reset(seed=2)
    whole, _ = flat.reset(seed=2)
    np.testing.assert_array_equal(whole, np.concatenate([np.ravel(v) for v in parts.values()]))
    spaces = named.observation_space.spaces
    low = np.concatenate([np.ravel(spaces[name].low) for name in parts])
    np.testing.assert_array_equal(flat.observation_space.low, low)


def test_gymnasium_tells_episode_error_and_end():
    env = gymnasium.make(
        "leglab/SealWear-v0", **KNEE, randomize={"severity": (2.0, 9.0), "onset": (0.02, 0.1)}
    )
    _, told = env.reset(seed=4)
    settings = env.unwrapped.task.episode.settings
    assert 2.0 < told["severity"] == settings.severity < 9.0
    assert 0.02 < told["onset"] == env.unwrapped.task.episode.onset < 0.1
    assert (told["scenario"], told["seed"], told["time"]) == ("seal_wear", settings.seed, 0.0)
    _, _, _, _, told = env.step(np.array([0.3], np.float32))
    assert told["command"] == pytest.approx([0.3])
    unwrapped = env.unwrapped
    error = unwrapped.physics.position() - unwrapped.task.transition().reference.position
    np.testing.assert_array_equal(told["tracking_error"], error)
    assert told["time"] == pytest.approx(0.002)
    assert "ended" not in told
    over = False
    while not over:
        *_, over, told = env.step(np.zeros(1))
    assert told["ended"] == "duration"
    env = gymnasium.make("leglab/SealWear-v0", **KNEE, error_limit=1e-9)
    env.reset(seed=4)
    *_, terminated, _, told = env.step(np.ones(1))
    assert (terminated, told["ended"]) == (True, "error_limit")


def test_gymnasium_draws_as_it_was_asked(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert gymnasium.make("leglab/SealWear-v0", **KNEE).metadata["render_fps"] == 50
    with pytest.raises(LeglabError, match="needs a display, but DISPLAY is not set"):
        gymnasium.make("leglab/SealWear-v0", **KNEE, render_mode="human")
    with pytest.raises(LeglabError, match="render_mode 'film' is not allowed; choose one of hum"):
        leglab.environment.load_gymnasium("seal_wear", **KNEE, render_mode="film")


_WINDOW = """
    import gymnasium, time
    import leglab.environment
    env = gymnasium.make(
        "leglab/SealWear-v0", model="knee_bench", duration=0.2, render_mode="human"
    )
    env.reset(seed=1)
    window = env.unwrapped._window
    began = time.monotonic()
    over = False
    while not over:
        *_, over, told = env.step([0.0])
    assert time.monotonic() - began > 0.15, "faster than real time"
    assert window.handle.is_running() and told["time"] > 0.19
    env.reset()
    env.close()
    print("closed")
"""


@pytest.mark.slow("a real window")
def test_a_real_window_follows_an_episode(screen):
    environment = {**os.environ, "DISPLAY": screen, "MUJOCO_GL": "glfw"}
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(_WINDOW)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode, done.stdout.strip()) == (0, "closed"), done.stderr


def test_every_scenario_is_registered():
    names = {name.title().replace("_", "") for name in scenario_names()}
    assert {f"leglab/{name}-v0" for name in names} <= set(gymnasium.registry)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"action": "force"}, "'force' is not allowed; choose one of valve, residual, torque"),
        ({"action": "torque", "model": "leg_motor"}, "is none; allowed: 'valve', which"),
        ({"controller": "pd"}, "with action='residual' only"),
        ({"action": "residual", "controller": "pdd"}, "did you mean 'pd'"),
        ({"residual_scale": 0.0}, "residual_scale 0.0 is outside"),
        ({"reward": "speed"}, "unknown reward 'speed': choose one of smooth_tracking, tracking"),
        ({"randomize": {"wear": (0, 1)}}, "unknown random quantity of an episode 'wear'"),
        ({"randomize": {"severity": 3.0}}, "3.0 is no range"),
        ({"randomize": {"severity": (0.5, 20)}}, "randomize 'severity': .*severity 0.5 is outside"),
        ({"randomize": {"severity": (9.0, 3.0)}}, "is no range"),
        pytest.param(
            {"randomize": lambda random: {"wear": 1}}, "unknown random quantity", id="callable"
        ),
        ({"scenario": "nominal", "onset": 1.0}, "'nominal' changes nothing, so it has no onset"),
        ({"onset": 1.0}, "lasts until 1 s, the run ends at 0.2 s"),
        ({"control_period": 0.0012}, "multiple of the model's timestep"),
        ({"preview": (-1.0,)}, "preview"),
        ({"error_limit": 0.0}, "error_limit"),
        ({"seed": -1}, "seed -1 is negative"),
    ],
    ids=str,
)
def test_bad_settings_get_one_line(settings, message):
    with pytest.raises(LeglabError, match=message) as caught:
        load(**settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("action", "message"), [([0.0, 0.0], "shape"), ([np.nan], "finite")])
def test_bad_actions_get_one_line(action, message):
    env = load()
    env.reset()
    with pytest.raises(LeglabError, match=message):
        env.step(action)


@pytest.mark.parametrize("missing", ["dm_control", "gymnasium"])
def test_a_missing_package_is_named_with_the_line_that_installs_it(missing):
    code = (
        f"import sys; sys.modules[{missing!r}] = None\n"
        "import leglab.environment as e\n"
        "from leglab.base.errors import LeglabError\n"
        "try: e.load_gymnasium('seal_wear', model='knee_bench')\n"
        "except LeglabError as error: print(error)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert f"needs {missing}" in result.stdout, result.stderr
    assert 'pip install ".[rl]"' in result.stdout


def test_the_loads_of_a_payload_are_off_after_the_episode():
    env = load("payload")
    mass = env.physics.model.body_mass.copy()
    episode(env)
    assert env.physics.model.body_mass.sum() == pytest.approx(mass.sum() + 5.0)
    env.reset()
    np.testing.assert_array_equal(env.physics.model.body_mass, mass)
    assert isinstance(env.physics.model.ptr, mujoco.MjModel)
