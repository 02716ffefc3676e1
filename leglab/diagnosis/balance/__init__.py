"""Forces along the measured motion: what the model lacks, and where it lacks most."""
