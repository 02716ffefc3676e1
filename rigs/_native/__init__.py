"""Compiled rigs, of a checkout alone."""
