"""A vehicle and its log: geometry, sensors, and which topic or column feeds which channel."""
