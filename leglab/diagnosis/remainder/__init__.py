"""Learned remainder: static functions that describe errors which no effect explains."""
