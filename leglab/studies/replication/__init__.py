"""The paper's experiment replicated: Table 1, its figures, and what they hang on."""

from leglab.studies.replication.run import Replication, replicate

__all__ = ["Replication", "replicate"]
