"""Parallel execution of tasks in worker processes, on this machine or on a cluster."""
