"""The command `clsco dev bench`: speed against error of the defocus pass, over sizes, radii, methods and PSFs."""
