"""Studies and ablations behind docs/results.md; not in the wheel (README.md)."""
