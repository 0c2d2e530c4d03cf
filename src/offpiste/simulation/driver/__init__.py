"""The simulated driver: route, look-ahead and behaviour."""
