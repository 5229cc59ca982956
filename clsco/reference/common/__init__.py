"""Geometry and visibility; counterpart of kernels/common."""
