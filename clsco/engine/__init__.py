"""Runs plans on a device: frames of scenes, blur and filling of images, batches."""
