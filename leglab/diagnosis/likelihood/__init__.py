"""Marginal likelihood of sets of effects: errors, their columns and covariance, evidence."""
