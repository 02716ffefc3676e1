"""Rigs without hydraulics, and independent simulators of what their models lack."""

from tests.rigs.linkages import GANTRY, MOTOR_ARM, SERVO_ARM, SERVO_JOINT, Hidden, record_linkage
from tests.rigs.simulator import PENDULUM, SLIDE_AXIS, Truth, record

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
