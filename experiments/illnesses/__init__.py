"""Logs with known truth, healthy and ill, on which `offpiste inspect` is scored."""
