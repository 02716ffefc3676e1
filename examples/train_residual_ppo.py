"""Trains a residual network on worn seals by PPO: `python examples/train_residual_ppo.py`.

The task of `train_residual.py` with a network in place of its weighted sum: stable-baselines3 takes
the batch of `leglab.environment.make_batch` as its vectorised environment. What the network sees
are the same signals; its reward falls with the tracking error. It is judged on the machines on
which `train_residual.py` judges, beside `static_feedforward` alone.

Needs `pip install stable-baselines3 tensorboard`. `tensorboard --logdir OUT` shows the training.
"""

import argparse
import time

import numpy as np
import stable_baselines3
import torch
from gymnasium.spaces import Box
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv
from train_residual import FEATURES, common, features, judged, make

ERROR_SCALE = 0.01  # rad: an error of that size costs 1 a step


class Machines(VecEnv):
    """A batch as stable-baselines3 knows it, which observes the features of the example.

    An episode that ends begins anew in the same step, and its last observation goes to `infos`.
    """

    def __init__(self, batch):
        self.batch = batch
        self.joints = batch.single_action_space.shape[0]
        shape = (self.joints * len(FEATURES),)
        seen = Box(-np.inf, np.inf, shape, np.float32)
        action = Box(-1.0, 1.0, (self.joints,), np.float32)
        super().__init__(batch.num_envs, seen, action)

    def _features(self, observation):
        flat = features(observation, self.joints).reshape(self.num_envs, -1)
        return flat.astype(np.float32)

    def reset(self):
        return self._features(self.batch.reset(seed=self.first_seed)[0])

    first_seed = 0

    def step_async(self, actions):
        self._actions = actions

    def step_wait(self):
        observation, reward, terminated, truncated, info = self.batch.step(self._actions)
        ended = terminated | truncated
        infos = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(truncated):
            infos[i]["TimeLimit.truncated"] = True
            last = features(info["final_obs"][i][None], self.joints).reshape(-1)
            infos[i]["terminal_observation"] = last.astype(np.float32)
        return self._features(observation), reward.astype(np.float32), ended, infos

    def close(self):
        self.batch.close()

    def seed(self, seed=None):
        self.first_seed = seed or 0

    def get_attr(self, attr_name, indices=None):
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name, value, indices=None):
        raise NotImplementedError

    def env_method(self, method_name, *args, indices=None, **kwargs):
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs


def reward(transition):
    """Falls with the error, most steeply where it is small; (machines,)."""
    return -np.sqrt(np.abs(transition.error) / ERROR_SCALE).mean(axis=1)


class Curve(BaseCallback):
    """Keeps time [s], steps and mean reward a step of every update."""

    def __init__(self):
        super().__init__()
        self.points, self._begin = [], time.monotonic()

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        mean = float(self.model.rollout_buffer.rewards.mean())
        self.points.append([time.monotonic() - self._begin, self.num_timesteps, mean])
        self.logger.record("rollout/reward_a_step", mean)


def main() -> None:
    """Trains, judges and writes what came out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=500_000, help="of all machines together")
    arguments = common(parser, 64, "of the batch", "out/residual_ppo")
    torch.set_num_threads(1)
    batch = make(arguments.machines, arguments, reward=reward, autoreset="same_step")
    curve = Curve()
    model = stable_baselines3.PPO(
        "MlpPolicy",
        Machines(batch),
        seed=arguments.seed,
        n_steps=128,
        batch_size=2048,
        n_epochs=5,
        gamma=0.95,
        gae_lambda=0.9,
        learning_rate=1e-3,
        policy_kwargs={"net_arch": [32, 32], "log_std_init": -1.0},
        tensorboard_log=str(arguments.out),
        device="cpu",
        verbose=1,
    )
    started = time.monotonic()
    model.learn(arguments.steps, callback=curve)
    took = time.monotonic() - started
    model.save(arguments.out / "policy.zip")

    def policy(seen):
        return model.predict(seen.reshape(len(seen), -1).astype(np.float32), deterministic=True)[0]

    print(f"trained for {took:.0f} s")
    judged(policy, arguments, "network", seconds=took, curve_s_steps_reward=curve.points)


if __name__ == "__main__":
    main()
