"""Two rigs without hydraulics, and an independent simulator of what their models lack."""

from tests.rigs.simulator import PENDULUM, SLIDE_AXIS, Truth, record

__all__ = ["PENDULUM", "SLIDE_AXIS", "Truth", "record"]
