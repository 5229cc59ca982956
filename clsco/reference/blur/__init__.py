"""Scattering of sources by their PSF; counterpart of kernels/blur."""
