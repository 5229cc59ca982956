"""Scattering of sources by their PSF, the twin of kernels/blur."""
