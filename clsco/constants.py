"""Constants shared by host and kernels, or by device and reference; kernels get them as -D options.

Every program is compiled with all of them (`clsco.opencl.program.build`), so each name has one meaning in all kernels.
A constant that only kernels use is a `#define` there; a value that differs from program to program is a feature.
"""

from __future__ import annotations

# Statistics of a frame, ints by their places: largest and smallest |R| as the bits of a float, and slots of sub-pixel
# sources that were taken at a time sample (kernels/common/geometry.clh, kernels/trace/trace.cl).
STATISTIC_LARGEST = 0
STATISTIC_SMALLEST = 1
STATISTIC_SLOTS = 2
STATISTIC_BEYOND = 3  # 1 where a hit is not where its object was predicted
STATISTIC_OUTSIDE = 4  # 1 where a source is not still that was predicted to be (kernels/trace/still.clh)
PLACE_NUMBERS = 10  # of the place of an object at a time sample
NARROW_IMAGE = 4  # px: surfaces whose images are less wide are small (kernels/trace/small.clh)
MOVING_MARGIN = 4  # px around what moves, within which sources are not still

# Bits of the feature CURVED (kernels/common/geometry.clh).
CURVED_FIELD = 1
CURVED_SPHERE = 2
CURVED_IMAGE = 4

# Coordinates of a surface that a texture lies on (clsco/optics/texture_mapping.py, kernels/trace/mapping.clh), and what
# is beyond an image.
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
CUBE_BORDER = 2  # texels of its neighbors around a face of a cube map, at each level: what a bicubic filter reads

# Footprints of pixels on textures that lie on surfaces (kernels/trace/footprint.clh).
FOOTPRINT_CELLS = 8  # along an axis of a pixel
LEAST_TEXELS = 2  # across the narrow side of a footprint, where the level is not the finest
CELL_TEXELS = 11  # along an axis of a cell, at most
MOST_CELL = 16  # texels along an axis of the image
NARROWEST = 64  # cells are at least one texel over this wide
MOST_SHEAR = 1  # texels along columns times those along rows that an axis of a cell has, at most
MOST_TEXELS = 24  # along an axis of a pixel: beyond, the level is a coarser one
BENT_CELLS = 32  # near a pole, where the footprint is bent, and cells are points
BENT_TEXELS = 0.75  # along an axis of such a cell
MOST_BENT_TEXELS = 64
DETAILED_TEXELS = 0.54  # per pixel, along the wider axis, from which on it may need sub-pixel sources
DETAILED_MOST = 4.5  # |R| in px, up to which
FINE_TEXELS = 1.17  # from which on a pixel is cut into smaller parts, up to a larger radius
FINE_MOST = 9.0
NEAR_FOCUS = 0.3  # |R| in px below which smaller parts are needed as well
# Squares of texels per pixel are compared with so many times the whole numbers, which images often have exactly:
# rounding must not decide.
APART = 1.17

# Merged sources (kernels/trace/merge.cl).
MERGED_SIDE = 3  # pixels along an axis that one source stands for, an odd number

# Visibility (kernels/common/visibility.clh).
LENS_CELLS = 8  # cells of the lens per half axis, where it is tested on a grid of its own
SHARED_PLACE = 10.0  # px per lens radius: of nearer occluders the parts of one pixel see different edges

# Tables of weights (kernels/common/psf.clh, kernels/blur/cpu).
TAP_LANES = 8  # floats in a vector of taps; rows of weights fill whole ones
POWERS = 4  # coefficients of a weight, a cubic in the position in its interval
TABLE_STEPS = 48  # intervals per octave of the radius, at least: the longest is so small a part of it
# Floats in the widest vector; intervals of which a kernel reads the coefficients of a tap together, from every
# TAP_LANES-th one on.
WIDE_LANES = 16

# Weights by chords (clsco/optics/chords.py, kernels/common/chords.clh).
LEAST_OPENING = 5e-4  # px, radius of a lens: light of less would be rounding

# Blur by `gather` (kernels/blur/cpu).
# Rows that a work-item owns: enough bands for several cores, and little overlap. It walks the sources that reach them
# in an order that counts from its first row, so strips of whole bands have the bits of the whole frame.
BAND = 64
COLUMN_STEP = 32  # columns of sources that a launch cut into pieces takes at least, with columns of sources
MOST_ITEMS = 256  # groups of sources of a column that are kept at a time, at most
ITEMS_BYTES = 2**18  # bytes that groups of sources of Gaussians take, unless few of them take more
MOST_ASIDE = 5  # columns of a block of Gaussians, at most

# Blur by `tiles` (kernels/blur/tiles.cl).
GROUP_COLUMNS = 16  # pixels of a work-group along a row
GROUP_ROWS = 8  # pixels of a work-group along a column

# Blur by `convolve` (kernels/blur/convolve.cl).
CONVOLVED_ROWS = 32  # rows of the frame that a work-item makes
CONVOLVED_COLUMNS = 64  # columns of the frame that a work-item makes, whole vectors of WIDE_LANES
TILES_ABREAST = 8  # work-items side by side before those below, so that what they read is still in the cache
LONGEST_RUN = 8  # weights of a run, which a kernel keeps in registers
DROPPED_BITS = 26  # lower bits of a sum over a disc that sums of 32 bits leave out

# Layered occlusion (kernels/layered/layered.cl).
DISCONTINUITY = 1.0  # px: over the lens two points shift by |R1 - R2| against each other; less hides no pixel
LAYER_BIN = 0.25  # px: depth layers end at multiples of it
NO_SEED = 1 << 14  # px: farther than any blur reaches
DISCONTINUITY_CLASSES = 10  # of sizes: beyond 1, 2, 4 ... times the least discontinuity
REACH_PIXELS = 64  # pixels of a row for which a work-item finds the nearest edge
SEED_COLUMNS = 16  # columns that a work-item walks down
PUSH_PIXELS = 4  # pixels of a coarser level that a work-item makes

# Forward warp (kernels/warp/warp.cl).
OWNED_PIXELS = 64  # sources of a row that a work-item moves, where work-items own bands of the image
WIDEST_GAP = 3  # px on each side of a gap in a surface that has grown, to four times its size at most
NO_WINNER = 2**31 - 1  # instead of the number of a source, in a pixel where none comes

# Filling of missing pixels (kernels/inpainting/fill.cl, fill_mean_median.cl, mean_median.cl).
FILL_LANES = 8  # pixels of a vector
FILL_CHUNK = 64  # pixels per work-item where it counts, so that atomics are rare
# Counters of a filling, ints by their places: entries of the list of missing pixels, those of them in the frame, what a
# sweep has filled, in the frame, and entries of the list of what all sweeps have filled.
COUNTER_LEFT = 0
COUNTER_LEFT_INSIDE = 1
COUNTER_FILLED = 2
COUNTER_FILLED_INSIDE = 3
COUNTER_DONE = 4

# Sum of time samples (kernels/blur/accumulate.cl).
SUMMED_PIXELS = 128  # pixels of a row that a work-item adds to the frame

# Sensor (kernels/sensor).
NOISE_LANES = 16  # pixels of a vector
SENSED_PIXELS = 128  # pixels of a row that a work-item reads out, whole vectors
LEAST_NORMAL = 30  # mean electrons, from which on their distribution is a corrected normal one
FEW_ELECTRONS = 80  # counts of smaller means, beyond any that random words give
# Streams of random words, and how many each plane has.
SHOT_STREAM = 0
PATTERN_STREAM = 1
STREAMS = 2

# Scores of mean and median (kernels/inpainting/score.cl).
SCORED_COLUMNS = 128  # columns of a row that a work-item scores: no more may be summed up in 31 bits
SCORE_SUMS = 13  # sums of a work-item
CODE_LANES = 16  # values of 8 bits in a vector

# Biharmonic filling (kernels/inpainting/biharmonic.cl).
DOT_SEGMENT = 256  # products of a dot product that a work-item adds up

# Frequency-selective extrapolation (kernels/inpainting/fse.cl).
FSE_SIDE = 32  # px of a window, along an axis
FSE_BLOCK = 2  # px of the block in the middle of a window that is filled from it, along an axis
FSE_BEFORE = (FSE_SIDE - FSE_BLOCK) // 2  # px of a window before its block, along an axis


def definitions() -> dict[str, int | float]:
    """All constants of this module by name, for the kernels' compiler."""
    return {name: value for name, value in globals().items() if name.isupper()}
