"""Host side of the kernels: one module for each group of kernels."""
