"""Trains a residual policy on worn seals by CMA-ES: `python examples/train_residual.py`.

The policy adds a command to `static_feedforward`: for each joint tanh of a weighted sum of its
tracking error, the error's rate, the load pressure, the reference and the controller's own command.
Every candidate drives the same machines, whose seals wear out by 3 to 20 times; a batch steps all
candidates together (docs/guides/environments.md). Its cost is the RMS tracking error after the
change. The result is judged on machines of other seeds beside `static_feedforward` alone.

Needs the extra `train` (the package cma). Interrupted, it goes on from the last generation.
"""

import argparse
import json
import pickle
import time
from pathlib import Path

import cma
import numpy as np

import leglab.environment
from leglab.base.output import write_atomically

FEATURES = (
    "error",
    "error rate",
    "load pressure",
    "reference velocity",
    "reference acceleration",
    "command",
    "feed-forward",
    "one",
)
# What makes each feature about one: rad, rad/s, Pa, rad/s, rad/s^2, 1, 1, 1.
SCALES = np.array([0.02, 0.5, 5e6, 3.0, 30.0, 0.3, 0.3, 1.0])
ONSET = 0.4  # s
SETTLED = 0.3  # s after the change; from then on errors count
JUDGES = 1_000_000  # first seed of the machines that judge


def make(count, arguments, **settings):
    """Makes machines whose seals wear out early in an episode."""
    return leglab.environment.make_batch(
        count,
        scenario="seal_wear",
        model=arguments.model,
        action="residual",
        controller="static_feedforward",
        duration=arguments.duration,
        onset=ONSET,
        randomize={"severity": (3.0, 20.0)},
        preview=(),
        normalize=False,  # the policy's features have scales of their own
        **settings,
    )


def features(observation, joints):
    """What the policy sees, (machines, joints, features); see docs/guides/environments.md."""
    parts = observation.astype(float)
    names = ("position", "velocity", "a", "b")
    at = {name: parts[:, i * joints : (i + 1) * joints] for i, name in enumerate(names)}
    rest = parts[:, 4 * joints + 1 :]  # behind the supply pressure
    wanted, speed, rise, _, command, forward = (
        rest[:, i * joints : (i + 1) * joints] for i in range(6)
    )
    stacked = (
        wanted - at["position"],
        speed - at["velocity"],
        at["a"] - at["b"],
        speed,
        rise,
        command,
        forward,
        np.ones_like(wanted),
    )
    return np.stack(stacked, axis=2) / SCALES


def weighted(weights):
    """A policy of one set of weights a machine, (machines, joints, features)."""
    return lambda seen: np.tanh(np.einsum("mjf,mjf->mj", weights, seen))


def rollout(batch, policy, seeds):
    """Drives machines by a policy from features, (machines, joints, features), to actions.

    Returns:
        RMS tracking error of each after the change [rad], (machines,).
    """
    observation, info = batch.reset(seed=list(seeds))
    joints = batch.single_action_space.shape[0]
    squares, count = np.zeros(len(observation)), 0
    while True:
        seen = features(observation, joints)
        observation, _, terminated, truncated, info = batch.step(policy(seen))
        if info["time"][0] >= ONSET + SETTLED:
            squares += (info["tracking_error"] ** 2).mean(axis=1)
            count += 1
        if (terminated | truncated).any():
            blown = np.where(terminated, 1.0, 0.0)  # rad: worse than any that ends well
            return np.sqrt(squares / max(count, 1)) + blown


def train(arguments, state_file):
    """Runs the generations that are missing; returns the strategy and the curve."""
    joints = make(1, arguments).single_action_space.shape[0]
    size = joints * len(FEATURES)
    if state_file.exists():
        strategy, curve = pickle.loads(state_file.read_bytes())
    else:
        options = {"popsize": arguments.population, "seed": arguments.seed + 1, "verbose": -9}
        strategy, curve = cma.CMAEvolutionStrategy(np.zeros(size), 0.3, options), []
    batch = make(arguments.population * arguments.machines, arguments)
    while len(curve) < arguments.generations:
        started = time.monotonic()
        candidates = strategy.ask()
        weights = np.repeat(
            np.reshape(candidates, (-1, joints, len(FEATURES))), arguments.machines, 0
        )
        first = arguments.seed + len(curve) * arguments.machines
        seeds = np.tile(np.arange(first, first + arguments.machines), arguments.population)
        errors = rollout(batch, weighted(weights), seeds.tolist()).reshape(arguments.population, -1)
        # The logarithm: a machine that is hard to control does not decide alone.
        strategy.tell(candidates, np.log(errors).mean(axis=1).tolist())
        curve.append([float(1e3 * np.median(errors)), float(1e3 * errors.mean(axis=1).min())])
        state = pickle.dumps((strategy, curve))
        write_atomically(state_file, lambda stream, state=state: stream.write(state))
        took = time.monotonic() - started
        told = f"median {curve[-1][0]:.2f} mrad, best {curve[-1][1]:.2f} mrad, {took:.1f} s"
        print(f"generation {len(curve)} of {arguments.generations}: {told}", flush=True)
    batch.close()
    return strategy, curve, joints


def judge(policy, arguments):
    """Errors of static_feedforward and of a policy on the same machines [rad], (n,) each."""
    batch = make(arguments.judges, arguments)
    seeds = list(range(JUDGES, JUDGES + arguments.judges))
    found = rollout(batch, _nothing, seeds), rollout(batch, policy, seeds)
    batch.close()
    return found


def _nothing(seen):
    return np.zeros(seen.shape[:2])


def common(parser, machines, machines_help, out):
    """The options that both examples have, beside their own; parsed, with the folder there."""
    parser.add_argument("--model", default="knee_bench", help="one with cylinders")
    parser.add_argument("--machines", type=int, default=machines, help=machines_help)
    parser.add_argument("--judges", type=int, default=32, help="machines of the judgement")
    parser.add_argument("--duration", type=float, default=3.0, help="of an episode [s]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path(out))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    return arguments


def judged(policy, arguments, name, **found):
    """Judges a policy, writes what was found, and tells how it did."""
    alone, trained = judge(policy, arguments)
    result = {
        "settings": {k: v for k, v in vars(arguments).items() if k != "out"},
        **found,
        "static_feedforward_mrad": (1e3 * alone).tolist(),
        "policy_mrad": (1e3 * trained).tolist(),
    }
    text = json.dumps(result, indent=1) + "\n"
    write_atomically(arguments.out / "result.json", lambda out: out.write(text.encode()))
    better = int((trained < alone).sum())
    print(f"RMS error after the change, mean of {arguments.judges} machines [mrad]:")
    print(f"  static_feedforward {1e3 * alone.mean():.2f}")
    print(f"  with the {name} {1e3 * trained.mean():.2f}, better on {better}")


def main() -> None:
    """Trains, judges and writes what came out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--generations", type=int, default=45)
    parser.add_argument("--population", type=int, default=16)
    arguments = common(parser, 4, "a candidate drives", "out/residual")
    strategy, curve, joints = train(arguments, arguments.out / "state.pickle")
    weights = np.reshape(strategy.result.xfavorite, (joints, len(FEATURES)))
    many = np.repeat(weights[None], arguments.judges, axis=0)
    found = {"curve_median_best_mrad": curve, "weights": weights.tolist()}
    judged(weighted(many), arguments, "policy", **found)


if __name__ == "__main__":
    main()
