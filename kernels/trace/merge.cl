// Merges partly hidden sources of wide blurs: one source stands for MERGED_SIDE x MERGED_SIDE that show one surface.
// For frames with a tolerance (clsco/plan/approximation.py has the error); not in the reference. Host:
// clsco/passes/trace.py.
//
//     sum over the block of L_s w(x - x_s; R) V_s  ->  (sum of L_s) w(x - middle; R') V,   R'^2 = R^2 - added
//
// R' keeps the variance of the light, and V has edges as soft as the block is wide. The error that remains is that
// discs on a lattice do not add up to a plane: 2 H(1 / MERGED_SIDE) of the radiance, H their transfer function. The
// time of spans is proportional to the number of hidden sources.

#include "trace/trace.cl"

#if MERGED
#define REACH (MERGED_SIDE / 2)
#define MERGED_CHANGE (real)0.03  // largest relative difference of R from the middle to the others

// True if the middle of a block of pixels can stand for all of them: sources of one surface, of nearly one radius.
static bool is_alike(const grid_t grid, const lens_t lens, __global const real *depth, __global const uchar *label,
                     __global const float *source, int x, int y, real radius)
{
    const int middle = y * grid.width + x, plane = grid.height * grid.width;
    for (int i = -REACH; i <= REACH; ++i)
        for (int j = -REACH; j <= REACH; ++j) {
            const int at = middle + i * grid.width + j, mark = as_int(MARKS(source, plane)[at]);
            if (source[at] < 0 || (mark != WHOLE && mark != PARTLY_OCCLUDED) || label[at] != label[middle])
                return false;
            const real own = grid_radius(grid, lens, at, depth[at]);
            if (!(ABS(own - radius) <= MERGED_CHANGE * ABS(radius)))
                return false;
        }
    return true;
}

// Merges each block of MERGED_SIDE x MERGED_SIDE alike sources whose middle is partly hidden and blurred by `least` px
// or more: the middle source stands for all, with a radius that keeps the variance of their light. added: variance of
// their positions, in units of that of a blur of 1 px. Blocks are aligned to the frame, whatever the strip. In and out:
// source.
__kernel void merge(const grid_t grid, const lens_t lens, const psf_t psf, __global const real *depth,
                    __global const uchar *label, const float least, const float added, __global float *source)
{
    const int first = FRAME_ROW(grid, 0) % MERGED_SIDE, start = first ? (first < 0 ? -first : MERGED_SIDE - first) : 0;
    const int x = get_global_id(0) * MERGED_SIDE + REACH, y = start + get_global_id(1) * MERGED_SIDE + REACH;
    if (x + REACH >= grid.width || y + REACH >= grid.height)
        return;
    const int middle = y * grid.width + x, plane = grid.height * grid.width;
    __global float *marks = MARKS(source, plane);
    if (as_int(marks[middle]) != PARTLY_OCCLUDED)
        return;
    const real radius = grid_radius(grid, lens, middle, depth[middle]);
    if (!(ABS(radius) >= least) || !is_alike(grid, lens, depth, label, source, x, y, radius))
        return;
    for (int i = -REACH; i <= REACH; ++i)
        for (int j = -REACH; j <= REACH; ++j)
            source[middle + i * grid.width + j] = -1;
    const real smaller = SQRT(radius * radius - added);
    source[middle] = table_coordinate(psf, radius < 0 ? -smaller : smaller, 0);
    marks[middle] = as_float(MERGED_SOURCES);
}
#endif
