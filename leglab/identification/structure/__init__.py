"""Choice of model structures from data: `leglab identify`."""

from leglab.identification.structure.identified import Errors, Identified, identify
from leglab.identification.structure.plans import Candidate, Plan

__all__ = ["Candidate", "Errors", "Identified", "Plan", "identify"]
