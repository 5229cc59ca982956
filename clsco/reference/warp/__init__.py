"""Reprojection, the twin of kernels/warp."""
