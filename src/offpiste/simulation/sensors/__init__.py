"""Simulated cameras and LiDARs, and the messages that they record."""
