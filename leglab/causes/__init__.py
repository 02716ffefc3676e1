"""Causes of changes in a machine: `table.CAUSES` has one row per cause.

Scenarios, fault bank, trials of effects, benchmark magnitudes, tables and pages derive from it.
"""
