"""Conventions, geometry, channels, state, errors, files and registries of all stages."""
