"""The page of a comparison: the table of the terminal, intervals as figures, every run."""
