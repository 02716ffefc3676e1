"""Scenarios by name: of the table of causes, and one a file here.

Importing this package makes all of them known to `leglab.base.scenario`; a new file here is
found by itself.
"""

from functools import partial

from leglab.base.registry import import_modules
from leglab.base.scenario import SCENARIOS, get_scenario, scenario_names
from leglab.causes.scenarios import register_causes

__all__ = ["get_scenario", "scenario_names"]

SCENARIOS.add_loader(partial(import_modules, __name__, __path__))
SCENARIOS.add_loader(register_causes)
