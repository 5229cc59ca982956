// Forward warp: the pixels of the frame in its reference pose move with their objects, P' = R (P - c) + c + t, and are
// projected to the nearest pixel of the padded grid (thesis, 4.3.3). Twin: clsco/reference/warp/warp.py. Host:
// clsco/passes/warp.py, for motion.warp = "forward" where something moves, and for depth maps that move.
//
//   rest     real per source (pixel of the frame, row-major): inverse depth in the reference pose, 1/mm, 0 for no
//            surface
//   target   int per source: pixel of the padded grid that it moves to, -1 for none
//   moved    real per source: its inverse depth after the move, 1/mm, 0 for none
//   winner   int per pixel of the padded grid: lowest number of the nearest sources moved there, NO_WINNER for none
//   object   uchar per source: number of its object, 0 where there is none
//
// The source in a pixel is the nearest of all surfaces there in the reference pose; it moves with its object. `count`
// objects have a surface, a pose and a texture each. Those in the bit mask `members` are analytic; the others are depth
// maps (MAPPED), whose surface_t has only the center.
//
// Depths are compared as floats, so that rounding in the last digit of a double decides nothing; of equal ones the
// first source wins. On CPUs (OWNED) a work-item owns a band of the padded grid and goes through the sources that move
// there in their order, without atomics: 5.3 -> 1.0 ns per pixel; elsewhere atomics find the same winners in two
// passes. Targets by one floor and one division, vectorized: 42 -> 2.6 ns (docs/lessons.md).

#include "common/geometry.clh"

// The position p of a source in px is snapped to 1/4096 px and then rounded half up, so that errors far below a step
// cannot move it across a pixel's edge. Both roundings in one are floor(p + ROUNDING).
#define ROUNDING ((real)(0.5 + 0.5 / 4096))
#define NO_OBJECT 255
#define EDGE_PX 1         // px from the frame's edge in the reference pose, within which a source is at the edge
#define SAME_DEPTH 1.02f  // relative: neighbors in the reference pose that differ by less are one surface

// Sources of a row that a work-item moves. PoCL vectorizes a loop over them, but not work-items of one source each.
#define ITEM_PIXELS (OWNED ? OWNED_PIXELS : 1)

// Inverse depth and object of every source; `surfaces` are in the reference pose; maps real (depth maps, rows,
// columns): inverse depths in the reference pose. Of equally near objects the first counts. Out: rest, object.
__kernel void reproject_rest(const grid_t grid, __constant surface_t *surfaces, const int count, const ulong members,
                             __global const real *maps, __global real *rest, __global uchar *object) {
    const int column = get_global_id(0), row = get_global_id(1);
    if (column >= grid.columns || row >= grid.rows)
        return;
    const int at = row * grid.columns + column;
    const real3 ray = pixel_ray(grid, row, column);
    real nearest = 0;
    int whose = 0;
    for (int k = 0; k < (SEVERAL ? count : 1); ++k) {
        uchar root;
        const bool is_map = MAPPED && !(members >> k & 1);
        const real w = is_map ? maps[at] : solve_quadric(surfaces + k, ray, &root);
        maps += is_map ? grid.rows * grid.columns : 0;
        const bool nearer = nearest < w;
        whose = nearer ? k : whose;
        nearest = nearer ? w : nearest;
    }
    rest[at] = nearest;
    if (SEVERAL)
        object[at] = whose;
}

// Moves the sources of object k in columns begin..end - 1 of a row by its pose, about the center of its surface in the
// reference pose. Returns the lowest and highest target, (INT_MAX, -1) for none.
static inline int2 move_sources(const grid_t grid, __constant surface_t *surface, __constant pose_t *pose, int row,
                                int begin, int end, __global const real *restrict rest, __global int *restrict target,
                                __global real *restrict moved, __global const uchar *restrict object, int k) {
    // For a ray r, R r + w (across, up, away) is the moved point times w. Computed by components, and with few
    // divisions: PoCL vectorizes no loop that computes with vectors.
    __constant real *R = pose->rotation, *center = surface->rest;
    const real3 turn = turned(R, load3(center)), shifted = load3(center) + load3(pose->shift);
    const real across = shifted.x - turn.x, up = shifted.y - turn.y;
    const real away = shifted.z - turn.z;
    const real step = grid.rest_step, y = ray_through(grid, step, row, 0).y;
    const real line_x = R[1] * y + R[2];
    const real line_y = R[4] * y + R[5];
    const real line_z = R[7] * y + R[8];
    const real R_x = R[0], R_y = R[3], R_z = R[6];
    const real middle = (real)0.5 * (grid.columns - 1);
    const real inverse_step = 1 / grid.step;
    // Positions on the padded grid, plus 1, so that those before its first pixel are below 1.
    const real right = middle + (grid.guard + 1) + ROUNDING;
    const real down = (real)0.5 * (grid.rows - 1) + (grid.guard + 1) + ROUNDING;
    const real first = 1, bottom = grid.height + 1, edge = grid.width + 1;
    int lowest = INT_MAX, highest = -1;
    for (int column = begin; column < end; ++column) {
        const int at = row * grid.columns + column;
#if CURVED & CURVED_IMAGE
        const real3 ray = ray_through(grid, step, row, column);
        const real w = rest[at], x = ray.x;
        const real px = R_x * x + R[1] * ray.y + R[2] + across * w;
        const real py = R_y * x + R[4] * ray.y + R[5] + up * w;
        const real pz = R_z * x + R[7] * ray.y + R[8] + away * w;
        const real nearness = 1 / pz;
        const real3 there = project(grid, grid.step, (real3)(px, py, pz));
        const real i = there.y + (grid.guard + 1) + ROUNDING, j = there.x + (grid.guard + 1) + ROUNDING;
#else
        const real w = rest[at], x = step * (column - middle);
        const real px = R_x * x + line_x + across * w;
        const real py = R_y * x + line_y + up * w;
        const real pz = R_z * x + line_z + away * w;
        const real nearness = 1 / pz, scale = nearness * inverse_step;
        const real i = down - py * scale, j = right + px * scale;
#endif
        const real depth = w * nearness;
        const bool mine = !SEVERAL || object[at] == k;
        const bool used = mine && w > 0 && pz > 0 && !(i < first) && i < bottom && !(j < first) && j < edge;
        const int line = (int)(used ? i : first), place = (int)(used ? j : 0);
        const int to = line * grid.width + place - grid.width - 1;
        target[at] = mine ? to : target[at];
        moved[at] = used ? depth : mine ? 0 : moved[at];
        lowest = MIN(lowest, used ? to : INT_MAX);
        highest = MAX(highest, to);
    }
    return (int2)(lowest, highest);
}

// Moves every source with its object. In: rest, object. Out: target, moved, and with OWNED bounds int2 per ITEM_PIXELS
// of a row: lowest and highest target there, (INT_MAX, -1) for none.
__kernel void reproject_targets(const grid_t grid, __constant surface_t *surfaces, __constant pose_t *poses,
                                __global const real *restrict rest, __global int *restrict target,
                                __global real *restrict moved, __global const uchar *restrict object,
                                __global int2 *restrict bounds) {
    const int id = get_global_id(0), each = (grid.columns + ITEM_PIXELS - 1) / ITEM_PIXELS, row = id / each;
    if (row >= grid.rows)
        return;
    const int begin = id % each * ITEM_PIXELS, end = MIN(begin + ITEM_PIXELS, grid.columns);
    ulong present = !SEVERAL;
    for (int column = begin; SEVERAL && column < end; ++column)
        present |= (ulong)1 << object[row * grid.columns + column];
    int2 range = (int2)(INT_MAX, -1);
    for (int k = 0; present >> k; ++k) {
        if (!(present >> k & 1))
            continue;
        const int2 own = move_sources(grid, surfaces + k, poses + k, row, begin, end, rest, target, moved, object, k);
        range = (int2)(MIN(range.x, own.x), MAX(range.y, own.y));
    }
    if (OWNED)
        bounds[id] = range;
}

// The whole depth test: each work-item owns `band` rows of the padded grid. In: target, moved, bounds. Out: winner;
// with FILL_FAR depth, as by reproject_depth.
__kernel void reproject_nearest(const grid_t grid, __global const int *target, __global const real *moved,
                                __global const int2 *bounds, const int band, __global int *winner,
                                __global int *depth) {
    const int first = get_global_id(0) * band;
    if (first >= grid.height)
        return;
    const int begin = first * grid.width, end = MIN(first + band, grid.height) * grid.width;
    const int each = (grid.columns + ITEM_PIXELS - 1) / ITEM_PIXELS;
    for (int to = begin; to < end; ++to)
        winner[to] = NO_WINNER;
    for (int segment = 0; segment < grid.rows * each; ++segment) {
        const int2 range = bounds[segment];
        if (range.x >= end || range.y < begin)
            continue;
        const int row = segment / each, column = segment % each * ITEM_PIXELS;
        const int from = row * grid.columns + column, sources = MIN(ITEM_PIXELS, grid.columns - column);
        for (int i = from; i < from + sources; ++i) {
            const int to = target[i];
            if (to < begin || to >= end)
                continue;
            const int other = winner[to];
            if (other == NO_WINNER || (float)moved[i] > (float)moved[other])
                winner[to] = i;
        }
    }
    for (int to = begin; FILL_FAR && to < end; ++to)
        depth[to] = winner[to] == NO_WINNER ? 0 : as_int((float)moved[winner[to]]);
}

// Largest inverse depth of all sources moved to each pixel. In: target, moved. In and out: depth, bits of a float per
// pixel of the padded grid, 0 to begin with; floats > 0 keep their order as ints.
__kernel void reproject_depth(const grid_t grid, __global const int *target, __global const real *moved,
                              __global int *depth) {
    const int i = get_global_id(0);
    if (i >= grid.rows * grid.columns)
        return;
    if (target[i] >= 0)
        atomic_max(depth + target[i], as_int((float)moved[i]));
}

// Lowest source with that inverse depth. In: target, moved, depth. In and out: winner, NO_WINNER to begin with.
__kernel void reproject_winner(const grid_t grid, __global const int *target, __global const real *moved,
                               __global const int *depth, __global int *winner) {
    const int i = get_global_id(0);
    if (i >= grid.rows * grid.columns)
        return;
    const int to = target[i];
    if (to >= 0 && depth[to] == as_int((float)moved[i]))
        atomic_min(winner + to, i);
}

// First pixel in steps of (right, down) from a pixel whose winner is nearer than `bound`; -1 for none.
static int nearer_pixel(const grid_t grid, __global const int *depth, int x, int y, int right, int down,
                        float bound) {
    for (int step = 1; step <= WIDEST_GAP; ++step) {
        x += right;
        y += down;
        if (x < 0 || x >= grid.width || y < 0 || y >= grid.height)
            return -1;
        if (as_float(depth[y * grid.width + x]) > bound)
            return y * grid.width + x;
    }
    return -1;
}

// True if a winner is visible only through a gap in a surface that has grown: nearer winners on opposite sides were
// neighbors on one surface in the reference pose, which had no gap between them.
static bool shows_through(const grid_t grid, __global const int *depth, __global const int *winner, int x, int y) {
    const float bound = SAME_DEPTH * as_float(depth[y * grid.width + x]);
    for (int k = 0; k < 4; ++k) {
        const int right = k == 1 ? 0 : 1, down = k == 0 ? 0 : k == 3 ? -1 : 1;
        const int before = nearer_pixel(grid, depth, x, y, -right, -down, bound);
        const int after = before < 0 ? -1 : nearer_pixel(grid, depth, x, y, right, down, bound);
        if (after < 0)
            continue;
        const int a = winner[before], b = winner[after];
        const int rows = a / grid.columns - b / grid.columns, columns = a % grid.columns - b % grid.columns;
        const float first = as_float(depth[before]), second = as_float(depth[after]);
        if (ABS(rows) <= 1 && ABS(columns) <= 1 && MAX(first, second) <= SAME_DEPTH * MIN(first, second))
            return true;
    }
    return false;
}

// Discards winners that only show through another surface, ITEM_PIXELS pixels per work-item. In: depth, winner. Out:
// valid uchar per pixel of the padded grid, 1 if known.
__kernel void reproject_gaps(const grid_t grid, __global const int *restrict depth, __global const int *winner,
                             __global uchar *restrict valid) {
    const int begin = get_global_id(0) * ITEM_PIXELS, y = get_global_id(1);
    if (begin >= grid.width || y >= grid.height)
        return;
    const int end = MIN(begin + ITEM_PIXELS, grid.width);
    __global const int *line = depth + y * grid.width;
    for (int x = begin; x < end; ++x)
        valid[y * grid.width + x] = line[x] > 0;
    // Most runs lie in one surface. Floats > 0 keep their order as ints, whose extrema PoCL vectorizes.
    int lowest = INT_MAX, highest = 0;
    for (int x = begin; x < end; ++x)
        lowest = MIN(lowest, line[x] > 0 ? line[x] : INT_MAX);
    const int left = MAX(begin - WIDEST_GAP, 0), right = MIN(end + WIDEST_GAP, grid.width);
    for (int i = MAX(y - WIDEST_GAP, 0); i <= MIN(y + WIDEST_GAP, grid.height - 1); ++i)
        for (int x = left; x < right; ++x)
            highest = MAX(highest, depth[i * grid.width + x]);
    if (!(as_float(highest) > SAME_DEPTH * as_float(lowest)))  // nor for the NaN of no winner at all
        return;
    for (int x = begin; x < end; ++x)
        if (line[x] > 0 && shows_through(grid, depth, winner, x, y))
            valid[y * grid.width + x] = 0;
}

// Gathers the winners' values. In: texture float (textures, CHANNELS, rows, columns), by number in surface_t; moved,
// winner, object. Out, on the padded grid: value float (CHANNELS, height, width), radiance; w real, inverse depth in
// 1/mm; coc real, signed radius in px; valid uchar, 1 with a winner; status uchar, 0; seen uchar, with SEVERAL, the
// winner's object. Without a winner all are 0, and seen is NO_OBJECT. With FILL_FAR valid is from reproject_gaps, and
// winners of other pixels do not count.
__kernel void reproject_gather(const grid_t grid, const lens_t lens, __global const float *texture,
                               __global const real *moved, __global const int *winner,
                               __constant surface_t *surfaces, __global const uchar *object, __global float *value,
                               __global real *w, __global real *coc, __global uchar *valid, __global uchar *status,
                               __global uchar *seen) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int at = y * grid.width + x, source = winner[at];
    const bool known = FILL_FAR ? valid[at] : source != NO_WINNER;
    const real inverse_depth = known ? moved[source] : 0;
    if (SEVERAL) {
        seen[at] = known ? object[source] : NO_OBJECT;
        texture += known ? (size_t)surfaces[object[source]].texture * CHANNELS * grid.rows * grid.columns : 0;
    }
    for (int c = 0; c < CHANNELS; ++c)
        value[c * grid.height * grid.width + at] = known ? texture[c * grid.rows * grid.columns + source] : 0;
    w[at] = inverse_depth;
    coc[at] = known ? grid_radius(grid, lens, at, inverse_depth) : 0;
    valid[at] = known;
    status[at] = 0;
}

// Number of the pixel of the padded grid where a line of the frame begins, a row or, from grid.rows on, a column.
static int line_start(const grid_t grid, int line) {
    const int first = grid.guard * grid.width + grid.guard;
    return first + (line < grid.rows ? line * grid.width : line - grid.rows);
}

// Number of the source in a pixel of the frame if that is valid, or else in the nearest valid pixel of its row.
static int outermost_source(const grid_t grid, __global const int *winner, __global const uchar *valid, int at) {
    const int column = at % grid.width - grid.guard;
    for (int i = 0; i < grid.columns; ++i) {
        if (i <= column && valid[at - i])
            return winner[at - i];
        if (column + i < grid.columns && valid[at + i])
            return winner[at + i];
    }
    return 0;
}

// Marks pixels that show the outside of the frame in the reference pose: those beyond the outermost known pixel of
// their line, if that one was within EDGE_PX of the frame's edge on that side. Lines first..end - 1, all rows before
// all columns; for columns marked pixels count as known, with the source of their row's nearest valid pixel. In:
// winner, valid. Out: status 1, or 2 if nothing is filled; it begins with 0.
__kernel void mark_entered(const grid_t grid, const int first, const int end, __global const int *winner,
                           __global const uchar *valid, __global uchar *status) {
    const int line = first + get_global_id(0);
    if (line >= end)
        return;
    const bool is_row = line < grid.rows;
    const int length = is_row ? grid.columns : grid.rows, step = is_row ? 1 : grid.width;
    for (int side = 0; side < 2; ++side) {
        const int start = line_start(grid, line) + (side ? (length - 1) * step : 0), way = side ? -step : step;
        int i = 0;
        while (i < length && !valid[start + i * way] && !status[start + i * way])
            ++i;
        if (i == 0 || i == length)
            continue;
        const int source = outermost_source(grid, winner, valid, start + i * way);
        const int place = is_row ? source % grid.columns : source / grid.columns;
        if ((side ? length - 1 - place : place) > EDGE_PX)
            continue;
        while (i--)
            status[start + i * way] = FILL_AIT || FILL_MEAN_MEDIAN ? 1 : 2;
    }
}

// Copies pixel `from` of the padded grid to pixel `at`.
static void copy_pixel(const grid_t grid, const lens_t lens, __global float *value, __global real *w,
                       __global real *coc, __global uchar *valid, int at, int from) {
    for (int c = 0; c < CHANNELS; ++c)
        value[c * grid.width * grid.height + at] = value[c * grid.width * grid.height + from];
    w[at] = w[from];
    coc[at] = grid_radius(grid, lens, at, w[at]);
    valid[at] = 1;
}

// Mirrors the image into what has entered the frame, about the outermost valid pixels of a line: lines first..end - 1,
// all rows before all columns. In and out, on the padded grid: value, w, coc, valid, status, seen; after the columns,
// pixels that no line reaches have status 2.
__kernel void fill_entered(const grid_t grid, const int first, const int end, const lens_t lens,
                           __global float *value, __global real *w, __global real *coc, __global uchar *valid,
                           __global uchar *status, __global uchar *seen) {
    const int line = first + get_global_id(0);
    if (line >= end)
        return;
    const bool is_row = line < grid.rows;
    const int length = is_row ? grid.columns : grid.rows, step = is_row ? 1 : grid.width;
    const int start = line_start(grid, line);
    int low = 0, high = length - 1;
    while (low < length && !valid[start + low * step])
        ++low;
    while (high > low && !valid[start + high * step])
        --high;
    for (int i = 0; i < length; ++i) {
        const int at = start + i * step;
        if (status[at] != 1 || valid[at])
            continue;
        const int from = low < length ? start + (low + mirror_index(i - low, high - low + 1)) * step : at;
        if (valid[from]) {
            copy_pixel(grid, lens, value, w, coc, valid, at, from);
            if (SEVERAL)
                seen[at] = seen[from];
        } else if (!is_row) {
            status[at] = 2;
        }
    }
}

// Continues the image of depth maps outside of the frame, where they have no data, by its mirror image, as textures
// are. In and out, on the padded grid: value, w, coc, valid as in reproject_gather; pixels outside of the frame that
// are not valid get the values of their mirror image.
__kernel void extend_border(const grid_t grid, const lens_t lens, __global float *value, __global real *w,
                            __global real *coc, __global uchar *valid) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int column = x - grid.guard, row = y - grid.guard, at = y * grid.width + x;
    const bool inside = column >= 0 && column < grid.columns && row >= 0 && row < grid.rows;
    const int from = (mirror_index(row, grid.rows) + grid.guard) * grid.width +
                     mirror_index(column, grid.columns) + grid.guard;
    if (!inside && !valid[at] && valid[from])
        copy_pixel(grid, lens, value, w, coc, valid, at, from);
}

// Extends the range of |radii| in statistics by those of a time sample. In: coc, valid, as in reproject_gather. In and
// out: statistics.
__kernel void note_radii(const grid_t grid, __global const real *coc, __global const uchar *valid,
                         __global int *statistics) {
    const int begin = get_global_id(0) * ITEM_PIXELS, y = get_global_id(1);
    if (begin >= grid.width || y >= grid.height)
        return;
    for (int x = begin; x < MIN(begin + ITEM_PIXELS, grid.width); ++x)
        if (valid[y * grid.width + x])
            note_radius(statistics, coc[y * grid.width + x]);
}
