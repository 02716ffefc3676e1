"""MJCF models that ship with leglab."""
