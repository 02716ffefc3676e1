"""Residual forces and flows along the measured motion, and the regions where they are largest."""
