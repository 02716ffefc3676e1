"""Reference trajectories by name: position, velocity and acceleration of every joint, exactly.

Joint angles count as in leg.xml: hip_yaw positive with the toes outwards, hip_roll in abduction,
hip_pitch and knee in flexion, ankle_pitch in dorsiflexion, ankle_roll in eversion [rad], zero when
standing upright.
"""

from leglab.references.base import (
    Joint,
    Reference,
    Samples,
    make_reference,
    reference_names,
    reference_settings,
    reference_summary,
    register_reference,
)
from leglab.references.random_stride import RandomStride
from leglab.references.sine_sweep import SineSweep
from leglab.references.squat import Squat
from leglab.references.step import Step
from leglab.references.walking_stride import WalkingStride

__all__ = [
    "Joint",
    "RandomStride",
    "Reference",
    "Samples",
    "SineSweep",
    "Squat",
    "Step",
    "WalkingStride",
    "make_reference",
    "reference_names",
    "reference_settings",
    "reference_summary",
    "register_reference",
]
