"""Host side of the kernels, with a module for each group of kernels."""
