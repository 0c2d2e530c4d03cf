"""Many courses driven by several planners, as a table."""
