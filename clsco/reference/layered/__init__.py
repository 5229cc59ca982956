"""Layered occlusion, as kernels/layered has it."""
