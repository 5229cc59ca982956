// Sheets of layered occlusion: depth layers with radiance, radius and coverage in all pixels, by push-pull.
// Twin: clsco/reference/layered/layered.py. Host: clsco/passes/clusters.py. For the planes see layered.cl.

#include "common/geometry.clh"
#include "layered/tiles.clh"

#pragma OPENCL FP_CONTRACT ON  // as where radiance is summed in the blur

#define RADIUS CHANNELS  // planes of the pyramid
#define KNOWN (CHANNELS + 1)
#define COVERAGE (CHANNELS + 2)
#define SETTLED (CHANNELS + 3)
#define PLANES (CHANNELS + 4)
#define PULLED 0.015625f  // weight of pulled radii beside known ones, so that a slanted surface goes on where it ends
#define GAIN 4.0f         // steepness of a hidden outline

// A pixel's part of a sheet. light: its radiance, planes apart, to be multiplied by scale; share: its coverage;
// known: weight of its radiance and radius; settled: 1 if its coverage is known, 0 behind a nearer layer; whole: the
// pixel shows one surface alone.
typedef struct {
    __global const float *light;
    float scale, share, known, settled;
    bool whole;
} part_t;

// The part of sheet `which` in pixel `at`.
static part_t part_of(int which, int at, int plane, __global const float *value, __global const uchar *layer,
                      __global const uchar *sides, __global const float *mixed) {
    const int own = layer[at], near = sides[at] >> 4, far = sides[at] & 15;
    const float alpha = own == which ? alpha_of(value, plane, at) : 0;
    const bool whole = near != own && alpha_of(value, plane, at) >= OPAQUE;
    part_t part = {value + at, 1, alpha, alpha, own == 0 || own >= which, whole};
    if (near == which) {
        part.light = mixed + at;
        part.share = part.scale = mixed[2 * CHANNELS * plane + at];
    } else if (own == which && far == which)
        part.light = mixed + CHANNELS * plane + at;
    return part;
}

// Means of a pixel of the pyramid, `plane` apart. known, settled: weights of the pixels in the sums.
static void put_means(float known, float settled, const float *sum, __global float *to, int plane) {
    for (int c = 0; c <= RADIUS; ++c)
        to[c * plane] = known > 0 ? sum[c] / known : 0;
    to[KNOWN * plane] = known > 0;
    to[COVERAGE * plane] = settled > 0 ? sum[COVERAGE] / settled : 0;
    to[SETTLED * plane] = settled > 0;
}

// LAYER_TILE / 2 pixels of a row of the second level (rows, columns) of the pyramid of sheet `which`: means of 2 x 2
// pixels, 0 farther than `near` px from a marked tile. In: all planes of the image, to_marked. Out: pyramid.
__kernel void open_sheet(const grid_t grid, const int which, const int rows, const int columns, const int near,
                         __global const int *to_marked, __global const float *value, __global const real *coc,
                         __global const uchar *layer, __global const uchar *sides, __global const float *mixed,
                         __global float *pyramid) {
    const int begin = get_global_id(0) * LAYER_TILE / 2, y = get_global_id(1), plane = grid.width * grid.height;
    if (begin >= columns || y >= rows)
        return;
    const int end = MIN(begin + LAYER_TILE / 2, columns);
    const bool some = to_marked[tile_of(grid, 2 * begin, 2 * y)] <= near;
    for (int c = 0; c < PLANES && !some; ++c)
        for (int x = begin; x < end; ++x)
            pyramid[(c * rows + y) * columns + x] = 0;
    for (int x = begin; x < end && some; ++x) {
        float known = 0, settled = 0, sum[PLANES] = {0};
        for (int row = 2 * y; row < MIN(2 * y + 2, grid.height); ++row)
            for (int column = 2 * x; column < MIN(2 * x + 2, grid.width); ++column) {
                const int at = row * grid.width + column;
                const part_t part = part_of(which, at, plane, value, layer, sides, mixed);
                settled += part.settled;
                sum[COVERAGE] += part.settled * part.share;
                if (part.known == 0)
                    continue;
                known += part.known;
                for (int c = 0; c < CHANNELS; ++c)
                    sum[c] += part.light[c * plane];
                sum[RADIUS] += part.known * (float)coc[at];
            }
        put_means(known, settled, sum, pyramid + y * columns + x, rows * columns);
    }
}

// One pixel of the coarser level (rows, columns) per work-item: means of known pixels among 2 x 2 of the finer level
// (fine_rows, fine_columns). fine, coarse: places of the levels in the pyramid.
__kernel void push(const int fine_rows, const int fine_columns, const int rows, const int columns, const int fine,
                   const int coarse, __global float *pyramid) {
    const int x = get_global_id(0), y = get_global_id(1), plane = rows * columns, fine_plane = fine_rows * fine_columns;
    if (x >= columns || y >= rows)
        return;
    float known = 0, settled = 0, sum[PLANES] = {0};
    for (int row = 2 * y; row < MIN(2 * y + 2, fine_rows); ++row)
        for (int column = 2 * x; column < MIN(2 * x + 2, fine_columns); ++column) {
            __global const float *from = pyramid + fine + row * fine_columns + column;
            const float light = from[KNOWN * fine_plane], outline = from[SETTLED * fine_plane];
            if (light + outline == 0)
                continue;
            known += light;
            settled += outline;
            for (int c = 0; c <= RADIUS; ++c)
                sum[c] += light * from[c * fine_plane];
            sum[COVERAGE] += outline * from[COVERAGE * fine_plane];
        }
    put_means(known, settled, sum, pyramid + coarse + y * columns + x, plane);
}

// Four pixels of a coarser level around one of the finer level: the nearest and its neighbor in one row, and the same
// in the other row. place: their indices; share: their weights, 0 if they are not known; sum: of the weights.
typedef struct {
    int4 place;
    float4 share;
    float sum;
} around_t;

// Pixels of the coarser level (rows, columns) around pixel (y, x) of the finer one; known: plane of the coarser level;
// with_pulled: true if pulled pixels count as much as known ones.
static around_t around(__global const float *known, int rows, int columns, int y, int x, bool with_pulled) {
    const int row = y / 2, other_row = y % 2 ? MIN(row + 1, rows - 1) : MAX(row - 1, 0);
    const int column = x / 2, other_column = x % 2 ? MIN(column + 1, columns - 1) : MAX(column - 1, 0);
    around_t near;
    near.place = (int4)(row, row, other_row, other_row) * columns + (int4)(column, other_column, column, other_column);
    near.share = (float4)(known[near.place.x], known[near.place.y], known[near.place.z], known[near.place.w]);
    if (with_pulled)
        near.share = MIN(near.share / PULLED, 1.0f);
    near.share *= (float4)(0.5625f, 0.1875f, 0.1875f, 0.0625f);
    near.sum = near.share.x + near.share.y + near.share.z + near.share.w;
    return near;
}

// Weighted mean of the known pixels in `near`; 0 if there are none.
static float between(__global const float *plane, around_t near) {
    const float4 radiance = {plane[near.place.x], plane[near.place.y], plane[near.place.z], plane[near.place.w]};
    return near.sum > 0 ? dot(near.share, radiance) / near.sum : 0;
}

// One pixel of the finer level per work-item: what it does not know comes from the coarser level, which is pulled
// before, or the last one. Arguments as for push; size: px of the image in a pixel of the finer level; near, to_marked:
// as for open_sheet.
__kernel void pull(const grid_t grid, const int fine_rows, const int fine_columns, const int rows, const int columns,
                   const int fine, const int coarse, const int size, const int near, __global const int *to_marked,
                   __global float *pyramid) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= fine_columns || y >= fine_rows)
        return;
    if (size <= LAYER_TILE && to_marked[tile_of(grid, size * x, size * y)] > near)
        return;
    const int plane = fine_rows * fine_columns, from_plane = rows * columns;
    __global float *to = pyramid + fine + y * fine_columns + x;
    __global const float *from = pyramid + coarse;
    if (to[KNOWN * plane] == 0) {
        const around_t near = around(from + KNOWN * from_plane, rows, columns, y, x, true);
        const around_t nearest = around(from + KNOWN * from_plane, rows, columns, y, x, false);
        for (int c = 0; c < CHANNELS; ++c)
            to[c * plane] = between(from + c * from_plane, near);
        to[RADIUS * plane] = between(from + RADIUS * from_plane, nearest);
        to[KNOWN * plane] = near.sum > 0 ? PULLED : 0;
    }
    if (to[SETTLED * plane] == 0) {
        const around_t near = around(from + SETTLED * from_plane, rows, columns, y, x, true);
        to[COVERAGE * plane] = between(from + COVERAGE * from_plane, near);
        to[SETTLED * plane] = near.sum > 0;
    }
}

// LAYER_TILE pixels of a row of sheet `which`, within `far` px of a tile that is left; what they do not show comes from
// the second level (rows, columns) of the pyramid. In: all planes of the image, to_left. Out: sheet, sheet_coc,
// sheet_valid. In and out: sheet_reach, as `reach`, of sources with coverage.
__kernel void take_sheet(const grid_t grid, const int which, const int rows, const int columns, const int far,
                         const real2 spread, __global const float *value, __global const real *coc,
                         __global const uchar *layer, __global const uchar *sides, __global const float *mixed,
                         __global const float *pyramid, __global const int *to_left, __global float *sheet,
                         __global real *sheet_coc, __global uchar *sheet_valid, __global int *sheet_reach) {
    const int begin = get_global_id(0) * LAYER_TILE, y = get_global_id(1), plane = grid.height * grid.width;
    if (begin >= grid.width || y >= grid.height)
        return;
    const int end = MIN(begin + LAYER_TILE, grid.width), tile = tile_of(grid, begin, y);
    const int coarse = rows * columns;  // size of a plane of the pyramid
    __global const float *known = pyramid + KNOWN * coarse;
    const bool near = to_left[tile] <= far;
    for (int x = begin; x < end; ++x)
        sheet_valid[y * grid.width + x] = near;
    int reach = -1;
    for (int x = begin; x < end && near; ++x) {
        const int at = y * grid.width + x;
        const part_t part = part_of(which, at, plane, value, layer, sides, mixed);
        float coverage = part.share;
        real radius = coc[at];
        bool shown = coverage > 0 || layer[at] == which;  // True if the pixel has its light
        if (layer[at] != which) {
            const around_t nearest = around(known, rows, columns, y, x, false);
            const real pulled = between(pyramid + RADIUS * coarse, nearest);
            if (!part.settled && part.whole && ABS(pulled - radius) <= FUSED) {  // it is one surface with the pixel
                coverage = alpha_of(value, plane, at);
                shown = true;
            } else {
                radius = pulled;
                if (!part.settled) {
                    const around_t open = around(pyramid + SETTLED * coarse, rows, columns, y, x, true);
                    const float outline = between(pyramid + COVERAGE * coarse, open);
                    coverage = MIN(MAX(GAIN * (outline - 0.5f) + 0.5f, 0.0f), 1.0f);
                }
            }
        }
        if (shown || coverage == 0)
            for (int c = 0; c < CHANNELS; ++c)
                sheet[c * plane + at] = shown ? part.scale * part.light[c * plane] : 0;
        else {
            const around_t near = around(known, rows, columns, y, x, true);
            for (int c = 0; c < CHANNELS; ++c)
                sheet[c * plane + at] = coverage * between(pyramid + c * coarse, near);
        }
        sheet[CHANNELS * plane + at] = coverage;
        sheet[(CHANNELS + 1) * plane + at] = 1;
        sheet_coc[at] = radius;
        if (coverage > 0)
            reach = MAX(reach, reach_of(radius, spread));
    }
    raise(sheet_reach + tile, reach);
}

#pragma OPENCL FP_CONTRACT OFF
