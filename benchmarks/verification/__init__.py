"""Checks of the hydraulics against closed forms and recordings, through the public API."""

from benchmarks.verification.cases import Check
from benchmarks.verification.report import checks_as_json, verify

__all__ = ["Check", "checks_as_json", "verify"]
