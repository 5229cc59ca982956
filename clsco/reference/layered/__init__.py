"""Layered occlusion; counterpart of kernels/layered."""
