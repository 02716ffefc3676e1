"""Checks of the hydraulics against closed forms and recordings, through the public API."""

from leglab.verification.report import checks_as_json, verify
from leglab.verification.rows import Row

__all__ = ["Row", "checks_as_json", "verify"]
