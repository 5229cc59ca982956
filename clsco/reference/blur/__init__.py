"""Scattering of sources by their PSF, as kernels/blur has it."""
