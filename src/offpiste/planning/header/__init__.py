"""Generated C of the planner: terrain, cost terms and rollouts for GPUs and the host."""
