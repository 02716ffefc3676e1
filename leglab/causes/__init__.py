"""One row a cause: `table.CAUSES` has all, from which everything else that names one is made.

Scenarios, the bank of faults, trials of effects, magnitudes of benchmarks, tables and pages.
"""
