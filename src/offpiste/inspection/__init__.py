"""What `offpiste inspect` finds in the channels and the sensors of a log."""
