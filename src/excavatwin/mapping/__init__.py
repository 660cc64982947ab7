"""Projection of the labelled scene onto a horizontal grid: elevation, labels, occupancy, and the map itself."""
