"""Marginal likelihood of sets of effects: errors, their columns, their covariance, their evidence."""
