"""Files that a scene names: textures and depth maps."""
