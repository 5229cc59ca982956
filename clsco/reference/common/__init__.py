"""Geometry and visibility, as kernels/common has it."""
