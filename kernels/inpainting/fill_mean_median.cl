// Missing pixels of warped frames: mean/median filling (thesis, chapter 5). fill.cl has the planes and the lists;
// mean_median.cl does the same to images with a mask. Twin: clsco/reference/inpainting/fill_mean_median.py.

#include "common/geometry.clh"

#if FILL_MEAN_MEDIAN
// FILL_LANES pixels of a list, with the neighbors that they may be filled from; minimum: 0 to ignore `far`.
static around_t look_around(const grid_t grid, __global const uchar *valid, __global const int *list, int entries,
                            int median_wins
#if FILL_FAR
                            , __global const real *w, __global const float *far, int minimum
#endif
)
{
    around_t around;
    for (int lane = 0; lane < FILL_LANES; ++lane) {
        // The last vector is filled up with the last pixel.
        const int at = list[MIN((int)get_global_id(0) * FILL_LANES + lane, entries - 1)];
        const int x = at % grid.width, y = at / grid.width;
        const bool inner = x > 0 && y > 0 && x < grid.width - 1 && y < grid.height - 1;
        int bits = 0, count = 0;
#if FILL_FAR
        const float bound = minimum ? far[at] : INFINITY;
#endif
        UNROLL
        for (int k = 0; k < 8; ++k) {
            const int i = y + NEIGHBOR_Y[k], j = x + NEIGHBOR_X[k], from = i * grid.width + j;
            const bool inside = inner || (i >= 0 && i < grid.height && j >= 0 && j < grid.width);
            const int known = inside ? serves(valid, w, from, bound) : 0;
            bits |= known << k;
            count += known;
            around.from[lane][k] = from;
        }
        around.at[lane] = at;
        use_neighbors(&around, lane, bits, count, median_wins);
    }
    return around;
}

// Writes the estimates of all planes, except for lanes with fewer than `minimum` neighbors.
static void write_estimates(const grid_t grid, const lens_t lens, const around_t around, int minimum,
                            __global const float *value_in, __global const real *w_in, __global float *value_out,
                            __global real *w_out, __global real *coc)
{
    real8 near[8], result;
    const real *count = (const real *)&around.count, *found = (const real *)&result;
    for (int c = 0; c < CHANNELS; ++c) {
        const int plane = c * grid.height * grid.width;
        NEAR(near, value_in[plane + from])
        estimate(&around, near, &result);
        for (int lane = 0; lane < FILL_LANES; ++lane)
            if (count[lane] >= minimum)
                value_out[plane + around.at[lane]] = (float)found[lane];
    }
    NEAR(near, w_in[from])
    estimate(&around, near, &result);
    for (int lane = 0; lane < FILL_LANES; ++lane)
        if (count[lane] >= minimum) {
            w_out[around.at[lane]] = found[lane];
            coc[around.at[lane]] = grid_radius(grid, lens, around.at[lane], found[lane]);
        }
}

#if FILL_FAR
#define BOUNDED_BY(w, far, minimum) , w, far, minimum
#else
#define BOUNDED_BY(w, far, minimum)
#endif

// Stage 1: one sweep, FILL_LANES entries per work-item. Bit k of median_wins: with k neighbors the median is the better
// estimator. A pixel needs `minimum` neighbors; 0, with FILL_FAR, stands for one at any depth. It gets the object of
// its first neighbor. In: list of `count`, valid, far. In and out: value, w, coc, status, object.
__kernel void fill_mean_median(const grid_t grid, const lens_t lens, __global const int *list, const int count,
                               const int median_wins, const int minimum,
#if FILL_FAR
                               __global const float *far,
#endif
                               __global const uchar *valid, __global float *value, __global real *w,
                               __global real *coc, __global uchar *status
#if SEVERAL
                               , __global uchar *object
#endif
)
{
    if (get_global_id(0) * FILL_LANES >= count)
        return;
    const around_t around = look_around(grid, valid, list, count, median_wins BOUNDED_BY(w, far, minimum));
    const int least = MAX(minimum, 1);
    write_estimates(grid, lens, around, least, value, w, value, w, coc);
    for (int lane = 0; lane < FILL_LANES; ++lane) {
        if (((const real *)&around.count)[lane] < least)
            continue;
        status[around.at[lane]] = 1;
#if SEVERAL
        int k = 0;
        while (!(around.bits[lane] >> k & 1))
            ++k;
        object[around.at[lane]] = object[around.from[lane][k]];
#endif
    }
}

// Stage 2: one round of the 3x3 median without the center over the filled pixels, FILL_LANES entries per work-item; a
// pixel without usable neighbors stays. In: done, list of `count`; valid, far; value_in, w_in, which hold all pixels.
// Out: the same of the filled pixels, coc.
__kernel void smooth_median(const grid_t grid, const lens_t lens, __global const int *done, const int count,
#if FILL_FAR
                            __global const float *far,
#endif
                            __global const uchar *valid, __global const float *value_in, __global const real *w_in,
                            __global float *value_out, __global real *w_out, __global real *coc)
{
    if (get_global_id(0) * FILL_LANES >= count)
        return;
    const around_t around = look_around(grid, valid, done, count, ~0 BOUNDED_BY(w_in, far, 1));
    write_estimates(grid, lens, around, 1, value_in, w_in, value_out, w_out, coc);
#if FILL_FAR
    for (int lane = 0; lane < FILL_LANES; ++lane) {
        const int at = around.at[lane];
        for (int c = 0; c < CHANNELS && !around.bits[lane]; ++c)
            value_out[c * grid.height * grid.width + at] = value_in[c * grid.height * grid.width + at];
        if (!around.bits[lane])
            w_out[at] = w_in[at];
    }
#endif
}
#endif
