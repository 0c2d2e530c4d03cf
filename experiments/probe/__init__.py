"""Linear probes from visual features to the ground's true friction."""
