"""Kinds of courses; each registers where it is defined."""
