"""Constants shared by host and kernels, or by device and reference; kernels get them as -D options.

Every program is compiled with all of them (`clsco.opencl.program.build`), so each name has one meaning in all kernels.
A constant that only kernels use is a `#define` there; a value that differs from program to program is a feature.
"""

from __future__ import annotations

# Indices of a frame's statistics, which are ints (kernels/common/geometry.clh, kernels/trace). The largest and
# the smallest |R| are stored as the bits of a float; the slots are those of sub-pixel sources used at a time sample.
STATISTIC_LARGEST = 0
STATISTIC_SMALLEST = 1
STATISTIC_SLOTS = 2
STATISTIC_BEYOND = 3  # 1 if an object was hit outside of its predicted extent
CHANGE_TILE = 16  # px; tiles of the map of sources that change during an exposure (clsco/optics/still.py)
NARROW_IMAGE = 4  # px; a surface whose image is narrower counts as small (kernels/trace/small.clh)

# Bits of the feature CURVED (kernels/common/geometry.clh).
CURVED_FIELD = 1
CURVED_SPHERE = 2
CURVED_IMAGE = 4

# MAP: kinds of coordinates that map a texture to its surface (clsco/optics/texture_mapping.py,
# kernels/trace/mapping.clh). WRAP: continuations of an image beyond its edges.
MAP_PROJECTED = -1
MAP_PLANE = 0
MAP_CYLINDER = 1
MAP_LONGITUDE = 2
MAP_CONE = 3
MAP_TRIPLANAR = 4
MAP_CUBE = 5
WRAP_REPEAT = 0
WRAP_MIRROR = 1
WRAP_CLAMP = 2
WRAP_NONE = 3
CUBE_BORDER = 2  # texels of the neighboring faces around a face of a cube map at each level, for a bicubic filter

# Footprints of pixels on textures that lie on surfaces (kernels/trace/footprint.clh).
FOOTPRINT_CELLS = 8  # largest number of cells along an axis of a pixel
LEAST_TEXELS = 2  # least number of texels across the narrow side of a footprint, unless the level is the finest
CELL_TEXELS = 11  # largest number of texels along an axis of a cell, unless cells would be too many
MOST_CELL = 16  # largest width of a cell along an axis of the image, texels
NARROWEST = 64  # cells are at least 1 / NARROWEST texels wide
MOST_SHEAR = 1  # an axis of a cell spans texels along columns and along rows; largest product of both numbers
MOST_TEXELS = 24  # largest number of texels along an axis of a pixel; if there are more, the level is a coarser one
BENT_CELLS = 32  # as FOOTPRINT_CELLS, near a pole, where the footprint is bent and cells are points
BENT_TEXELS = 0.75  # as CELL_TEXELS, near a pole
MOST_BENT_TEXELS = 64  # as MOST_TEXELS, near a pole
DETAILED_TEXELS = 0.54  # texels per pixel, along the wider axis, above which a pixel may need sub-pixel sources
DETAILED_MOST = 4.5  # px, |R| from which on a pixel needs no sub-pixel sources for its texture
FINE_TEXELS = 1.17  # texels per pixel above which a pixel is cut into smaller parts
FINE_MOST = 9.0  # px, as DETAILED_MOST, for a pixel that is cut into smaller parts
NEAR_FOCUS = 0.3  # px, |R| below which a pixel is also cut into smaller parts
# Factor on the limits of squared numbers of texels: images often have a whole number of texels per pixel, for which
# rounding would decide the comparison.
APART = 1.17

# Visibility (kernels/common/visibility.clh).
LENS_CELLS = 8  # cells of the lens per half axis, if visibility is tested on a grid of cells
SHARED_PLACE = 10.0  # px per lens radius; an occluder's edge that is closer differs between the parts of a pixel

# Tables of weights (kernels/common/psf.clh, kernels/blur/cpu).
TAP_LANES = 8  # floats in a vector of taps; rows of weights are padded to whole vectors
POWERS = 4  # coefficients of a weight, a cubic polynomial in the position within an interval
TABLE_STEPS = 48  # least number of intervals per octave of the radius
# Floats in the widest vector, and intervals in a window: kernels read the coefficients of a tap for a whole window, and
# windows begin at every TAP_LANES-th interval.
WIDE_LANES = 16

# Weights by chords (clsco/optics/chords.py, kernels/common/chords.clh).
LEAST_OPENING = 5e-4  # px, radius of a lens opening; the light of smaller ones would be lost in rounding

# Blur by `gather` (kernels/blur/cpu).
# Number of rows in the band of a work-item: enough bands for several cores, and little overlap. The order of sources is
# counted from the first row of the band, so strips of whole bands are bit-identical to the whole frame.
BAND = 64
COLUMN_STEP = 32  # least number of columns of sources per launch, if sources are processed by columns
MOST_ITEMS = 256  # largest number of groups of sources of a column in memory at a time
ITEMS_BYTES = 2**18  # memory limit of groups of sources with Gaussian PSFs, unless a few groups are larger
MOST_ASIDE = 5  # largest number of columns in a block of sources with Gaussian PSFs

# Blur by `tiles` (kernels/blur/tiles.cl).
GROUP_COLUMNS = 16  # pixels of a work-group along a row
GROUP_ROWS = 8  # pixels of a work-group along a column

# Blur by `convolve` (kernels/blur/convolve.cl).
CONVOLVED_ROWS = 32  # rows of the frame that a work-item computes
CONVOLVED_COLUMNS = 64  # columns of the frame that a work-item computes, a multiple of WIDE_LANES
TILES_ABREAST = 8  # adjacent work-items that run before the next ones below, so that they find their input in the cache
LONGEST_RUN = 8  # largest number of weights in a run, which a kernel keeps in registers
DROPPED_BITS = 26  # number of lower bits of a sum over a disc that 32-bit sums omit

# Layered occlusion (kernels/layered/layered.cl).
# px, least |R1 - R2| of two neighboring pixels at which one can hide a pixel behind it. From the middle of the lens to
# its edge, the two shift by this distance relative to each other.
DISCONTINUITY = 1.0
LAYER_BIN = 0.25  # px; depth layers end at multiples of this radius
DISCONTINUITY_CLASSES = 10  # number of size classes, for sizes above 1, 2, 4 ... times DISCONTINUITY
LAYER_TILE = 16  # rows and columns of the tiles that are blurred with or without occlusion
REACH_MARGIN = 2  # px, as tables of weights round radii up
FUSED = 0.25  # px; a hidden surface whose radius differs by less from that of the pixel is the pixel's own
OPAQUE = 0.999  # least alpha of an opaque pixel, as sums of samples are rounded
MIXED_AROUND = 4  # px around a pixel at an edge, in which the mean colors of its two surfaces are taken

# Forward warp (kernels/warp/warp.cl).
OWNED_PIXELS = 64  # sources of a row that a work-item moves, if work-items own bands of the image
# px: a surface that grows in the image gets gaps between its moved pixels. In a gap, the surface is searched for up to
# this distance to each side, which suffices for a growth by a factor of four.
WIDEST_GAP = 3
NO_WINNER = 2**31 - 1  # stands for the number of the nearest source in a pixel to which no source is moved

# Filling of missing pixels (kernels/inpainting/fill.cl, fill_mean_median.cl, mean_median.cl).
FILL_LANES = 8  # pixels in a vector
FILL_CHUNK = 64  # pixels of a row in which a work-item looks for missing ones
# Indices of the counters of a filling, which are ints.
COUNTER_LEFT = 0  # pixels that are listed as missing, in frame and guard band
COUNTER_LEFT_INSIDE = 1  # those of them in the frame
COUNTER_FILLED = 2  # pixels that a sweep filled, in frame and guard band
COUNTER_FILLED_INSIDE = 3  # those of them in the frame
COUNTER_DONE = 4  # pixels that all sweeps so far filled

# Sum of time samples (kernels/blur/accumulate.cl).
SUMMED_PIXELS = 128  # pixels of a row that a work-item adds to the frame

# Sensor (kernels/sensor).
NOISE_LANES = 16  # pixels in a vector
SENSED_PIXELS = 128  # pixels of a row that a work-item reads out, whole vectors
LEAST_NORMAL = 30  # mean of electrons from which on a corrected normal distribution approximates their distribution
FEW_ELECTRONS = 80  # largest number of electrons if their mean is below LEAST_NORMAL: no random word gives more
# Streams of random words, and number of streams per plane.
SHOT_STREAM = 0
PATTERN_STREAM = 1
STREAMS = 2

# Scores of mean and median (kernels/inpainting/score.cl).
SCORED_COLUMNS = 128  # columns of a row that a work-item scores; more could overflow sums of 31 bits
SCORE_SUMS = 13  # number of sums of a work-item
CODE_LANES = 16  # 8-bit values in a vector

# Biharmonic filling (kernels/inpainting/biharmonic.cl).
DOT_SEGMENT = 256  # number of products of a dot product that a work-item sums

# Frequency-selective extrapolation (kernels/inpainting/fse.cl).
FSE_SIDE = 32  # px, side of a window
FSE_BLOCK = 2  # px, side of the block in the middle of a window, which is filled from the window
FSE_BEFORE = (FSE_SIDE - FSE_BLOCK) // 2  # px from the start of a window to its block, along an axis


def definitions() -> dict[str, int | float]:
    """All constants of this module by name, for the kernels' compiler."""
    return {name: value for name, value in globals().items() if name.isupper()}
