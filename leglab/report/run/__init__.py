"""The report of runs: words, tables, plots and the film on one page."""
