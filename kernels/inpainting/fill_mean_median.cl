// Missing pixels of warped frames: mean/median filling (thesis, chapter 5). fill.cl has the planes and the lists;
// mean_median.cl does the same to images with a mask. Twin: clsco/reference/inpainting/fill_mean_median.py.

#include "common/geometry.clh"
#include "inpainting/estimate.clh"

#if FILL_MEAN_MEDIAN
// FILL_LANES pixels `at`, and the neighbors that they may be filled from: bit k of `bits` is neighbor k.
typedef struct {
    int at[FILL_LANES], from[FILL_LANES][8], bits[FILL_LANES];
    int8 count;
} around_t;

// Looks around pixels of a list; minimum: 0 to ignore `far`.
static around_t look_around(const grid_t grid, __global const uchar *valid, __global const int *list, int entries,
                            __global const real *w, __global const float *far, int minimum) {
    around_t around;
    for (int lane = 0; lane < FILL_LANES; ++lane) {
        // The last vector is filled up with the last pixel.
        const int at = list[MIN((int)get_global_id(0) * FILL_LANES + lane, entries - 1)];
        const int x = at % grid.width, y = at / grid.width;
        const bool inner = x > 0 && y > 0 && x < grid.width - 1 && y < grid.height - 1;
        const float bound = bound_of(far, at, minimum);
        int bits = 0, count = 0;
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
        around.bits[lane] = bits;
        ((int *)&around.count)[lane] = count;
    }
    return around;
}

// Sets `near` to the values of the neighbors of all lanes; infinity for those that are not used.
#define GATHER_AROUND(value_at_from) \
    for (int lane = 0; lane < FILL_LANES; ++lane) \
        for (int k = 0; k < 8; ++k) { \
            const int from = around.from[lane][k]; \
            ((real *)(near + k))[lane] = around.bits[lane] >> k & 1 ? (value_at_from) : (real)INFINITY; \
        }

// Writes the estimates of all planes; lanes with fewer than `minimum` neighbors get what they have.
static void write_estimates(const grid_t grid, const lens_t lens, const around_t around, int median_wins, int minimum,
                            __global const float *value_in, __global const real *w_in, __global float *value_out,
                            __global real *w_out, __global real *coc) {
    const estimator_t estimator = choose_estimator(around.count, median_wins);
    const int *count = (const int *)&around.count;
    real8 near[8], result;
    const real *estimates = (const real *)&result;
    for (int c = 0; c < CHANNELS; ++c) {
        const int plane = c * grid.height * grid.width;
        GATHER_AROUND(value_in[plane + from])
        result = estimate(&estimator, near);
        for (int lane = 0; lane < FILL_LANES; ++lane) {
            const int at = plane + around.at[lane];
            value_out[at] = count[lane] < minimum ? value_in[at] : (float)estimates[lane];
        }
    }
    GATHER_AROUND(w_in[from])
    result = estimate(&estimator, near);
    for (int lane = 0; lane < FILL_LANES; ++lane) {
        const int at = around.at[lane];
        w_out[at] = count[lane] < minimum ? w_in[at] : estimates[lane];
        if (count[lane] >= minimum)
            coc[at] = grid_radius(grid, lens, at, estimates[lane]);
    }
}

// Stage 1: one sweep, FILL_LANES entries per work-item. Bit k of median_wins: with k neighbors the median is the better
// estimator. A pixel needs `minimum` neighbors; 0, with FILL_FAR, stands for one at any depth. It gets the object of
// its first neighbor. In: list of `count`, valid, far. In and out: value, w, coc, status, object.
__kernel void fill_mean_median(const grid_t grid, const lens_t lens, __global const int *list, const int count,
                               const int median_wins, const int minimum, __global const float *far,
                               __global const uchar *valid, __global float *value, __global real *w,
                               __global real *coc, __global uchar *status, __global uchar *object) {
    if (get_global_id(0) * FILL_LANES >= count)
        return;
    const around_t around = look_around(grid, valid, list, count, w, far, minimum);
    const int least = MAX(minimum, 1);
    write_estimates(grid, lens, around, median_wins, least, value, w, value, w, coc);
    for (int lane = 0; lane < FILL_LANES; ++lane) {
        if (((const int *)&around.count)[lane] < least)
            continue;
        status[around.at[lane]] = 1;
        int k = 0;
        while (!(around.bits[lane] >> k & 1))
            ++k;
        if (SEVERAL)
            object[around.at[lane]] = object[around.from[lane][k]];
    }
}

// Stage 2: one round of the 3x3 median without the center over the filled pixels, FILL_LANES entries per work-item; a
// pixel without usable neighbors stays. In: done, list of `count`; valid, far; value_in, w_in, which hold all pixels.
// Out: the same of the filled pixels, coc.
__kernel void smooth_median(const grid_t grid, const lens_t lens, __global const int *done, const int count,
                            __global const float *far, __global const uchar *valid, __global const float *value_in,
                            __global const real *w_in, __global float *value_out, __global real *w_out,
                            __global real *coc) {
    if (get_global_id(0) * FILL_LANES >= count)
        return;
    const around_t around = look_around(grid, valid, done, count, w_in, far, 1);
    write_estimates(grid, lens, around, ~0, 1, value_in, w_in, value_out, w_out, coc);
}
#endif
