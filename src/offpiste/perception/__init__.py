"""Visual features of images and their projection onto LiDAR points."""
