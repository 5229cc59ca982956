"""Rays to surfaces, the twin of kernels/trace."""
