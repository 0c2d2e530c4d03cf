"""Planning with the learned model: MPPI, its noise and its costs."""
