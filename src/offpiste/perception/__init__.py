"""From images to visual features on the points of a LiDAR."""
