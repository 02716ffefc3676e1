"""Normalisation of observations: a scale and finite bounds for each part."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from leglab.runs.preparation import Preparation, reference_joints

LIMIT = 10.0
"""Scaled observations are clipped there; commands at 1."""
# Time in which a scaled acceleration of 1 reaches full speed [s].
_RISE = 0.1
_COMMANDS = ("previous_command", "controller_command")


@dataclass(frozen=True, kw_only=True, eq=False)
class Scale:
    """Scale of one part of an observation: (value - offset) / unit, clipped to [-limit, limit]."""

    offset: np.ndarray  #: Offset in the unit of the part, float32, (size,), or () if all are equal
    unit: np.ndarray  #: Value above the offset that is scaled to 1; shape as `offset`
    limit: np.ndarray | float  #: Limit of scaled values; shape as `offset`

    def __call__(self, value: np.ndarray) -> np.ndarray:
        """Scales values in SI units, (..., size), in float32, so that batches get equal values."""
        scaled = np.asarray(value, dtype=np.float32) - self.offset
        scaled /= self.unit
        return scaled.clip(-self.limit, self.limit, out=scaled)


def observation_scales(preparation: Preparation) -> Mapping[str, Scale]:
    """Computes the scales of all possible parts of an observation from the nominal machine.

    Positions are scaled by half the joint's range, about mid-range; velocities by full speed,
    accelerations by full speed in 0.1 s, pressures by supply pressure. Commands are in [-1, 1].
    """
    nominal = preparation.nominal
    joints = reference_joints(nominal)
    low, high = np.array([(joint.lower, joint.upper) for joint in joints]).T
    half = np.where(high > low, (high - low) / 2, 1.0)
    speed = np.array([joint.velocity_limit for joint in joints])
    supply = nominal.data.plugin_state[nominal.supply_slot] if nominal.cylinders else 1.0
    motion = {"position": ((low + high) / 2, half), "velocity": (0.0, speed)}
    found = {
        **motion,
        "pressure_a": (0.0, supply),
        "pressure_b": (0.0, supply),
        "supply_pressure": (0.0, supply),
        **{f"reference_{name}": units for name, units in motion.items()},
        "reference_acceleration": (0.0, speed / _RISE),
        "reference_preview": motion["position"],
        "feedforward": (0.0, 1.0),
        **dict.fromkeys(_COMMANDS, (0.0, 1.0)),
    }
    return {
        name: Scale(
            offset=np.asarray(offset, dtype=np.float32),
            unit=np.asarray(unit, dtype=np.float32),
            limit=1.0 if name in _COMMANDS else LIMIT,
        )
        for name, (offset, unit) in found.items()
    }


def flat_scale(scales: Mapping[str, Scale], sizes: Mapping[str, int]) -> Scale:
    """Joins the scales of all parts into one scale for an observation that is one array.

    Args:
        scales: Scales by part.
        sizes: Number of values of each part, in the order of the observation.
    """

    def joined(field: str) -> np.ndarray:
        rows = [np.resize(getattr(scales[name], field), size) for name, size in sizes.items()]
        return np.concatenate(rows).astype(np.float32)

    return Scale(offset=joined("offset"), unit=joined("unit"), limit=joined("limit"))
