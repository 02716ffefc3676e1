"""Page of a comparison (table, confidence intervals, all runs) and table for the terminal."""
