"""Planning with the learned model: MPPI (`mppi`), its noise, its costs."""
