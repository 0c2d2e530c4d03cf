"""What a ray that is cast into a world meets, and what colour that has: the basis of simulated cameras and LiDARs."""
