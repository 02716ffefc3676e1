"""leglab: a MuJoCo testbed for hydraulic humanoid-leg control."""

__version__ = "0.1.0"
