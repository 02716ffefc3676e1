"""Checks of the hydraulics against closed forms and recordings, through the public API."""

from leglab.verification.report import verify
from leglab.verification.rows import Row

__all__ = ["Row", "verify"]
