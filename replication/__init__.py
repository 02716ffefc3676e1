"""Replication of the paper's experiment: Table 1, its figures, and their sensitivities."""

from replication.run import Replication, replicate

__all__ = ["Replication", "replicate"]
