"""Pupils: what the opening of a lens lets through, as functions on [-1, 1]^2 (float64, pure).

Each file holds one kind: its transmission, what is known of its blur in closed form, and an example. A pupil that has
no closed form is an `image`. `clsco.optics.point_spread.PointSpread` makes weights of any of them.
"""
