// Missing pixels: scores of mean and median of neighbors as estimates of known pixels (thesis, chapter 5). Twin:
// clsco/reference/inpainting/score.py.

#include "common/geometry.clh"
#include "inpainting/estimate.clh"

#if FILL_MEAN_MEDIAN

// Places of WIDTH values: of one channel of as many pixels, or with IMAGE of pixels whose channels are side by side.
#if IMAGE
#define STEP CHANNELS  // from pixel to pixel
#define PLACE(c, y, x) (((y) * width + (x)) * CHANNELS + (c) * WIDTH)
#define PIXEL(c, lane) (((c) * WIDTH + (lane)) / CHANNELS)
#else
#define STEP 1
#define PLACE(c, y, x) (((c) * grid.height + (y)) * width + (x))
#define PIXEL(c, lane) (lane)
#endif

// Types of vectors of values, of their exact differences, and of sums of products; PRODUCTS adds those in one lane.
#if CODES  // of 8 bits
#define WIDTH CODE_LANES
typedef uchar element_t;
typedef uchar16 values_t;
typedef short part_t;
typedef short16 parts_t;
typedef int8 sums_t;
typedef uchar16 whole_t;
#define ELEMENTS(p) LOAD(uchar, 16, p)
#define WHOLE_AT(p) LOAD(uchar, 16, p)
#define WHOLE(v) SHORTS(v)
#define STEPS ((long)(scale * scale))  // units in a product of codes
#define PRODUCTS(a, b) PAIRED_PRODUCTS(a, b)
#else
#define WIDTH 8
typedef float element_t;
typedef float8 values_t;
typedef uchar8 whole_t;
#define ELEMENTS(p) LOAD(float, 8, p)
#define WHOLE_AT(p) LOAD(uchar, 8, p)
#if HAS_FP64
typedef double part_t;
typedef double8 parts_t;
// Adding 1.5 x 2^52 and subtracting it rounds to the nearest integer, as rint does.
#define ROUNDER 6755399441055744.0
#define WHOLE(v) ((parts_t)EACH((v) * scale) + ROUNDER - ROUNDER)
#else
typedef long part_t;
typedef long8 parts_t;
#define WHOLE(v) convert_long8_rte((v) * scale)
#endif
typedef parts_t sums_t;
#define PRODUCTS(a, b) ((a) * (b))
#define STEPS 1
#endif

// Stage 0: sums over all pixels of a row with eight valid neighbors, and over all channels, from which the host
// computes the squared errors of mean and median of all 163 subsets of k = 4..8 neighbors. With d the sorted
// differences of the neighbors to the center and C binomial coefficients, the subsets of k have
//   of means    (C(6, k-2) (sum d)^2 + C(6, k-1) sum d^2) / k^2,
//   of medians  for odd k = 2 m + 1  C(i, m) C(7-i, m) times d_i^2, for all i,
//               for even k = 2 m + 2  C(i, m) C(7-j, m) times ((d_i + d_j) / 2)^2, for all i < j.
// Values times `scale` are first rounded to integers that differ by 2^16 at most, so that sums are exact in any order;
// CODES are integers already. One work-item per SCORED_COLUMNS columns, WIDTH values at once. In: value (CHANNELS,
// height, width), with IMAGE (height, width, CHANNELS); valid (height, width); both must be readable WIDTH pixels
// beyond their end. Out: sums (height, segments, SCORE_SUMS): d_i^2 for i = 0..7; (sum d)^2; C(i, m) C(7-j, m) d_i d_j
// over i < j for m = 1, 2, 3; number of pixels times channels.
__kernel void score_mean_median(const grid_t grid, const float scale, __global const element_t *value,
                                __global const uchar *valid, __global long *sums) {
    const int width = grid.width, segments = (width + SCORED_COLUMNS - 1) / SCORED_COLUMNS;
    const int segment = get_global_id(0) % segments, y = get_global_id(0) / segments;
    if (y >= grid.height)
        return;
    const int begin = MAX(segment * SCORED_COLUMNS, 1), end = MIN((segment + 1) * SCORED_COLUMNS, width - 1);
    sums_t sum[SCORE_SUMS] = {0};
    for (int x = begin; x < end && y > 0 && y < grid.height - 1; x += WIDTH) {
        const int at = y * width + x;
        whole_t whole = WHOLE_AT(valid + at);
        for (int k = 0; k < 8; ++k)
            whole &= WHOLE_AT(valid + at + NEIGHBOR_Y[k] * width + NEIGHBOR_X[k]);
        for (int lane = end - x; lane < WIDTH; ++lane)
            ((uchar *)&whole)[lane] = 0;
        UNROLL
        for (int c = 0; c < CHANNELS; ++c) {
            __global const element_t *center = value + PLACE(c, y, x);
            parts_t use;
            UNROLL
            for (int lane = 0; lane < WIDTH; ++lane)
                ((part_t *)&use)[lane] = ((const uchar *)&whole)[PIXEL(c, lane)];
            values_t near[8];
            UNROLL
            for (int k = 0; k < 8; ++k)
                near[k] = ELEMENTS(center + (NEIGHBOR_Y[k] * width + NEIGHBOR_X[k]) * STEP);
            SORT(values_t, near)
            const values_t middle = ELEMENTS(center);
            parts_t d[8], total = 0, above = 0;
            UNROLL
            for (int k = 0; k < 8; ++k) {
                d[k] = (WHOLE(near[k]) - WHOLE(middle)) * use;
                total += d[k];
                sum[k] += PRODUCTS(d[k], d[k]);
            }
            sum[8] += PRODUCTS(total, total);
            UNROLL
            for (int i = 5; i > 0; --i) {
                above += (part_t)(6 - i) * d[i + 1];
                sum[9] += PRODUCTS((part_t)i * d[i], above);
            }
            above = 0;
            UNROLL
            for (int i = 4; i > 1; --i) {
                above += (part_t)((6 - i) * (5 - i) / 2) * d[i + 1];
                sum[10] += PRODUCTS((part_t)(i * (i - 1) / 2) * d[i], above);
            }
            sum[11] += PRODUCTS(d[3], d[4]);
            sum[12] += PRODUCTS(use, use);
        }
    }
    for (int k = 0; k < SCORE_SUMS; ++k) {
        const sums_t v = sum[k];
        const long all = (long)(((v.s0 + v.s1) + (v.s2 + v.s3)) + ((v.s4 + v.s5) + (v.s6 + v.s7)));
        sums[SCORE_SUMS * get_global_id(0) + k] = k < 12 ? all * STEPS : all;
    }
}
#endif
