"""Encoder faults that a model file carries.

MJCF has no element for a shifted or miscounting encoder, so a model says it by custom numerics:
`<joint>_encoder_offset` [rad or m] and `<joint>_encoder_scale`, measured = scale x true + offset.
A late encoder is a `jointpos` sensor `<joint>_delayed_position` with MuJoCo's own `delay`.
`leglab diagnose` writes them into improved.xml; closed loops and replays read them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

ENCODER_OFFSET = "{joint}_encoder_offset"
ENCODER_SCALE = "{joint}_encoder_scale"


def delayed_sensor(joint: str) -> str:
    """Name of the sensor that shows a joint's position late."""
    return f"{joint}_delayed_position"


@dataclass(frozen=True, kw_only=True, eq=False)
class EncoderFaults:
    """Faults of the encoders of some joints; arrays of shape (joints,).

    Attributes:
        offset: Added to every reading [rad or m].
        scale: Factor on the true position.
        delay: Age of what is shown [s].
    """

    offset: np.ndarray
    scale: np.ndarray
    delay: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel, joints: Sequence[str]) -> "EncoderFaults":
        """What a compiled model carries."""

        def number(name: str, otherwise: float) -> float:
            i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
            return otherwise if i < 0 else float(model.numeric_data[model.numeric_adr[i]])

        def delay(joint: str) -> float:
            i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, delayed_sensor(joint))
            return 0.0 if i < 0 else float(model.sensor_delay[i])

        return cls(
            offset=np.array([number(ENCODER_OFFSET.format(joint=j), 0.0) for j in joints]),
            scale=np.array([number(ENCODER_SCALE.format(joint=j), 1.0) for j in joints]),
            delay=np.array([delay(j) for j in joints]),
        )

    def __bool__(self) -> bool:
        return bool(self.offset.any() or (self.scale != 1.0).any() or self.delay.any())

    def seen(self, positions: np.ndarray, period: float) -> np.ndarray:
        """What encoders show of the latest of positions sampled so far, (joints,).

        Args:
            positions: Shape (n, joints), the latest last.
            period: Sampling period [s]; a delay between samples is interpolated.
        """
        last = len(positions) - 1
        at = np.clip(last - self.delay / period, 0.0, None)
        before = np.floor(at).astype(int)
        joints = np.arange(self.delay.size)
        early, later = positions[before, joints], positions[np.minimum(before + 1, last), joints]
        return self.scale * (early + (at - before) * (later - early)) + self.offset
