"""Uncertainty of predictions: spreads that grow along a rollout, their calibration, and novel ground."""
