"""Inspection of a log: checks of its channels and sensors, their findings, and a first rig."""
