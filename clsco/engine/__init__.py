"""Runs plans on a device: renders frames and batches, and blurs and fills images."""
