// Layered occlusion, from the pinhole image alone: depth layers k of the blur radius, from the nearest on, each
// blurred together with its coverage by the kernels of the blur, and composited,
//     I = sum_k B(L_k) share_k,  share_k = min(1, room that nearer layers have left / B(1_k)).
// Twin: clsco/reference/layered/layered.py. Host: clsco/passes/layered.py, which picks it for psf.occlusion =
// "layered".
//
// On the padded grid (height, width), row-major; a smaller signed radius is nearer:
//   value    float (CHANNELS - 1, height, width): radiance
//   coc      real: signed blur radius in px
//   valid    uchar: 1 where there is a surface
//   layer    uchar: 1 is the nearest, 0 no surface
//   seed     uchar: at an edge, the layer that is extrapolated behind the pixel, else 0
//   offset   int: rows to the nearest seed of the same column, NO_SEED for none
//   hidden   uchar: the layer that is extrapolated behind the pixel, else 0
//   edge     uchar: 1 if an edge is so near that coverage matters; radiance of other pixels is simply added
// and for the layer that is being blurred
//   pyramid  float, level by level from the finest on, each (CHANNELS + 1, rows, columns): radiance, radius, and the
//            degree to which they are known, 0 to 1
//   layer_value float (CHANNELS, height, width): radiance and coverage; layer_coc, layer_valid: as coc and valid
// All steps use integers, or sums in a fixed order: the same bits every time. Seeds of 64 pixels of a row at once took
// reach_hidden from 31 to 11 ns per pixel, vectors took `push` from 14 to 4, 16 columns at once column_seeds from 8 to
// 2.

#include "common/geometry.clh"

#pragma OPENCL FP_CONTRACT ON  // as where radiance is summed in the blur

#define NEVER (1 << 24)    // beyond the last pixel of any frame
#define RADIUS (CHANNELS - 1)  // plane of the pyramid
#define KNOWN CHANNELS
#define GROWTH 4.0f

__constant float TENT[4] = {0.125f, 0.375f, 0.375f, 0.125f};

#define EVEN(v) (v).s0246
#define ODD(v) (v).s1357

static int bin_of(real coc, real low, int bins) {
    const real at = FLOOR((coc - low) / LAYER_BIN);
    return at < 0 ? 0 : at < bins ? (int)at : bins - 1;
}

// One row or column per work-item. In and out: latest int (DISCONTINUITY_CLASSES, bins): for discontinuities of class
// k, larger than DISCONTINUITY 2^k, whose far side is in a bin, 1 + the largest bin of the near side, 0 for none; after
// it the largest sum of the two |radii| at a discontinuity, px, rounded up.
__kernel void find_discontinuities(const grid_t grid, const real low, const int bins, const int far,
                                   __global const real *coc, __global const uchar *valid, __global int *latest) {
    const int line = get_global_id(0);
    if (line >= grid.height + grid.width)
        return;
    const bool is_row = line < grid.height;
    const int length = is_row ? grid.width : grid.height, step = is_row ? 1 : grid.width;
    const int start = is_row ? line * grid.width : line - grid.height;
    int last = -far - 1;
    real before = 0;
    for (int i = 0; i < length; ++i) {
        const int at = start + i * step;
        if (!valid[at])
            continue;
        const real now = coc[at], size = ABS(now - before);
        if (size > DISCONTINUITY && i - last <= far && last >= 0) {
            int class = 0;
            while (class < DISCONTINUITY_CLASSES - 1 && size > DISCONTINUITY * (2 << class))
                ++class;
            __global int *entry = latest + class * bins + bin_of(MAX(now, before), low, bins);
            const int begin = bin_of(MIN(now, before), low, bins) + 1;
            if (RELAXED_LOAD(entry) < begin)
                atomic_max(entry, begin);
            const int sum = -(int)FLOOR(-(ABS(now) + ABS(before)));
            if (RELAXED_LOAD(latest + DISCONTINUITY_CLASSES * bins) < sum)
                atomic_max(latest + DISCONTINUITY_CLASSES * bins, sum);
        }
        last = i;
        before = now;
    }
}

// bounds: first bins of the second and each further layer, `count` of them. Out: layer.
__kernel void label_depth_layers(const grid_t grid, const real low, const int bins, const int count,
                                 const int8 bounds, __global const real *coc, __global const uchar *valid,
                                 __global uchar *layer) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int at = y * grid.width + x, bin = bin_of(coc[at], low, bins);
    int label = 1;
    while (label <= count && bin >= ((const int *)&bounds)[label - 1])
        ++label;
    layer[at] = valid[at] ? label : 0;
}

// In: coc, layer. Out: seed.
__kernel void seed_hidden(const grid_t grid, __global const real *coc, __global const uchar *layer,
                          __global uchar *seed) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int at = y * grid.width + x, own = layer[at];
    const int near[4] = {y > 0 ? at - grid.width : at, y + 1 < grid.height ? at + grid.width : at,
                         x > 0 ? at - 1 : at, x + 1 < grid.width ? at + 1 : at};
    int found = 0;
    for (int k = 0; k < 4 && own; ++k) {
        const int other = layer[near[k]];
        if (other > own && coc[near[k]] - coc[at] > DISCONTINUITY && (!found || other < found))
            found = other;
    }
    seed[at] = found;
}

// Offsets to seeds for `count` columns from x on, up to SEED_COLUMNS.
static inline void seeds_of(const grid_t grid, __global const uchar *seed, __global int *offset, int x,
                            const int count) {
    int last[SEED_COLUMNS];
    for (int k = 0; k < count; ++k)
        last[k] = -NEVER;
    for (int y = 0; y < grid.height; ++y)
        for (int k = 0; k < count; ++k) {
            const int at = y * grid.width + x + k;
            last[k] = seed[at] ? y : last[k];
            offset[at] = y - last[k] < NO_SEED ? last[k] - y : NO_SEED;
        }
    for (int k = 0; k < count; ++k)
        last[k] = NEVER;
    for (int y = grid.height - 1; y >= 0; --y)
        for (int k = 0; k < count; ++k) {
            const int at = y * grid.width + x + k, above = offset[at];
            last[k] = seed[at] ? y : last[k];
            offset[at] = last[k] - y < ABS(above) ? last[k] - y : above;
        }
}

// SEED_COLUMNS columns per work-item; of two seeds at the same distance the upper one counts. In: seed. Out: offset.
__kernel void column_seeds(const grid_t grid, __global const uchar *restrict seed, __global int *restrict offset) {
    const int x = get_global_id(0) * SEED_COLUMNS;
    if (x + SEED_COLUMNS <= grid.width)
        seeds_of(grid, seed, offset, x, SEED_COLUMNS);
    else if (x < grid.width)
        seeds_of(grid, seed, offset, x, grid.width - x);
}

// Flags the pixels of a run that are within `far` px of a seed, rows and columns counted separately. Returns False if
// no seed is near the run.
static bool flag_near(__global const int *offset, int begin, int end, int width, int far, __global uchar *flags) {
    const int first = MAX(begin - far, 0), stop = MIN(end + far, width);
    int nearest = NO_SEED;
    for (int x = first; x < stop; ++x)
        nearest = MIN(nearest, ABS(offset[x]));
    for (int x = begin; x < end; ++x)
        flags[x] = 0;
    if (nearest > far)
        return false;
    int last = -NEVER;
    for (int x = first; x < end; ++x) {
        last = ABS(offset[x]) <= far ? x : last;
        if (x >= begin && x - last <= far)
            flags[x] = 1;
    }
    last = NEVER;
    for (int x = stop - 1; x >= begin; --x) {
        last = ABS(offset[x]) <= far ? x : last;
        if (x < end && last - x <= far)
            flags[x] = 1;
    }
    return true;
}

// Squared distance of each pixel of a run to the nearest seed (best), deep^2 + 1 for none within `deep` px, and the
// number of columns to it (away). Of two at the same distance the one in the nearer column counts, of two such columns
// the left one. offset: of the run's first pixel; columns up to `deep` px beyond the run must exist.
static inline void nearest_seeds(__global const int *offset, int deep, int *restrict best, int *restrict away) {
    for (int i = 0; i < REACH_PIXELS; ++i) {
        best[i] = deep * deep + 1;
        away[i] = 0;
    }
    for (int dx = 0; dx <= deep; ++dx) {
        int farthest = 0;
        for (int i = 0; dx % 8 == 0 && i < REACH_PIXELS; ++i)
            farthest = MAX(farthest, best[i]);
        if (dx % 8 == 0 && dx * dx >= farthest)
            break;
        for (int side = -dx; side <= dx; side += MAX(2 * dx, 1))
            for (int i = 0; i < REACH_PIXELS; ++i) {
                const int dy = offset[i + side], square = dx * dx + dy * dy;
                away[i] = square < best[i] ? side : away[i];
                best[i] = MIN(best[i], square);
            }
    }
}

// The same for pixel x of a row, near the row's left or right end.
static int2 nearest_seed(__global const int *offset, int x, int width, int deep) {
    int2 found = {deep * deep + 1, 0};
    for (int dx = 0; dx * dx < found.x; ++dx)
        for (int side = -dx; side <= dx; side += MAX(2 * dx, 1)) {
            const int dy = x + side < 0 || x + side >= width ? NO_SEED : offset[x + side], square = dx * dx + dy * dy;
            found = square < found.x ? (int2)(square, side) : found;
        }
    return found;
}

// A run of a row per work-item. deep: px, largest distance of a seed. In: layer, seed, offset. Out: hidden, edge.
__kernel void reach_hidden(const grid_t grid, const int deep, __global const uchar *layer,
                           __global const uchar *seed, __global const int *offset, __global uchar *hidden,
                           __global uchar *edge) {
    const int begin = get_global_id(0) * REACH_PIXELS, y = get_global_id(1);
    if (begin >= grid.width || y >= grid.height)
        return;
    const int end = MIN(begin + REACH_PIXELS, grid.width), line = y * grid.width;
    if (!flag_near(offset + line, begin, end, grid.width, 2 * deep, edge + line)) {
        for (int x = begin; x < end; ++x)
            hidden[line + x] = 0;
        return;
    }
    int best[REACH_PIXELS], away[REACH_PIXELS];
    if (begin >= deep && begin + REACH_PIXELS + deep <= grid.width)
        nearest_seeds(offset + line + begin, deep, best, away);
    else
        for (int x = begin; x < end; ++x) {
            const int2 found = nearest_seed(offset + line, x, grid.width, deep);
            best[x - begin] = found.x;
            away[x - begin] = found.y;
        }
    for (int x = begin; x < end; ++x) {
        const int own = layer[line + x], column = x + away[x - begin];
        int label = 0;
        if (best[x - begin] <= deep * deep)
            label = seed[line + offset[line + column] * grid.width + column];
        hidden[line + x] = own && label > own ? label : 0;
    }
}

// Out: the finest level of the pyramid, of the pixels of layer `which`.
__kernel void open_depth_layer(const grid_t grid, const int which, __global const float *value,
                               __global const real *coc, __global const uchar *layer, __global float *pyramid) {
    const int x = get_global_id(0), y = get_global_id(1), plane = grid.height * grid.width;
    if (x >= grid.width || y >= grid.height)
        return;
    const int at = y * grid.width + x;
    const bool known = layer[at] == which;
    for (int c = 0; c < CHANNELS - 1; ++c)
        pyramid[c * plane + at] = known ? value[c * plane + at] : 0;
    pyramid[RADIUS * plane + at] = known ? (float)coc[at] : 0;
    pyramid[KNOWN * plane + at] = known;
}

// `push` for PUSH_PIXELS pixels of row y of the coarser level that are not at the row's ends; plane: px of that level.
// from: in the finer level's first row, one pixel before the first one under them.
static inline void push_some(__global const float *from, int fine_rows, int fine_columns, int y, int plane, int last,
                             __global float *to) {
    const int fine_plane = fine_rows * fine_columns;
    float4 total = 0, sum[CHANNELS];
    for (int c = 0; c < CHANNELS; ++c)
        sum[c] = 0;
    for (int i = MAX(1 - 2 * y, 0); i < MIN(4, fine_rows + 1 - 2 * y); ++i) {
        __global const float *line = from + (2 * y + i - 1) * fine_columns;
        __global const float *shares = line + KNOWN * fine_plane;
        const float8 left = LOAD(float, 8, shares) * TENT[i], right = LOAD(float, 8, shares + 2) * TENT[i];
        const float4 known[4] = {EVEN(left) * TENT[0], ODD(left) * TENT[1], EVEN(right) * TENT[2],
                                 ODD(right) * TENT[3]};
        total += (known[0] + known[1]) + (known[2] + known[3]);
        for (int c = 0; c < CHANNELS; ++c) {
            const float8 here = LOAD(float, 8, line + c * fine_plane), next = LOAD(float, 8, line + c * fine_plane + 2);
            sum[c] += (known[0] * EVEN(here) + known[1] * ODD(here)) + (known[2] * EVEN(next) + known[3] * ODD(next));
        }
    }
    const float4 none = 0, whole = 1;
    for (int c = 0; c < CHANNELS; ++c)
        STORE(float, 4, total > 0 ? sum[c] / total : none, to + c * plane);
    STORE(float, 4, last ? (total > 0 ? whole : none) : MIN(GROWTH * total, whole), to + KNOWN * plane);
}

// PUSH_PIXELS pixels of the coarser level (rows, columns) per work-item: means of known pixels under a tent of 4 x 4
// pixels of the finer level (fine_rows, fine_columns). fine, coarse: places of the levels in the pyramid; last: 1 for
// the coarsest level, where partly known pixels count as known.
__kernel void push(const int fine_rows, const int fine_columns, const int rows, const int columns, const int fine,
                   const int coarse, const int last, __global float *pyramid) {
    const int begin = get_global_id(0) * PUSH_PIXELS, y = get_global_id(1);
    if (begin >= columns || y >= rows)
        return;
    const int fine_plane = fine_rows * fine_columns, plane = rows * columns;
    __global const float *from = pyramid + fine;
    __global float *to = pyramid + coarse + y * columns;
    if (begin > 0 && 2 * begin + 2 * PUSH_PIXELS < fine_columns) {
        push_some(from + 2 * begin - 1, fine_rows, fine_columns, y, plane, last, to + begin);
        return;
    }
    for (int x = begin; x < MIN(begin + PUSH_PIXELS, columns); ++x) {
        float total = 0, sum[CHANNELS];
        for (int c = 0; c < CHANNELS; ++c)
            sum[c] = 0;
        for (int i = 0; i < 4; ++i)
            for (int j = 0; j < 4; ++j) {
                const int row = 2 * y + i - 1, column = 2 * x + j - 1;
                if (row < 0 || row >= fine_rows || column < 0 || column >= fine_columns)
                    continue;
                const int at = row * fine_columns + column;
                const float known = TENT[i] * TENT[j] * from[KNOWN * fine_plane + at];
                total += known;
                for (int c = 0; c < CHANNELS; ++c)
                    sum[c] += known * from[c * fine_plane + at];
            }
        for (int c = 0; c < CHANNELS; ++c)
            to[c * plane + x] = total > 0 ? sum[c] / total : 0;
        to[KNOWN * plane + x] = last ? total > 0 : MIN(GROWTH * total, 1.0f);
    }
}

// Four pixels of a coarser level around one of the finer level: the nearest and its neighbor in one row, and the same
// in the other row. place: their indices; share: their weights, 0 if they are not known; sum: of the weights.
typedef struct {
    int4 place;
    float4 share;
    float sum;
} around_t;

// Pixels of the coarser level (rows, columns) around pixel (y, x) of the finer one; known: plane of the coarser level.
static around_t around(__global const float *known, int rows, int columns, int y, int x) {
    const int row = y / 2, other_row = y % 2 ? MIN(row + 1, rows - 1) : MAX(row - 1, 0);
    const int column = x / 2, other_column = x % 2 ? MIN(column + 1, columns - 1) : MAX(column - 1, 0);
    around_t near;
    near.place = (int4)(row, row, other_row, other_row) * columns + (int4)(column, other_column, column, other_column);
    near.share = (float4)(0.5625f, 0.1875f, 0.1875f, 0.0625f) *
                 (float4)(known[near.place.x], known[near.place.y], known[near.place.z], known[near.place.w]);
    near.sum = near.share.x + near.share.y + near.share.z + near.share.w;
    return near;
}

// Weighted mean of the known pixels in `near`; 0 if there are none.
static float between(__global const float *plane, around_t near) {
    const float4 radiance = {plane[near.place.x], plane[near.place.y], plane[near.place.z], plane[near.place.w]};
    return near.sum > 0 ? dot(near.share, radiance) / near.sum : 0;
}

// One pixel of the finer level per work-item: what it does not know, in part or whole, comes from the coarser level,
// which is pulled before, or the last one. Arguments as for push.
__kernel void pull(const int fine_rows, const int fine_columns, const int rows, const int columns, const int fine,
                   const int coarse, __global float *pyramid) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= fine_columns || y >= fine_rows)
        return;
    const int plane = fine_rows * fine_columns;
    __global float *to = pyramid + fine + y * fine_columns + x;
    const float known = to[KNOWN * plane];
    if (known == 1)
        return;
    const around_t near = around(pyramid + coarse + KNOWN * rows * columns, rows, columns, y, x);
    for (int c = 0; c < CHANNELS && near.sum > 0; ++c)
        to[c * plane] = known * to[c * plane] + (1 - known) * between(pyramid + coarse + c * rows * columns, near);
    to[KNOWN * plane] = known > 0 || near.sum > 0;
}

// Layer `which` with its hidden part, which comes from the second level (rows, columns) of the pyramid, at `coarse`.
__kernel void take_depth_layer(const grid_t grid, const int which, const int rows, const int columns,
                               const int coarse, __global const float *value, __global const real *coc,
                               __global const uchar *layer, __global const uchar *hidden,
                                       __global const float *pyramid, __global float *layer_value,
                                       __global real *layer_coc, __global uchar *layer_valid) {
    const int x = get_global_id(0), y = get_global_id(1), plane = grid.height * grid.width;
    if (x >= grid.width || y >= grid.height)
        return;
    const int at = y * grid.width + x;
    const bool own = layer[at] == which, there = own || hidden[at] == which;
    __global const float *behind = pyramid + coarse;
    layer_value[(CHANNELS - 1) * plane + at] = there;
    layer_valid[at] = there;
    if (own || !there) {
        for (int c = 0; c < CHANNELS - 1; ++c)
            layer_value[c * plane + at] = own ? value[c * plane + at] : 0;
        layer_coc[at] = own ? coc[at] : 0;
        return;
    }
    const around_t near = around(behind + KNOWN * rows * columns, rows, columns, y, x);
    for (int c = 0; c < CHANNELS - 1; ++c)
        layer_value[c * plane + at] = between(behind + c * rows * columns, near);
    layer_coc[at] = between(behind + RADIUS * rows * columns, near);
}

// Keeps only the sources near edges (near_edges = 1), or only the others. In: edge. In and out: source.
__kernel void keep_sources(const grid_t grid, const int near_edges, __global const uchar *edge,
                           __global float *source) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int at = y * grid.width + x;
    if (edge[at] != near_edges)
        source[at] = -1;
}

// Adds a blurred layer behind the previous ones, weighted by the coverage that these leave: at a cut through a
// continuous surface, the two coverages add up to that of the whole, and no light is lost. In: blurred float (CHANNELS,
// rows, from_pitch), with scratch columns as the total of blur.cl; with RIMS open, from open_share, the largest
// coverage, else 1. In and out: covered float (rows, columns), total.
__kernel void composite(const grid_t grid, const int from_pitch, const int from_pad,
                        __global const float *blurred, __global float *covered,
#if RIMS
                        __global const float *open,
#endif
#if SCATTER
                        const float scale, __global fixed_t *total
#else
                        const int pitch, const int pad, __global float *total
#endif
) {
    const int column = get_global_id(0), row = get_global_id(1);
    if (column >= grid.columns || row >= grid.rows)
        return;
    __global const float *irradiance = blurred + row * from_pitch + column + from_pad;
    const int at = row * grid.columns + column, plane = grid.rows * from_pitch;
    const float coverage = irradiance[(CHANNELS - 1) * plane], before = covered[at];
#if RIMS
    const float most = open[at];
#else
    const float most = 1;
#endif
    const float room = MIN(coverage, MAX(coverage, most) - before), seen = MAX(room, 0.0f);
    const float share = seen < coverage ? seen / coverage : 1;
    for (int c = 0; c < CHANNELS - 1; ++c) {
#if SCATTER
        const float fixed = floor(irradiance[c * plane] * share * scale + 0.5f);
        total[c * grid.rows * grid.columns + at] += (fixed_t)fixed;
#else
        total[(c * grid.rows + row) * pitch + column + pad] += irradiance[c * plane] * share;
#endif
    }
    covered[at] = before + seen;
}

#pragma OPENCL FP_CONTRACT OFF
