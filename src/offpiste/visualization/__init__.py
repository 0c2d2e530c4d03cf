"""Pictures of logs and datasets, Rerun recordings, and reports of what features cover."""
