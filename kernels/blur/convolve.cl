// Blur with one radius for all sources and no tilt: a plain convolution, I(x) = sum_d w(d) L(x - d). Host:
// clsco/passes/convolve.py, which picks it for frames of one blur radius.
//
// A PSF is the sum of two parts (clsco/optics/stencil.py). The first is constant on a union of rectangles inside of a
// disc: its light comes from a table of integer sums over rectangles (sum_across, sum_down), where what is added and
// subtracted again cancels to the last bit, and no sum depends on where a strip begins. All other weights are in runs
// down a column, which columns -dx and dx of the PSF share; a run keeps its weights, and the sources that they meet, in
// registers while it moves down the image. Separable Gaussians are two such PSFs, one after the other. Shared columns
// and runs took R6 from 7.2 to 2.5 ns per pixel, sums over rectangles R20 from 39 to 11 and R60 from 250 to 29
// (docs/lessons.md).

#include "common/geometry.clh"

#define CONVOLVED_VECTORS (CONVOLVED_COLUMNS / WIDE_LANES)  // in each row of a work-item
#define RUNS_IN_ONE_SUM 32  // runs that are added up in one float

// Types of sums of 64 bits, or of 32 without the lowest bits. Unsigned, as sums may overflow; differences do not.
#if WIDE_SUMS
#define LOWER_BITS 0
typedef ulong sum_t;
typedef ulong16 sums_t;
#define LOAD_SUMS(p) LOAD(ulong, 16, p)
#define STORE_SUMS(v, p) STORE(ulong, 16, v, p)
#define AS_SUMS(v) as_ulong16(v)
#define AS_RADIANCE(v) CONVERT16(float, as_long16(v))
#else
#define LOWER_BITS DROPPED_BITS
typedef uint sum_t;
typedef uint16 sums_t;
#define LOAD_SUMS(p) LOAD(uint, 16, p)
#define STORE_SUMS(v, p) STORE(uint, 16, v, p)
#define AS_SUMS(v) CONVERT16(uint, v)
#define AS_RADIANCE(v) CONVERT16(float, as_int16(v))
#endif
#define FLOATS(p) LOAD(float, 16, p)

// Contraction changes no bit from run to run.
#pragma OPENCL FP_CONTRACT ON

// Sums along each row: radiance of a pixel and of all pixels to the left of it, in units of 1 / scale. Sums of 32 bits
// omit lower bits: sums are rounded and not pixels, so that no error adds up along a row.
__kernel void sum_across(const int height, const int width, __global const float *value, const int start,
                         const float scale, __global sum_t *sums) {
    const int y = get_global_id(0);
    if (y >= height)
        return;
    __global const float *line = value + start + y * width;
    long before = 0;
    int x = 0;
    for (; x + WIDE_LANES <= width; x += WIDE_LANES) {
        long16 sum = running_sums(CONVERT16(long, FLOATS(line + x) * scale));
        sum += before;
        before = sum.sf;
        STORE_SUMS(AS_SUMS(sum >> LOWER_BITS), sums + y * width + x);
    }
    for (; x < width; ++x) {
        before += (long)(line[x] * scale);
        sums[y * width + x] = (sum_t)(before >> LOWER_BITS);
    }
}

// Sums of these down each column: over all pixels up to the row and the column of a pixel.
__kernel void sum_down(const int height, const int width, __global sum_t *sums) {
    const int x = get_global_id(0) * CONVOLVED_VECTORS * WIDE_LANES;
    if (x >= width)
        return;
    const int vectors = MIN(CONVOLVED_VECTORS, (width - x) / WIDE_LANES);
    sums_t sum[CONVOLVED_VECTORS];
    #pragma unroll
    for (int v = 0; v < CONVOLVED_VECTORS; ++v)
        sum[v] = 0;
    for (int y = 0; y < height; ++y) {
        #pragma unroll
        for (int v = 0; v < CONVOLVED_VECTORS; ++v)
            if (v < vectors) {
                sum[v] += LOAD_SUMS(sums + y * width + x + v * WIDE_LANES);
                STORE_SUMS(sum[v], sums + y * width + x + v * WIDE_LANES);
            }
    }
    if (vectors == CONVOLVED_VECTORS)
        return;
    for (int y = 1; y < height; ++y)  // columns after the last whole vector
        for (int column = x + vectors * WIDE_LANES; column < width; ++column)
            sums[y * width + column] += sums[(y - 1) * width + column];
}

// Adds a run of `count` weights (a constant at compile time) to a vector in each of `rows` rows. left, right: the
// sources that the first weight meets in the first row, dx columns to either side. Loops end at a constant, or the
// compiler keeps the arrays in memory.
INLINE void add_run(const int count, __global const float *weights, __global const float *left,
                    __global const float *right, const int pitch, int rows, float16 *part) {
    float weight[LONGEST_RUN];
    float16 both[LONGEST_RUN];
    #pragma unroll
    for (int k = 0; k < LONGEST_RUN; ++k)
        if (k < count)
            weight[k] = weights[k];
    #pragma unroll
    for (int k = 0; k < LONGEST_RUN - 1; ++k)
        if (k < count - 1)
            both[k + 1] = FLOATS(left + k * pitch) + FLOATS(right + k * pitch);
    left += (count - 1) * pitch;
    right += (count - 1) * pitch;
    for (int r = 0; r < rows; ++r) {
        #pragma unroll
        for (int k = 0; k < LONGEST_RUN - 1; ++k)
            if (k < count - 1)
                both[k] = both[k + 1];
        both[count - 1] = FLOATS(left + r * pitch) + FLOATS(right + r * pitch);
        float16 sum = part[r];
        #pragma unroll
        for (int k = 0; k < LONGEST_RUN; ++k)
            if (k < count)
                sum += both[k] * weight[k];
        part[r] = sum;
    }
}

// Radiance of the rectangles for one row of a tile. pairs: positions (dy, dx) of a sum to add and of a sum to subtract.
INLINE void add_rectangles(__global const int4 *pairs, int count, __global sum_t *sums, int pitch, float share,
                           float16 *row) {
    sums_t inside[CONVOLVED_VECTORS];
    #pragma unroll
    for (int v = 0; v < CONVOLVED_VECTORS; ++v)
        inside[v] = 0;
    for (int i = 0; i < count; ++i) {
        const int4 pair = pairs[i];
        __global sum_t *plus = sums + pair.x * pitch + pair.y, *minus = sums + pair.z * pitch + pair.w;
        #pragma unroll
        for (int v = 0; v < CONVOLVED_VECTORS; ++v)
            inside[v] += LOAD_SUMS(plus + v * WIDE_LANES) - LOAD_SUMS(minus + v * WIDE_LANES);
    }
    #pragma unroll
    for (int v = 0; v < CONVOLVED_VECTORS; ++v)
        row[v * CONVOLVED_ROWS] = AS_RADIANCE(inside[v]) * share;
}

// Prefetches the first reads of the next tile to the right, which otherwise wait for memory line by line.
INLINE void prefetch_tile(__global const float *value, __global const sum_t *sums, bool summed, int pitch, int rows,
                          int vectors) {
    for (int y = 0; y < rows; ++y)
        for (int v = 0; v < vectors; ++v) {
            *(volatile __global const float *)(value + y * pitch + v * WIDE_LANES);
            if (summed)
                *(volatile __global const sum_t *)(sums + y * pitch + v * WIDE_LANES);
        }
}

// Each work-item makes CONVOLVED_ROWS rows of CONVOLVED_VECTORS vectors of a frame (rows, columns).
//   value   float, rows of `pitch`, pixel (0, 0) at start + origin; has all pixels within reach of the PSF, and
//           WIDE_LANES more columns
//   runs    (dx, first dy, number of weights, place of the first in `weights`)
//   sums    of sum_down, pixel (0, 0) at origin; pairs: see add_rectangles; share: radiance of one unit
//   target  pixel (0, 0) at target_start, rows of target_pitch.
//   half_width, half_height: reach of the runs, px
__kernel void convolve(const int rows, const int columns, __global const float *value, const int start,
                       const int origin, const int pitch, __global const int4 *runs, const int run_count,
                       __global const float *weights, __global sum_t *sums, __global const int4 *pairs,
                       const int pair_count, const float share, const int half_width, const int half_height,
                       __global float *target, const int target_start, const int target_pitch) {
    const int first = get_global_id(1) * CONVOLVED_ROWS, tile = get_global_id(2) * TILES_ABREAST + get_global_id(0);
    const int x0 = tile * CONVOLVED_VECTORS * WIDE_LANES;
    if (get_global_id(0) >= TILES_ABREAST || first >= rows || x0 >= columns)
        return;
    const int end = MIN(rows, first + CONVOLVED_ROWS), next = x0 + CONVOLVED_VECTORS * WIDE_LANES;
    const int ahead = origin + (first + half_height) * pitch + next + half_width;
    prefetch_tile(value + start + ahead, sums + ahead, pair_count > 0, pitch, end - first,
            MIN(CONVOLVED_VECTORS, (columns - next) / WIDE_LANES));
    float16 sum[CONVOLVED_VECTORS * CONVOLVED_ROWS];
    for (int y = first; y < end; ++y)
        add_rectangles(pairs, pair_count, sums + origin + y * pitch + x0, pitch, share, sum + (y - first));
    for (int v = 0; v < CONVOLVED_VECTORS && x0 + v * WIDE_LANES < columns; ++v) {
        const int x = x0 + v * WIDE_LANES;
        float16 *own = sum + v * CONVOLVED_ROWS;
        for (int from = 0; from < run_count; from += RUNS_IN_ONE_SUM) {
            float16 part[CONVOLVED_ROWS];
            for (int r = 0; r < CONVOLVED_ROWS; ++r)
                part[r] = 0;
            for (int i = from; i < MIN(from + RUNS_IN_ONE_SUM, run_count); ++i) {
                const int4 run = runs[i];
                __global const float *w = weights + run.w;
                __global const float *left = value + start + origin + (first + run.y) * pitch + x - run.x;
                __global const float *right = left + 2 * run.x;
                switch (run.z) {
                case 1: add_run(1, w, left, right, pitch, end - first, part); break;
                case 2: add_run(2, w, left, right, pitch, end - first, part); break;
                case 3: add_run(3, w, left, right, pitch, end - first, part); break;
                case 4: add_run(4, w, left, right, pitch, end - first, part); break;
                case 5: add_run(5, w, left, right, pitch, end - first, part); break;
                case 6: add_run(6, w, left, right, pitch, end - first, part); break;
                case 7: add_run(7, w, left, right, pitch, end - first, part); break;
                default: add_run(8, w, left, right, pitch, end - first, part);
                }
            }
            for (int r = 0; r < end - first; ++r)
                own[r] += part[r];
        }
        for (int y = first; y < end; ++y)
            STORE(float, 16, own[y - first], target + target_start + y * target_pitch + x);
    }
}

#pragma OPENCL FP_CONTRACT OFF
