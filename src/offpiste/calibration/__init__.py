"""Mountings and delays of cameras and LiDARs, and their effects on maps, estimated from the drive itself."""
