"""Shared vocabulary of all layers: errors, settings, registries, recordings, scenarios."""
