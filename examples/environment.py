"""One episode as dm_env and one as Gymnasium, and a film: `python examples/environment.py`.

Nothing is trained. The dm_env episode corrects the static feed-forward by small random commands
while the seals wear out; the Gymnasium episode opens the valves at random. Needs the extra `rl`;
without a display, MUJOCO_GL=egl or osmesa.
"""

import argparse
from pathlib import Path

import gymnasium
import imageio_ffmpeg
import numpy as np

import leglab.environment

FRAME_RATE = 25
WIDTH, HEIGHT = 480, 360


def film(env, policy, path: Path) -> float:
    """Runs one dm_env episode, writes it to an MP4 file and returns the mean reward."""
    writer = imageio_ffmpeg.write_frames(
        str(path), (WIDTH, HEIGHT), fps=FRAME_RATE, macro_block_size=8
    )
    writer.send(None)
    rewards, frames = [], 0
    step = env.reset()
    while not step.last():
        step = env.step(policy(step.observation))
        rewards.append(step.reward)
        if env.physics.time() * FRAME_RATE >= frames:
            picture = env.physics.render(HEIGHT, WIDTH, camera_id="three_quarter")
            writer.send(np.ascontiguousarray(picture))
            frames += 1
    writer.close()
    return float(np.mean(rewards))


def main() -> None:
    """Runs both episodes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--duration", type=float, default=4.0, help="of an episode [s]")
    parser.add_argument("--model", default="leg")
    parser.add_argument("--out", type=Path, default=Path("environment.mp4"))
    arguments = parser.parse_args()
    common = {"model": arguments.model, "duration": arguments.duration}
    random = np.random.default_rng(0)

    env = leglab.environment.load(
        "seal_wear", action="residual", controller="static_feedforward", **common
    )
    spec = env.action_spec()
    mean = film(env, lambda observation: random.uniform(-0.2, 0.2, spec.shape), arguments.out)
    print(f"dm_env: mean reward {mean:.3f}; film written to {arguments.out}")

    env = gymnasium.make("leglab/SealWear-v0", randomize={"severity": (2.0, 20.0)}, **common)
    env.action_space.seed(0)
    env.reset(seed=1)
    rewards, over = [], False
    while not over:
        action = 0.02 * env.action_space.sample()
        _, reward, terminated, truncated, _ = env.step(action)
        rewards.append(reward)
        over = terminated or truncated
    severity = env.unwrapped.task.episode.settings.severity
    print(f"Gymnasium: mean reward {np.mean(rewards):.3f}, leakage x {severity:.1f}")
    env.close()


if __name__ == "__main__":
    main()
