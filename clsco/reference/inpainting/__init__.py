"""Filling of missing pixels, the twin of kernels/inpainting."""
