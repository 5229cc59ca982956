"""One frame with its ground truth, its strips, its files and its provenance."""
