"""Rays to surfaces, as kernels/trace has it."""
