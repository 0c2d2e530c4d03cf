"""Known faults in simulated logs: which of them `offpiste inspect` finds and fixes."""
