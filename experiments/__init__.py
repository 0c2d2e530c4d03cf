"""Studies and ablations: what offpiste was measured by; not in the wheel (README.md)."""
