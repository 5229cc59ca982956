"""Layered occlusion, the twin of kernels/layered."""
