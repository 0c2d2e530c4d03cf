"""Closed loop on the proving ground: courses, drives by learned models, and their evaluation."""
