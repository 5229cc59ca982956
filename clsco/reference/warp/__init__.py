"""Reprojection; counterpart of kernels/warp."""
