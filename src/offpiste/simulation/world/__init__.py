"""Worlds of the proving ground: terrain, kinds of ground and plants, from a seed."""
