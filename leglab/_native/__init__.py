"""Compiled parts: the MuJoCo plugin library and the nanobind modules."""
