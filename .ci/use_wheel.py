"""Uses an installed wheel: a run, and with the extra `rl` a batch with the bits of the run."""

import importlib.metadata
import platform
import sysconfig

import mujoco
import numpy as np

import leglab
import leglab.environment
from leglab import RunSettings, run_scenario

MACHINE = {"model": "knee_bench", "duration": 1.0}
run = run_scenario(RunSettings(scenario="seal_wear", **MACHINE))
print(run)
try:
    import dm_control  # noqa: F401
except ImportError as error:
    done = f"no environment was stepped: {error}"
else:
    batch = leglab.environment.make_batch(
        4, "seal_wear", action="residual", controller="pd", **MACHINE
    )
    observation, info = batch.reset(seed=0)
    assert observation.dtype == np.float32, observation.dtype
    nothing, ended = np.zeros(batch.action_space.shape), np.zeros(4, dtype=bool)
    while not ended.any():
        observation, _, terminated, truncated, info = batch.step(nothing)
        ended = terminated | truncated
    assert truncated.all()
    assert np.isfinite(observation).all()
    # A residual of nothing is the run.
    assert info["tracking_error"][0] == run.history.error[-1], run.history.error[-1]
    batch.close()
    done = "a batch was stepped"

print(
    f"leglab {importlib.metadata.version('leglab')} from {leglab.__path__[0]}, "
    f"CPython {platform.python_version()} ({sysconfig.get_config_var('SOABI')}), "
    f"mujoco {mujoco.__version__}: {done}"
)
