"""From a dataset to a run: losses, optimisation, checkpoints."""
