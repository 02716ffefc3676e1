"""How far a bare MuJoCo model strays from a recording whose commands drive it, free of leglab."""

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from leglab.base.recording import Recording
from leglab.base.scale import rms

_STEPS = 50  # of the model in a sample of 1 ms


def open_loop_error(
    model: Path, recording: Recording, joints: Sequence[str], drives: Sequence[str]
) -> float:
    """RMS of the positions' error over the whole recording, rad or m."""
    bare = mujoco.MjModel.from_xml_path(str(model))
    bare.opt.timestep = 1e-3 / _STEPS
    data = mujoco.MjData(bare)
    positions = np.stack([recording[f"{joint}_position"] for joint in joints], axis=1)
    commands = np.stack([recording[f"{drive}_command"] for drive in drives], axis=1)
    data.qpos[:] = positions[0]
    off = []
    for measured, command in zip(positions, commands, strict=True):
        off.append(measured - data.qpos)
        data.ctrl[:] = command
        mujoco.mj_step(bare, data, _STEPS)
    return float(rms(off))
