"""Terms of the cost of driving, and the map layers that they read: a file dropped here, or an extension, adds some."""
