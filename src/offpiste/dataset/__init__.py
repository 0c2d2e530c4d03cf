"""Datasets: rows at 50 Hz, splits and windows of 5 s."""
