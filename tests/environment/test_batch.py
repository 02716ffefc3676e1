"""The batch of environments: the bits of each one alone, any number of threads, both interfaces."""

import subprocess
import sys
import textwrap
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from dm_env import StepType
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

from leglab import RunSettings, run_scenario
from leglab.base.errors import LeglabError
from leglab.environment import load_gymnasium, make_batch

KNEE = {"model": "knee_bench", "duration": 0.2}
ROOT = Path(__file__).parents[2]


def actions(env, count, scale=0.1):
    random = np.random.default_rng(0)
    return [random.uniform(-scale, scale, env.action_space.shape) for _ in range(count)]


def rolled(env, steps, scale=0.1, **reset):
    """Everything that a batch gives over some steps."""
    rows = [env.reset(**reset)[0]]
    for action in actions(env, steps, scale):
        observation, reward, terminated, truncated, _ = env.step(action)
        rows.append(np.column_stack([observation, reward, terminated, truncated]))
    return rows


CASES = {
    "specimens, static feed-forward": {**KNEE, "action": "residual", "tolerance": 0.1},
    "lost readings, valves": {"model": "leg", "scenario": "sensor_dropout", "duration": 0.2},
    "a load, bsnn_arx": {
        "model": "leg",
        "scenario": "payload",
        "duration": 0.16,
        "action": "residual",
        "controller": "bsnn_arx",
    },
    "a bank that looks": {
        **KNEE,
        "action": "residual",
        "controller": "bsnn_arx_bank",
        "controller_config": {"monitor": {"warm_up": 5, "slow_window": 10}},
    },
    "pressures that are learned with": {
        **KNEE,
        "scenario": "supply_drop",
        "action": "residual",
        "controller": "bsnn_arx_pressure",
    },
    "pressures, a ramp, pd": {
        **KNEE,
        "scenario": "cold_oil",
        "ramp_duration": 0.05,
        "action": "residual",
        "controller": "pd",
        "controller_config": {"position_gain": [0.7]},
    },
    "motors, a ramp of an encoder": {
        "model": "leg_motor",
        "scenario": "encoder_shift",
        "ramp_duration": 0.05,
        "duration": 0.2,
        "action": "residual",
        "reward": "smooth_tracking",
    },
    "contact": {
        "model": "leg_rail",
        "scenario": "seal_wear",
        "reference": "squat",
        "duration": 0.1,
    },
    "torques of specimens": {"model": "leg", "action": "torque", "tolerance": 0.1, "duration": 0.2},
    "in SI units": {**KNEE, "action": "residual", "normalize": False},
    "short periods without latency": {
        **KNEE,
        "control_period": 0.001,
        "sensors": {"latency": 0.0, "encoder_counts": 0},
        "preview": (),
    },
    "drawn scenarios": {
        **KNEE,
        "action": "residual",
        "randomize": {
            "scenario": ("seal_wear", "nominal", "sensor_dropout", "supply_drop"),
            "tolerance": (0.0, 0.2),
            "onset": (0.05, 0.15),
        },
    },
}


@pytest.mark.parametrize("settings", CASES.values(), ids=CASES.keys())
def test_every_machine_has_the_bits_of_the_environment_alone(settings):
    batch = make_batch(3, autoreset="same_step", seed=5, **settings)
    observation, info = batch.reset()
    alone = [load_gymnasium(seed=5 + i, flat_observation=True, **settings) for i in range(3)]
    for i, env in enumerate(alone):
        first, told = env.reset()
        np.testing.assert_array_equal(observation[i], first)
        assert told["scenario"] == info["scenario"][i]
        assert told["seed"] == info["seed"][i]
    ends = 0
    for action in actions(batch, 320):
        observation, reward, terminated, truncated, info = batch.step(action)
        for i, env in enumerate(alone):
            one, gain, over, late, told = env.step(action[i])
            assert (gain, over, late) == (reward[i], terminated[i], truncated[i])
            if over or late:
                ends += 1
                np.testing.assert_array_equal(info["final_obs"][i], one)
                assert info["final_info"]["ended"][i] == told["ended"]
                one, _ = env.reset()
            else:
                np.testing.assert_array_equal(info["tracking_error"][i], told["tracking_error"])
                assert info["time"][i] == pytest.approx(told["time"], abs=1e-12)
            np.testing.assert_array_equal(observation[i], one)
    assert ends >= 3
    batch.close()


def test_zero_residual_is_the_run():
    settings = {**KNEE, "scenario": "seal_wear", "tolerance": 0.1}
    batch = make_batch(2, action="residual", seed=3, **settings)
    batch.reset()
    rows = [batch.batch.true_position.copy()]
    for _ in range(100):
        batch.step(np.zeros(batch.action_space.shape))
        rows.append(batch.batch.true_position.copy())
    for i in range(2):
        run = run_scenario(RunSettings(controller="static_feedforward", seed=3 + i, **settings))
        np.testing.assert_array_equal(np.array(rows)[:, i], run.history.position)


@pytest.mark.parametrize("controller", ["static_feedforward", "bsnn_arx"])
def test_any_number_of_threads_gives_the_same_bits(controller):
    settings = {
        "model": "leg",
        "duration": 0.1,
        "action": "residual",
        "controller": controller,
        "randomize": {"severity": (2.0, 50.0), "tolerance": (0.0, 0.1), "onset": (0.0, 0.1)},
    }
    rows = [
        rolled(make_batch(7, threads=threads, **settings), 70, seed=11) for threads in (1, 2, 5)
    ]
    for other in rows[1:]:
        for a, b in zip(rows[0], other, strict=True):
            np.testing.assert_array_equal(a, b)
    again = make_batch(7, threads=2, **settings)
    rolled(again, 13, seed=4)  # from a used machine
    for a, b in zip(rows[0], rolled(again, 70, seed=11), strict=True):
        np.testing.assert_array_equal(a, b)
    different = rolled(again, 70, seed=12)
    assert not np.array_equal(rows[0][0], different[0])


@pytest.mark.parametrize("mode", list(AutoresetMode)[:2])
@pytest.mark.parametrize("vector", [SyncVectorEnv, AsyncVectorEnv])
def test_a_batch_is_gymnasiums_vector_of_the_same_environments(vector, mode):
    """Step by step, over ends of episodes: in one process and in several, by both autoresets."""
    settings = {**KNEE, "duration": 0.04, "action": "residual", "error_limit": 0.02}
    batch = make_batch(3, seed=2, autoreset=mode.name.lower(), **settings)
    make = partial(load_gymnasium, flat_observation=True, **settings)
    own = vector([partial(make, seed=2 + i) for i in range(3)], autoreset_mode=mode)
    assert batch.metadata["autoreset_mode"] == mode
    first = own.reset()[0].copy()
    np.testing.assert_array_equal(batch.reset()[0], first)
    assert len({row.tobytes() for row in first}) == 3
    ended = set()
    for action in actions(batch, 90, 1.0):
        got, expected = batch.step(action), own.step(action)
        for a, b in zip(got[:4], expected[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        told, wanted = (each[4].get("final_info", each[4]) for each in (got, expected))
        if "ended" in wanted:
            mask = wanted["_ended"]
            np.testing.assert_array_equal(told["_ended"], mask)
            assert list(told["ended"][mask]) == list(wanted["ended"][mask])
            ended |= set(told["ended"][mask])
            for i in np.flatnonzero(mask) if mode == AutoresetMode.SAME_STEP else ():
                last = got[4]["final_obs"][i]
                np.testing.assert_array_equal(last, expected[4]["final_obs"][i])
                assert np.any(last != got[0][i])
    assert ended == {"duration", "error_limit"}
    again = own.reset(seed=7)[0].copy()
    np.testing.assert_array_equal(batch.reset(seed=7)[0], again)
    own.close()


def test_dm_env_has_time_steps_of_all_machines():
    env = make_batch(2, **{**KNEE, "duration": 0.01}).dm_env
    step = env.step(np.zeros((2, 1)))  # the first call resets
    assert (step.step_type == StepType.FIRST).all()
    assert step.observation.dtype == np.float32
    kinds = []
    for _ in range(12):
        step = env.step(np.zeros((2, 1)))
        kinds.append(int(step.step_type[0]))
        assert (step.discount == 1.0).all()
        if kinds[-1] == StepType.FIRST:
            assert (step.reward == 0.0).all()
    middle, last, first = (int(kind) for kind in (StepType.MID, StepType.LAST, StepType.FIRST))
    assert kinds == [middle] * 4 + [last] + [first] + [middle] * 4 + [last] + [first]
    assert env.observation_spec().shape == step.observation.shape[1:]
    env.action_spec().validate(np.zeros(1))


def test_a_machine_that_blows_up_ends_alone():
    batch = make_batch(3, autoreset="same_step", **KNEE)
    batch.reset(seed=0)
    zero = np.zeros(batch.action_space.shape)
    before = batch.step(zero)[0]
    batch.batch.loop(1).simulation.data.qvel[0] = np.nan
    observation, reward, terminated, truncated, info = batch.step(zero)
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert reward[1] == 0.0
    assert (reward[[0, 2]] > 0).all()
    assert info["final_info"]["ended"][1] == "blow_up"
    np.testing.assert_array_equal(info["final_obs"][1], before[1])  # the last sound one
    assert np.isfinite(observation).all()
    assert not batch.step(zero)[2].any()


def test_a_mask_resets_some():
    batch = make_batch(3, **KNEE)
    first, _ = batch.reset(seed=0)
    zero = np.zeros(batch.action_space.shape)
    later = batch.step(zero)[0]
    some, info = batch.reset(options={"reset_mask": np.array([True, False, False])})
    np.testing.assert_array_equal(some[0], first[0])
    np.testing.assert_array_equal(some[1:], later[1:])
    assert info["_scenario"].tolist() == [True, False, False]


def test_gymnasium_makes_it_by_name():
    env = gymnasium.make_vec(
        "leglab/ColdOil-v0", num_envs=2, vectorization_mode="vector_entry_point", **KNEE
    )
    _, info = env.reset(seed=1)
    assert list(info["scenario"]) == ["cold_oil", "cold_oil"]
    assert info["seed"].tolist() == [1, 2]
    assert env.observation_space.contains(env.reset()[0])
    env.close()


def test_a_reward_of_ones_own_is_of_all_machines():
    batch = make_batch(2, reward=lambda t: -np.abs(t.error).max(axis=-1), **KNEE)
    batch.reset(seed=0)
    _, reward, *_, info = batch.step(np.zeros((2, 1)))
    np.testing.assert_array_equal(reward, -np.abs(info["tracking_error"]).max(axis=1))
    wrong = make_batch(2, reward=lambda t: float(np.abs(t.error).max()), **KNEE)
    wrong.reset()
    with pytest.raises(LeglabError, match=r"reward of a batch has shape \(\), allowed is \(2,\)"):
        wrong.step(np.zeros((2, 1)))


def test_loads_are_off_and_models_as_they_were_after_close():
    batch = make_batch(2, "payload", **KNEE)
    batch.reset()
    mass = batch.batch.loop(0).simulation.model.body_mass.copy()
    for action in actions(batch, 60):
        batch.step(action)
    assert batch.batch.loop(0).simulation.model.body_mass.max() > mass.max()
    batch.close()
    np.testing.assert_array_equal(batch.batch.loop(0).simulation.model.body_mass, mass)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_envs": 0}, "num_envs 0 is not allowed"),
        ({"threads": 0}, "threads 0 is not allowed"),
        ({"autoreset": "never"}, "autoreset 'never'.*next_step, same_step"),
        ({"randomize": {"scenario": ("wear",)}}, "unknown scenario 'wear'"),
        (
            {"randomize": {"scenario": ("seal_wear", "cold_oil"), "severity": (1, 2)}},
            "different units: give a function",
        ),
    ],
)
def test_wrong_settings_get_one_line(change, message):
    with pytest.raises(LeglabError, match=message) as caught:
        make_batch(**{"num_envs": 2, **KNEE, **change})
    assert "\n" not in str(caught.value)


def test_wrong_actions_get_one_line():
    batch = make_batch(2, **KNEE)
    with pytest.raises(LeglabError, match="step before reset"):
        batch.step(np.zeros((2, 1)))
    batch.reset()
    with pytest.raises(LeglabError, match=r"action has shape \(2,\), allowed is \(2, 1\)"):
        batch.step(np.zeros(2))
    with pytest.raises(LeglabError, match="action of machine 1 is not finite"):
        batch.step(np.array([[0.0], [np.nan]]))
    with pytest.raises(LeglabError, match="3 seeds for 2 machines"):
        batch.reset(seed=[1, 2, 3])


def test_a_fault_of_a_models_own_sensors_is_refused(tmp_path):
    import leglab.models

    text = (Path(leglab.models.__path__[0]) / "knee_bench.xml").read_text()
    custom = '<custom><numeric name="knee_encoder_offset" data="0.01"/></custom></mujoco>'
    path = tmp_path / "shifted.xml"
    path.write_text(
        text.replace("</mujoco>", custom).replace(
            'meshdir="meshes"', f'meshdir="{Path(leglab.models.__path__[0]) / "meshes"}"'
        )
    )
    batch = make_batch(2, model=str(path), duration=0.1)
    with pytest.raises(LeglabError, match="faults of their own, which a batch does not know"):
        batch.reset()


def test_threads_end_with_the_process():
    """A batch that nobody closed does not hang the interpreter."""
    code = textwrap.dedent("""
        import numpy as np
        from leglab.environment import make_batch
        batch = make_batch(4, model="knee_bench", threads=3)
        batch.reset()
        for _ in range(20):
            batch.step(np.zeros((4, 1)))
    """)
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=120, check=False)
    assert done.returncode == 0
