"""What a scene names on disk: textures and depth maps."""
