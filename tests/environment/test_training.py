"""The example that trains a residual policy."""

import importlib.util
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("cma", reason="pip install cma")
pytest.importorskip("gymnasium", reason="pip install gymnasium")
pytest.importorskip("dm_control", reason="pip install dm-control")

EXAMPLE = Path(__file__).parents[2] / "examples" / "train_residual.py"
SHORT = ("--population", "6", "--machines", "1", "--judges", "3", "--duration", "1")


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("train_residual", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def train(example, folder, generations, monkeypatch):
    words = ["--generations", str(generations), *SHORT, "--out", str(folder)]
    monkeypatch.setattr(sys, "argv", ["train_residual.py", *words])
    example.main()
    return json.loads((folder / "result.json").read_text())


def test_an_interrupted_training_goes_on_with_the_same_bits(example, tmp_path, monkeypatch, capsys):
    train(example, tmp_path / "parts", 1, monkeypatch)
    parts = train(example, tmp_path / "parts", 2, monkeypatch)
    whole = train(example, tmp_path / "whole", 2, monkeypatch)
    for name in ("curve_median_best_mrad", "weights", "policy_mrad"):
        assert parts[name] == whole[name]
    assert len(parts["curve_median_best_mrad"]) == 2
    assert "generation 2 of 2" in capsys.readouterr().out


def test_features_are_what_they_are_called(example):
    """Of an observation whose parts are known numbers, two joints."""
    parts = {
        "position": (1, 2),
        "velocity": (3, 4),
        "pressure_a": (5e6, 6e6),
        "pressure_b": (1e6, 4e6),
        "supply": (2e7,),
        "reference": (1.5, 1.0),
        "speed": (3.5, 5.0),
        "rise": (30, 60),
        "previous": (9, 9),
        "command": (0.3, 0.6),
        "forward": (0.15, -0.3),
    }
    seen = example.features(np.concatenate(list(parts.values()))[None].astype(np.float32), 2)
    assert seen.shape == (1, 2, 8)
    np.testing.assert_allclose(seen[0, 0], [25, 1, 0.8, 3.5 / 3, 1, 1, 0.5, 1], rtol=1e-6)
    np.testing.assert_allclose(seen[0, 1], [-50, 2, 0.4, 5 / 3, 2, 2, -1, 1], rtol=1e-6)


def test_a_network_trains_on_the_batch_and_is_judged(tmp_path, monkeypatch):
    """Short: how much it gains is in docs/guides/environments.md."""
    pytest.importorskip("stable_baselines3", reason="pip install stable-baselines3 tensorboard")
    monkeypatch.syspath_prepend(str(EXAMPLE.parent))
    ppo = importlib.import_module("train_residual_ppo")
    words = ["--machines", "8", "--judges", "2", "--duration", "0.8", "--steps", "1024"]
    monkeypatch.setattr(sys, "argv", ["train_residual_ppo.py", *words, "--out", str(tmp_path)])
    ppo.main()
    found = json.loads((tmp_path / "result.json").read_text())
    assert np.isfinite(found["policy_mrad"] + found["static_feedforward_mrad"]).all()
    assert len(found["curve_s_steps_reward"]) == 1
    assert list(tmp_path.glob("PPO_1/events.out.tfevents.*"))


def test_a_network_sees_the_last_observation_of_an_episode(tmp_path, monkeypatch):
    pytest.importorskip("stable_baselines3", reason="pip install stable-baselines3 tensorboard")
    monkeypatch.syspath_prepend(str(EXAMPLE.parent))
    ppo = importlib.import_module("train_residual_ppo")
    arguments = SimpleNamespace(model="knee_bench", duration=0.5)
    batch = ppo.make(2, arguments, reward=ppo.reward, autoreset="same_step")
    machines, ended = ppo.Machines(batch), np.zeros(2, dtype=bool)
    begun = machines.reset()
    while not ended.any():
        seen, reward, ended, infos = machines.step(np.zeros((2, 1)))
        assert (reward <= 0).all()
    assert ended.all()
    for i, info in enumerate(infos):
        assert info["TimeLimit.truncated"]
        assert info["terminal_observation"].shape == seen[i].shape
        assert not np.allclose(info["terminal_observation"], seen[i])
    # The reference of the next episode's start is that of the first one's.
    np.testing.assert_allclose(seen[:, 3], begun[:, 3])
    machines.close()
