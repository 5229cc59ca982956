"""Geometry and visibility, the twin of kernels/common."""
