"""Features, the compile-time options of programs, with their meanings; each is 0 by default."""

from __future__ import annotations

FEATURES = {
    # Images and surfaces
    "CHANNELS": "channels of radiance, coverage included",
    "SEVERAL": "several objects",
    "QUADRATIC": "some objects are curved",
    "LINEAR": "some of these have linear terms",
    "NAPPE": "some show one nappe alone, or have bounds",
    "BOUNDED": "some have bounds, or are discs",
    "MAPPED": "some are depth maps",
    "MOVED": "some are not in their reference pose",
    "CURVED": "sum of CURVED_FIELD, CURVED_SPHERE, CURVED_IMAGE: what bends the surface in focus, or the image",
    "FILTER": "of textures: 0 nearest, 1 bilinear, 2 bicubic",
    "TEXTURED": "textures lie on surfaces: 1 with coordinates that are linear in a point, 2 with any",
    "LIT": "channels that a light falls on",
    # Sources
    "DIVIDED": "still sources are blurred once for all time samples",
    "SUBPIXELS": "sources along an axis of a pixel at a silhouette",
    "SMALL": "some surfaces have narrow images",
    "TILT": "the slope of the surface changes the weights of its blur",
    # Occluders, and rims of the lens
    "OCCLUDED": "the most objects that hide one source",
    "LIMITED": "some of these have bounds, or one nappe, or are discs",
    "SHARED": "parts of a pixel see the same edges",
    "RAYS": "rays of an aberrated lens arrive away from their lens points",
    "RIMS": "circles before and behind the lens that cut its light",
    "CUT_CHORDS": "these cut it by chords, of pixels (1) or of points (2)",
    "BORDERS": "and the lens is not round",
    # Weights
    "SAMPLED": "weights are samples, 1 within the blur",
    "DISC": "one weight for all of the blur",
    "SEPARABLE": "weights are products of one along each axis",
    "GENERAL": "whole rows of weights, of R and of -R; else octants are alike",
    "EDGES": "straight edges of the lens",
    "RING": "one weight between two rims",
    "WAVES": "light goes beyond the rim of the lens, where it counts as light of the rim",
    "FIELD": "tables for places of the frame; a source has weights between those of the four around it",
    "ELLIPSES": "blur of a distorted image",
    # Methods of blur
    "GATHER": "by bands of rows of the frame, on processors",
    "BY_COLUMNS": "and by columns of sources",
    "SPANS": "runs of one weight between edges",
    "SCATTER": "source by source in fixed point",
    "RENORMALIZE": "light is divided by the weights inside the frame",
    "QUADRANTS": "light through each quadrant of the lens is added apart",
    "PREPARE": "sources are made of a map of radii: 1 with gaps, 2 of floats without",
    "WIDE_SUMS": "sums of 64 bits keep very bright light apart",
    "SCAN_COLUMNS": "columns are exposed one after another",
    "FIXED_PATTERN": "pixels of the sensor differ",
    # Filling
    "OWNED": "bands of the image without atomics, on processors",
    "FILL_AIT": "adaptive interpolation",
    "FILL_MEAN_MEDIAN": "mean and median",
    "FILL_FAR": "from the farther side only",
    "DOMAIN_SURFACE": "where a surface is",
    "IMAGE": "of an image with a mask",
    "CODES": "whose values are codes of 8 bits",
    "ALPHA": "the last channel of images is alpha",
    "ALONE": "one work-item at a time settles, on processors",
}
