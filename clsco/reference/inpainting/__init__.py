"""Filling of missing pixels, as kernels/inpainting has it."""
