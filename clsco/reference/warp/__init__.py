"""Reprojection, as kernels/warp has it."""
