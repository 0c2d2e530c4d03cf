"""Driving courses on the proving ground with trained models, and scores of the drives."""
