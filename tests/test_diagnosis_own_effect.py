"""The example of docs/effects.md, run as it stands there."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leglab.diagnosis.catalogue import markdown_table
from leglab.diagnosis.effects import all_effects, base
from leglab.diagnosis.verdict import diagnose
from leglab.diagnosis.workflow import Settings
from leglab.recording import Recording
from tests.rigs import PENDULUM

DOCS = Path(__file__).parent.parent / "docs"


@pytest.fixture
def example(monkeypatch):
    """Runs the example's class; other tests do not see it."""
    all_effects()
    monkeypatch.setattr(base, "_REGISTRY", dict(base._REGISTRY))
    source = re.findall(r"```python\n(.*?)```", (DOCS / "effects.md").read_text(), re.DOTALL)[0]
    names = {"__name__": "my_effects"}
    exec(compile(source, "docs/effects.md", "exec"), names)
    return names["Counterbalance"]


def balanced(kind, share, seconds=4.0):
    """The pendulum with a balancer, a PD loop, a small step, and encoder noise."""
    spec = mujoco.MjSpec.from_file(str(PENDULUM.model))
    spec.option.timestep = 1e-4
    spec.body("arm").gravcomp = share
    model = spec.compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(len(kind))
    rate = {"slow": 2.0, "middle": 4.0, "fast": 7.0}[kind]
    positions, commands = [], []
    for k in range(round(seconds / 1e-3)):
        goal = 0.9 * np.sin(rate * k * 1e-3)
        data.ctrl[0] = 12.0 * (goal - data.qpos[0]) - 0.8 * data.qvel[0]
        positions.append(data.qpos[0] + rng.normal(0.0, 1e-4))
        commands.append(data.ctrl[0])
        mujoco.mj_step(model, data, 10)
    columns = {"hinge_position": np.array(positions), "drive_command": np.array(commands)}
    return Recording(time=1e-3 * np.arange(len(positions)), columns=columns)


def test_the_example_is_registered_and_named(example):
    assert example.name in {effect.name for effect in all_effects()}
    recordings = {kind: balanced(kind, 0.25) for kind in ("slow", "middle", "fast")}
    rivals = ("counterbalance", "viscous_friction", "spring_hardening", "force_offset", "armature")
    result, _ = diagnose(
        PENDULUM.model, recordings, held_out=("middle",), settings=Settings(effects=rivals)
    )
    assert [effect.name for effect in result.effects] == ["counterbalance"]
    assert result.effects[0].parameters[0].value == pytest.approx(0.25, abs=0.01)


def test_the_table_in_docs_is_up_to_date():
    assert (DOCS / "effect_table.md").read_text() == markdown_table()
