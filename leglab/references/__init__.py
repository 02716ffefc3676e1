"""Reference trajectories by name: position of every joint with its exact first two derivatives.

Signs of joint angles [rad] are those of leg.xml: hip_yaw is positive with the toes outwards,
hip_roll in abduction, hip_pitch and knee in flexion, ankle_pitch in dorsiflexion, ankle_roll in
eversion. All are zero when standing upright.
"""

from leglab.references.base import (
    Joint,
    Motion,
    Reference,
    Samples,
    make_reference,
    reference_names,
    register_reference,
    rest_pose,
)
from leglab.references.from_file import FromFile
from leglab.references.gait import GAIT
from leglab.references.multisine import Multisine
from leglab.references.random_stride import RandomStride
from leglab.references.sine_sweep import SineSweep
from leglab.references.squat import Squat
from leglab.references.step import Step
from leglab.references.walking_stride import WalkingStride

# References that move only joints with the names of a leg's joints.
LEG_REFERENCES = ("random_stride", "squat", "walking_stride")

__all__ = [
    "GAIT",
    "LEG_REFERENCES",
    "FromFile",
    "Joint",
    "Motion",
    "Multisine",
    "RandomStride",
    "Reference",
    "Samples",
    "SineSweep",
    "Squat",
    "Step",
    "WalkingStride",
    "make_reference",
    "reference_names",
    "register_reference",
    "rest_pose",
]
