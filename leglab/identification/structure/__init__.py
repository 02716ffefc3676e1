"""Structures chosen from data: `leglab identify`."""

from leglab.identification.structure.identify import Errors, Identified, identify
from leglab.identification.structure.search import Candidate, Plan

__all__ = ["Candidate", "Errors", "Identified", "Plan", "identify"]
