"""The page of `leglab identify`, its figures and its files."""
