"""Rays to surfaces; counterpart of kernels/trace."""
