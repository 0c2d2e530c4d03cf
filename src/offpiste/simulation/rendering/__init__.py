"""Ray casting and shading for simulated cameras and LiDARs."""
