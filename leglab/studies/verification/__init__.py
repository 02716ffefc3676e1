"""Checks of the hydraulics against closed forms and recordings, through the public API."""

from leglab.studies.verification.report import checks_as_json, verify
from leglab.studies.verification.rows import Row

__all__ = ["Row", "checks_as_json", "verify"]
