"""The proving ground: worlds, a vehicle with its own physics, and sensors, recorded as logs."""
