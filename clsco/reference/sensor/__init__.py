"""Image sensor in NumPy float32: the bits of kernels/sensor."""
