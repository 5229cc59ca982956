"""Scene files: one per kind of scene with the defaults, and the figures of the thesis in `thesis`."""
