"""Worlds of the proving ground: terrain, kinds of ground, plants and appearance, from a seed."""
