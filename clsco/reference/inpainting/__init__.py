"""Filling of missing pixels; counterpart of kernels/inpainting."""
