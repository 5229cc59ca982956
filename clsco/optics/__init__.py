"""Lens, motion, surfaces, point spread functions and visibility in float64; pure functions without OpenCL."""
