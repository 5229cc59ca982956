"""Missing pixels of an image, filled from what is known around them."""
