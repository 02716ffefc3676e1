"""Controllers, one a file, by name."""
