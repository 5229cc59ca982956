"""The whole renderer once more in NumPy float64, without OpenCL: same files and names as the kernels."""

from clsco.reference.render import render

__all__ = ["render"]
