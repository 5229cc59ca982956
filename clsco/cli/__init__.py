"""The command `clsco`."""
