"""`offpiste demo`: shipped models in a new world, or the whole path from simulation to driving."""
