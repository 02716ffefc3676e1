"""The simulated leg: MuJoCo, the hydraulic plugin, sensors, and what changes in a run."""
