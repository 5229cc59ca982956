"""Image sensor in NumPy float32, with the bits of kernels/sensor."""
