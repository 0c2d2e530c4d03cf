"""`offpiste demo`: shipped models in a new world, or all stages from simulation to driving."""
