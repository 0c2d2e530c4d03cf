"""Planning by the printed C: terrain, cost terms and rollouts as one text for GPUs and for the host."""
