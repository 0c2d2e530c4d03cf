"""Pictures of logs and datasets, Rerun recordings, and reports of feature coverage."""
