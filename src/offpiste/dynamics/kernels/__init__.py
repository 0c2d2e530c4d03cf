"""Fast rollouts on the CPU, derived from the same equations as the eager models: see `autograd.rollout_recorded`."""
