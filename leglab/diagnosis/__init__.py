"""Diagnosis: which physical effect a simulation lacks, judged on measured recordings."""
