"""What everything speaks: errors, settings, registries, recordings, scenarios."""
