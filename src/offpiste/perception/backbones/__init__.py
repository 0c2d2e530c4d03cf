"""Backbones: RGB images in, one feature vector a patch out."""
