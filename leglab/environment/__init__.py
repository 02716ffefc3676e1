"""The leg as a reinforcement-learning environment: dm_env through dm_control, and Gymnasium.

Importing this package registers the Gymnasium environments if Gymnasium is installed;
dm_control is imported when the first environment is made. Both are installed by
`pip install ".[rl]"` in a clone of leglab.
"""

from leglab.environment.loading import load, load_gymnasium, make_batch, register
from leglab.environment.rewards import REWARDS, Transition

__all__ = ["REWARDS", "Transition", "load", "load_gymnasium", "make_batch"]

register()
