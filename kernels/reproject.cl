// Forward warp: the pixels of the frame at rest move and are projected to the nearest pixel of the padded grid
// (thesis, 4.3.3). Twin: clsco/reference/reproject.py.
//
//   rest     real per source (pixel of the frame, row-major): inverse depth at rest, 1/mm, 0 for no surface
//   target   int per source: pixel of the padded grid that it moves to, -1 for none
//   moved    real per source: its inverse depth after the move, 1/mm, 0 for none
//   winner   int per pixel of the padded grid: lowest source among the nearest that come there, NO_WINNER for none
//
// Depths are compared as floats, so that rounding in the last digit of a double decides nothing: of equal ones the
// first source wins. On CPUs (OWNED) a work-item owns a band of the padded grid and walks the sources that come there
// in their order, without atomics; elsewhere two passes of atomics find the same winners.
// Features besides geometry.clh's: OWNED.

// The position p of a source in px is snapped to 1/4096 px and then rounded half up, so that errors far below a step
// cannot move it across a pixel's edge. Both roundings in one are floor(p + ROUND).
#define ROUND ((real)(0.5 + 0.5 / 4096))
#define NO_WINNER INT_MAX

// Sources of a row that a work-item moves. PoCL vectorizes a loop over them, but not work-items of one source each.
#if OWNED
#define SEGMENT 64
#else
#define SEGMENT 1
#endif

// Inverse depth of every source; `surface` is at rest. Out: rest.
__kernel void reproject_rest(const camera_t camera, __constant surface_t *surface, __global real *rest)
{
    const int column = get_global_id(0), row = get_global_id(1);
    if (column >= camera.columns || row >= camera.rows)
        return;
    uchar root;
    rest[row * camera.columns + column] = solve_quadric(surface, pixel_ray(camera, row, column), &root);
}

// Moves every source about the center of `surface` at rest. In: rest. Out: target, moved, and with OWNED bounds int2
// per SEGMENT of a row: lowest and highest target there, (INT_MAX, -1) for none.
__kernel void reproject_targets(const camera_t camera, __constant surface_t *surface, __constant pose_t *pose,
                                __global const real *restrict rest, __global int *restrict target,
                                __global real *restrict moved
#if OWNED
                                , __global int2 *restrict bounds
#endif
)
{
    const int id = get_global_id(0), each = (camera.columns + SEGMENT - 1) / SEGMENT, row = id / each;
    if (row >= camera.rows)
        return;
    const int begin = id % each * SEGMENT, end = MIN(begin + SEGMENT, camera.columns);
    // With the ray r, R r + w offset is the moved point times w. Component by component, and the divisions taken out:
    // PoCL vectorizes no loop that computes with vectors.
    __constant real *R = pose->rotation, *center = surface->rest;
    const real3 turn = turned(R, (real3)(center[0], center[1], center[2]));
    const real3 offset = (real3)(center[0] + pose->shift[0] - turn.x, center[1] + pose->shift[1] - turn.y,
                                 center[2] + pose->shift[2] - turn.z);
    const real3 ray = pixel_ray(camera, row, 0);
    const real3 line = (real3)(R[1] * ray.y + R[2], R[4] * ray.y + R[5], R[7] * ray.y + R[8]);
    const real middle = (real)0.5 * (camera.columns - 1), inverse_step = 1 / camera.step;
    // Where a position is 0 on the padded grid, and one more, so that what is negative is below 1.
    const real right = middle + (camera.guard + 1) + ROUND;
    const real down = (real)0.5 * (camera.rows - 1) + (camera.guard + 1) + ROUND;
    int lowest = INT_MAX, highest = -1;
    for (int column = begin; column < end; ++column) {
        const int at = row * camera.columns + column;
        const real w = rest[at], x = camera.step * (column - middle);
        const real px = R[0] * x + line.x + offset.x * w;
        const real py = R[3] * x + line.y + offset.y * w;
        const real pz = R[6] * x + line.z + offset.z * w;
        const real nearness = 1 / pz, scale = nearness * inverse_step;
        const real i = down - py * scale, j = right + px * scale;
        const bool used = w > 0 && pz > 0 && i >= 1 && i < camera.height + 1 && j >= 1 && j < camera.width + 1;
        const int to = (int)(used ? i : 1) * camera.width + (int)(used ? j : 0) - camera.width - 1;
        target[at] = to;
        moved[at] = used ? w * nearness : 0;
        lowest = MIN(lowest, used ? to : INT_MAX);
        highest = MAX(highest, to);
    }
#if OWNED
    bounds[id] = (int2)(lowest, highest);
#endif
}

#if OWNED
// The whole depth test: each work-item owns `band` rows of the padded grid. In: target, moved, bounds. Out: winner.
__kernel void reproject_nearest(const camera_t camera, __global const int *target, __global const real *moved,
                                __global const int2 *bounds, const int band, __global int *winner)
{
    const int first = get_global_id(0) * band;
    if (first >= camera.height)
        return;
    const int begin = first * camera.width, end = MIN(first + band, camera.height) * camera.width;
    const int each = (camera.columns + SEGMENT - 1) / SEGMENT;
    for (int to = begin; to < end; ++to)
        winner[to] = NO_WINNER;
    for (int segment = 0; segment < camera.rows * each; ++segment) {
        const int2 range = bounds[segment];
        if (range.x >= end || range.y < begin)
            continue;
        const int row = segment / each, column = segment % each * SEGMENT;
        const int from = row * camera.columns + column, sources = MIN(SEGMENT, camera.columns - column);
        for (int i = from; i < from + sources; ++i) {
            const int to = target[i];
            if (to < begin || to >= end)
                continue;
            const int other = winner[to];
            if (other == NO_WINNER || (float)moved[i] > (float)moved[other])
                winner[to] = i;
        }
    }
}
#else
// Largest inverse depth that comes to each pixel. In: target, moved. In and out: depth, bits of a float per pixel of
// the padded grid, 0 to begin with; floats > 0 keep their order as ints.
__kernel void reproject_depth(const camera_t camera, __global const int *target, __global const real *moved,
                              __global int *depth)
{
    const int i = get_global_id(0);
    if (i >= camera.rows * camera.columns)
        return;
    if (target[i] >= 0)
        atomic_max(depth + target[i], as_int((float)moved[i]));
}

// Lowest source that brings it. In: target, moved, depth. In and out: winner, NO_WINNER to begin with.
__kernel void reproject_winner(const camera_t camera, __global const int *target, __global const real *moved,
                               __global const int *depth, __global int *winner)
{
    const int i = get_global_id(0);
    if (i >= camera.rows * camera.columns)
        return;
    const int to = target[i];
    if (to >= 0 && depth[to] == as_int((float)moved[i]))
        atomic_min(winner + to, i);
}
#endif

// What the winners bring. In: texture float (CHANNELS, rows, columns), moved, winner; weight of this moment in the
// exposure. Out, on the padded grid: value float (CHANNELS, height, width), radiance times weight; w real, inverse
// depth in 1/mm; coc real, signed radius in px; valid uchar, there is a winner; status uchar, 0. All 0 without one.
__kernel void reproject_gather(const camera_t camera, const float weight, __global const float *texture,
                               __global const real *moved, __global const int *winner, __global float *value,
                               __global real *w, __global real *coc, __global uchar *valid, __global uchar *status)
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= camera.width || y >= camera.height)
        return;
    const int at = y * camera.width + x, source = winner[at];
    const bool known = source != NO_WINNER;
    const real inverse_depth = known ? moved[source] : 0;
    for (int c = 0; c < CHANNELS; ++c)
        value[c * camera.height * camera.width + at] =
            known ? weight * texture[c * camera.rows * camera.columns + source] : 0;
    w[at] = inverse_depth;
    coc[at] = known ? blur_radius(camera, inverse_depth) : 0;
    valid[at] = known;
    status[at] = 0;
}
