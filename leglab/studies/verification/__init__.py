"""Checks of the hydraulics against closed forms and recordings, through the public API."""

from leglab.studies.verification.cases import Row
from leglab.studies.verification.report import checks_as_json, verify

__all__ = ["Row", "checks_as_json", "verify"]
