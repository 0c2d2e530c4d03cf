"""Simulated cameras and LiDARs, their imperfections, and the messages that they record."""
