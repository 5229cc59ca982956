"""The OpenCL kernels, as text: a folder of the package, `clsco.kernels` once installed."""
