"""Sec. "Geometric Spatial Processing": gravity, scale, voxels, local geometry, terrain envelope, objects."""
