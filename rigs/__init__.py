"""Rigs without hydraulics, and independent simulators of what their models lack."""

from importlib.util import find_spec

if find_spec("joblib") is None:
    raise ImportError(
        "rigs needs the clone's environment: make .venv/installed, then source .venv/bin/activate"
    )

from rigs.linkages import GANTRY, MOTOR_ARM, SERVO_ARM, SERVO_JOINT, Hidden, record_linkage
from rigs.simulator import PENDULUM, SLIDE_AXIS, Truth, record

__all__ = [
    "GANTRY",
    "MOTOR_ARM",
    "PENDULUM",
    "SERVO_ARM",
    "SERVO_JOINT",
    "SLIDE_AXIS",
    "Hidden",
    "Truth",
    "record",
    "record_linkage",
]
