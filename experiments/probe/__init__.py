"""What visual features tell of the ground: linear probes to its true friction."""
