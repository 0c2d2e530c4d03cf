"""Simulated cameras and LiDARs."""
