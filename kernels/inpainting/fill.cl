// Missing pixels: which there are, and filling by adaptive interpolation, AIT (thesis, 4.3.5); fill_mean_median.cl has
// the other method. Twin: clsco/reference/inpainting/fill.py.
//
// On the padded grid, row-major:
//   value    float (CHANNELS, height, width): radiance
//   w, coc   real: inverse depth in 1/mm and signed radius of the blur in px
//   valid    uchar: 1 known or filled, else 0
//   status   uchar: 0 known or not missing, 1 filled, 2 missing
//   spans    int2 per line, the rows and then the columns: first and last valid pixel, (INT_MAX, -1) for none
//   grown    the same after a sweep, which may have extended lines
//   list     int per missing pixel, in any order: its number
//   far      float per missing pixel of the grid, 0 without FILL_FAR: largest inverse depth of neighbors to fill from
//   object   uchar, 0 without SEVERAL: which object is visible, 255 for none
//   counters ints: COUNTER_LEFT (entries of list) and COUNTER_FILLED (by the sweep), the same inside the frame, and
//            COUNTER_DONE (by all sweeps: entries of done)
//
// A sweep writes only to missing pixels, which are not read until settle_sweep has made them valid: so it reads only
// what was known before it, in any order.
//
// FILL_FAR: a surface that a moving edge uncovers lies behind the edge, and is filled from the farther side only. The
// nearest pair of known pixels on opposite sides of a missing one determines its depth: that of the farther of the two.
// Neighbors that are nearer than this by more than FAR_SLACK are not used, and a pixel that has only such ones waits
// until nothing else can be filled. In the gap that a growing surface leaves, at most WIDEST_GAP px to each side, both
// sides are near, and used; in a wider hole between two near things the surface farther behind is used.

#include "common/geometry.clh"
#include "inpainting/estimate.clh"

#define FAR_SLACK 1.02f  // relative: a surface at 45 degrees changes less over two pixels of 0.5 degrees each

static bool in_frame(const grid_t grid, int x, int y) {
    const int column = x - grid.guard, row = y - grid.guard;
    return column >= 0 && column < grid.columns && row >= 0 && row < grid.rows;
}

// True if the fill domain contains a pixel: with "surface" its ray has to meet one of the moved surfaces.
static bool may_be_missing(const grid_t grid, __constant surface_t *surfaces, int count, int x, int y) {
    if (!DOMAIN_SURFACE)
        return true;
    const group_t everything = {~(ulong)0, 0, count, -1, 0};
    const real3 ray = pixel_ray(grid, y - grid.guard, x - grid.guard);
    uchar label;
    int object;
    nearest_surface(surfaces, everything, ray, &label, &object);
    return object >= 0;
}

// Bound on the inverse depth of neighbors that a missing pixel may be filled from. It is determined by the line (row,
// column or diagonal) that has valid pixels on both sides within the fewest steps; in a wide hole with equally deep
// sides by the line whose depth, interpolated at the pixel, is the farthest.
static float far_bound(const grid_t grid, __global const uchar *valid, __global const real *w, int x, int y) {
    int ends[8], steps[8];
    for (int k = 0; k < 8; ++k)
        ends[k] = -1;
    float found = INFINITY, farthest = INFINITY;
    bool begun = false, open = true;
    for (int step = 1; open; ++step) {
        open = false;
        for (int k = 0; k < 8; ++k) {
            const int i = y + step * NEIGHBOR_Y[k], j = x + step * NEIGHBOR_X[k];
            const bool inside = i >= 0 && i < grid.height && j >= 0 && j < grid.width;
            open = open || (ends[k] < 0 && inside);
            if (ends[k] < 0 && inside && valid[i * grid.width + j]) {
                ends[k] = i * grid.width + j;
                steps[k] = step;
            }
            if (!(k % 2) || ends[k - 1] < 0 || ends[k] < 0 || MAX(steps[k - 1], steps[k]) != step)
                continue;
            const float one = (float)w[ends[k - 1]], other = (float)w[ends[k]];
            const float near = steps[k - 1], far = steps[k], smaller = MIN(one, other);
            const float here = (one * far + other * near) / (near + far);
            if (!begun && (MAX(one, other) > FAR_SLACK * smaller || step <= WIDEST_GAP))
                return FAR_SLACK * smaller;
            if (!begun || FAR_SLACK * here < farthest) {
                found = smaller;
                farthest = here;
            }
            begun = true;
        }
    }
    return FAR_SLACK * found;
}

// Lists a pixel as missing if the fill domain contains it.
static void list_missing(const grid_t grid, __constant surface_t *surfaces, int count, __global const uchar *valid,
                         __global const real *w, int x, int y, __global float *far, __global uchar *status,
                         __global int *list, __global int *counters) {
    if (!may_be_missing(grid, surfaces, count, x, y))
        return;
    const int at = y * grid.width + x;
    if (FILL_FAR)
        far[at] = far_bound(grid, valid, w, x, y);
    status[at] = 2;
    list[atomic_inc(counters + COUNTER_LEFT)] = at;
    if (in_frame(grid, x, y))
        atomic_inc(counters + COUNTER_LEFT_INSIDE);
}

// First and last valid pixel of each line. In: valid. Out: spans, grown.
__kernel void find_spans(const grid_t grid, __global const uchar *valid, __global int2 *spans,
                         __global int2 *grown) {
    const int line = get_global_id(0);
    if (line >= grid.height + grid.width)
        return;
    const bool is_row = line < grid.height;
    const int length = is_row ? grid.width : grid.height, step = is_row ? 1 : grid.width;
    __global const uchar *along = valid + (is_row ? line * grid.width : line - grid.height);
    int first = 0, last = length - 1;
    while (first < length && !along[first * step])
        ++first;
    while (last >= first && !along[last * step])
        --last;
    spans[line] = grown[line] = first < length ? (int2)(first, last) : (int2)(INT_MAX, -1);
}

// Lists the unknown pixels between the first and last valid one of their row, or else of their column, FILL_CHUNK
// columns per work-item. In: `count` surfaces, valid, w, spans. Out: status and far of missing pixels, list,
// COUNTER_LEFT and COUNTER_LEFT_INSIDE.
__kernel void mark_missing(const grid_t grid, __constant surface_t *surfaces, const int count,
                           __global const uchar *valid, __global const int2 *spans, __global uchar *status,
                           __global int *list, __global int *counters, __global const real *w, __global float *far) {
    const int begin = get_global_id(0) * FILL_CHUNK, y = get_global_id(1);
    if (begin >= grid.width || y >= grid.height)
        return;
    const int2 row = spans[y];
    for (int x = begin; x < MIN(begin + FILL_CHUNK, grid.width); ++x) {
        const int2 column = spans[grid.height + x];
        if (!valid[y * grid.width + x] && ((x > row.x && x < row.y) || (y > column.x && y < column.y)))
            list_missing(grid, surfaces, count, valid, w, x, y, far, status, list, counters);
    }
}

// Extends a line in `grown` to the pixel at `index` on it.
static void reach(__global int2 *grown, __global const int2 *spans, int line, int index) {
    const int2 span = spans[line];
    if (index < span.x)
        atomic_min((__global int *)(grown + line), index);
    if (index > span.y)
        atomic_max((__global int *)(grown + line) + 1, index);
}

// Ends a sweep: pixels that it filled become valid, the others are listed again. In: list of `count`, status, spans.
// Out: valid, grown, left (as list), counters, with FILL_MEAN_MEDIAN done (list of what all sweeps filled).
__kernel void settle_sweep(const grid_t grid, __global const int *list, const int count,
                           __global const int2 *spans, __global int2 *grown, __global const uchar *status,
                           __global uchar *valid, __global int *left, __global int *counters, __global int *done) {
    const int i = get_global_id(0);
    if (i >= count)
        return;
    const int at = list[i], x = at % grid.width, y = at / grid.width;
    const bool is_filled = status[at] == 1;
    if (is_filled) {
        reach(grown, spans, y, x);
        reach(grown, spans, grid.height + x, y);
        valid[at] = 1;
        atomic_inc(counters + COUNTER_FILLED);
        if (FILL_MEAN_MEDIAN)
            done[atomic_inc(counters + COUNTER_DONE)] = at;
    } else {
        left[atomic_inc(counters + COUNTER_LEFT)] = at;
    }
    if (in_frame(grid, x, y))
        atomic_inc(counters + (is_filled ? COUNTER_FILLED_INSIDE : COUNTER_LEFT_INSIDE));
}

// Lists pixels that are missing since lines have grown, one line per work-item. A pixel within the span of its row is
// left to the row. In: `count` surfaces, valid, w, grown. In and out: spans, status, far, list, COUNTER_LEFT and
// COUNTER_LEFT_INSIDE.
__kernel void mark_grown(const grid_t grid, __constant surface_t *surfaces, const int count,
                         __global const uchar *valid, __global int2 *spans, __global const int2 *grown,
                         __global uchar *status, __global int *list, __global int *counters, __global const real *w,
                         __global float *far) {
    const int line = get_global_id(0);
    if (line >= grid.height + grid.width)
        return;
    const int2 before = spans[line], now = grown[line];
    if (before.x == now.x && before.y == now.y)
        return;
    spans[line] = now;
    const bool is_row = line < grid.height;
    for (int i = now.x + 1; i < now.y; ++i) {
        if (i >= before.x && i < before.y)
            i = before.y;  // pixels between have been listed
        const int x = is_row ? i : line - grid.height, y = is_row ? line : i, at = y * grid.width + x;
        const int2 row = grown[y];
        const bool listed = is_row ? status[at] == 2 : x > row.x && x < row.y;
        if (!valid[at] && !listed)
            list_missing(grid, surfaces, count, valid, w, x, y, far, status, list, counters);
    }
}

// Nearest valid pixel from `at` in steps of `step`, at most `most`; -1 for none.
static int nearest_valid(__global const uchar *valid, int at, int step, int most) {
    for (int i = 1; i <= most; ++i)
        if (valid[at + i * step])
            return at + i * step;
    return -1;
}

// The valid pixels on both sides of a pixel of a line; x is the first, y the second, negative for none.
static int2 between_valid(__global const uchar *valid, int at, int step, int index, int length) {
    const int before = nearest_valid(valid, at, -step, index);
    return (int2)(before, before < 0 ? -1 : nearest_valid(valid, at, step, length - 1 - index));
}

// One sweep of AIT. Inside: the mean of the first opposite pair of usable neighbors, else a copy of the first usable
// one. On the outermost rows and columns: linear between the nearest valid pixels of the row, else of the column; with
// FILL_FAR a copy of the farther one if their depths differ by more than FAR_SLACK. The object is that of the first
// pixel used. In: list of `count`, valid; minimum, far: with 0 any valid neighbor is usable. In and out: value, w, coc,
// status, object.
__kernel void fill_ait(const grid_t grid, const lens_t lens, __global const int *list, const int count,
                       const int minimum, __global const float *far, __global const uchar *valid,
                       __global float *value, __global real *w, __global real *coc, __global uchar *status,
                       __global uchar *object) {
    const int id = get_global_id(0);
    if (id >= count)
        return;
    const int at = list[id], x = at % grid.width, y = at / grid.width;
    int2 from = -1;
    real share = (real)0.5;
    if (x == 0 || y == 0 || x == grid.width - 1 || y == grid.height - 1) {
        int step = 1;
        from = between_valid(valid, at, step, x, grid.width);
        if (from.y < 0) {
            step = grid.width;
            from = between_valid(valid, at, step, y, grid.height);
        }
        if (from.y >= 0)
            share = (real)((at - from.x) / step) / ((from.y - from.x) / step);
        if (FILL_FAR && from.y >= 0 && (float)w[from.x] > FAR_SLACK * (float)w[from.y])
            from.x = from.y;
        else if (FILL_FAR && from.y >= 0 && (float)w[from.y] > FAR_SLACK * (float)w[from.x])
            from.y = from.x;
    } else {
        const float bound = bound_of(far, at, minimum);
        for (int k = 0; k < 8 && from.y < 0; k += 2) {
            const int step = NEIGHBOR_Y[k] * grid.width + NEIGHBOR_X[k];
            if (serves(valid, w, at + step, bound) && serves(valid, w, at - step, bound))
                from = (int2)(at + step, at - step);
        }
        for (int k = 0; k < 8 && from.y < 0; ++k) {
            const int step = NEIGHBOR_Y[k] * grid.width + NEIGHBOR_X[k];
            if (serves(valid, w, at + step, bound))
                from = at + step;
        }
    }
    if (from.y < 0)
        return;
    for (int c = 0; c < CHANNELS; ++c) {
        __global float *plane = value + c * grid.height * grid.width;
        plane[at] = (float)(plane[from.x] + ((real)plane[from.y] - plane[from.x]) * share);
    }
    const real change = (w[from.y] - w[from.x]) * share;
    const real inverse_depth = w[from.x] + change;
    w[at] = inverse_depth;
    coc[at] = grid_radius(grid, lens, at, inverse_depth);
    status[at] = 1;
    if (SEVERAL)
        object[at] = object[from.x];
}
