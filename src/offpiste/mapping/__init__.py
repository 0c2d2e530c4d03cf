"""The ground as a map, and how models read it."""
