"""Checks of the hydraulics against closed forms and recordings, through the public API."""

from leglab.studies.verification.cases import Check
from leglab.studies.verification.report import checks_as_json, verify

__all__ = ["Check", "checks_as_json", "verify"]
