// Forward warp: the pixels of the frame at rest move and are projected to the nearest pixel of the padded grid
// (thesis, 4.3.3). Twin: clsco/reference/reproject.py.
//
//   target   int per source (pixel of the frame, row-major): pixel of the padded grid that it moves to, -1 for none
//   moved    real per source: its inverse depth after the move, 1/mm, 0 for none
//   winner   int per pixel of the padded grid: lowest source among the nearest that come there, NO_WINNER for none
//
// Depths are compared as floats, so that rounding in the last digit of a double decides nothing: of equal ones the
// first source wins. On CPUs (OWNED) a work-item owns a band of the padded grid and walks the sources that come there
// in their order, without atomics; elsewhere two passes of atomics find the same winners.

#define SNAP 4096  // steps per px: rounding errors far below it cannot move a position across a pixel's edge
#define NO_WINNER INT_MAX
#define SEGMENT 64  // sources whose targets are bounded together

// Pixel of a position in px: snapped to 1/SNAP px, then rounded half up in integers. floor is a call on PoCL.
static int nearest_pixel(real position)
{
    const real far = (real)1e9;
    const real inside = MAX(MIN(position, far), -far);
    const int whole = (int)inside;
    const real steps = (inside - whole) * SNAP + (real)0.5;
    const int truncated = (int)steps, snapped = truncated - (steps < truncated);
    return whole + ((snapped + SNAP / 2) >> 12);
}

// Moves every source. In: surface at rest, pose. Out: target, moved.
__kernel void reproject_targets(const camera_t camera, const surface_t surface, const pose_t pose,
                                __global int *target, __global real *moved)
{
    const int column = get_global_id(0), row = get_global_id(1);
    if (column >= camera.columns || row >= camera.rows)
        return;
    const real3 ray = pixel_ray(camera, row, column);
    uchar root;
    const real w = solve_quadric(&surface, ray, &root);
    // The moved point, times the inverse depth at rest.
    const real3 rest = (real3)(surface.rest[0], surface.rest[1], surface.rest[2]);
    const real3 shift = (real3)(pose.shift[0], pose.shift[1], pose.shift[2]);
    const real3 point = turned(pose.rotation, ray - rest * w) + (rest + shift) * w;
    const real3 image = project(camera, point);
    const int x = nearest_pixel(image.x) + camera.guard, y = nearest_pixel(image.y) + camera.guard;
    const bool used = root && point.z > 0 && x >= 0 && x < camera.width && y >= 0 && y < camera.height;
    const int at = row * camera.columns + column;
    target[at] = used ? y * camera.width + x : -1;
    moved[at] = used ? w / point.z : 0;
}

#if OWNED
// Range of the targets of each SEGMENT sources. Out: bounds int2 (lowest, highest); nothing lies in (INT_MAX, -1).
__kernel void reproject_bounds(const camera_t camera, __global const int *target, __global int2 *bounds)
{
    const int id = get_global_id(0), sources = camera.rows * camera.columns;
    if (id * SEGMENT >= sources)
        return;
    int lowest = INT_MAX, highest = -1;
    for (int i = id * SEGMENT; i < MIN((id + 1) * SEGMENT, sources); ++i) {
        const int t = target[i], used = t < 0 ? INT_MAX : t;
        lowest = MIN(lowest, used);
        highest = MAX(highest, t);
    }
    bounds[id] = (int2)(lowest, highest);
}

// The whole depth test: each work-item owns `band` rows of the padded grid. Out: winner.
__kernel void reproject_nearest(const camera_t camera, __global const int *target, __global const real *moved,
                                __global const int2 *bounds, const int band, __global int *winner)
{
    const int first = get_global_id(0) * band;
    if (first >= camera.height)
        return;
    const int begin = first * camera.width, end = MIN(first + band, camera.height) * camera.width;
    const int sources = camera.rows * camera.columns;
    for (int t = begin; t < end; ++t)
        winner[t] = NO_WINNER;
    for (int segment = 0; segment * SEGMENT < sources; ++segment) {
        const int2 range = bounds[segment];
        if (range.x >= end || range.y < begin)
            continue;
        for (int i = segment * SEGMENT; i < MIN((segment + 1) * SEGMENT, sources); ++i) {
            const int t = target[i];
            if (t < begin || t >= end)
                continue;
            const int other = winner[t];
            if (other == NO_WINNER || (float)moved[i] > (float)moved[other])
                winner[t] = i;
        }
    }
}
#else
// Largest inverse depth that comes to each pixel. In and out: depth, bits of a float per pixel, 0 to begin with;
// floats > 0 keep their order as ints.
__kernel void reproject_depth(const camera_t camera, __global const int *target, __global const real *moved,
                              __global int *depth)
{
    const int i = get_global_id(0);
    if (i >= camera.rows * camera.columns)
        return;
    if (target[i] >= 0)
        atomic_max(depth + target[i], as_int((float)moved[i]));
}

// Lowest source that brings it. In and out: winner, NO_WINNER to begin with.
__kernel void reproject_winner(const camera_t camera, __global const int *target, __global const real *moved,
                               __global const int *depth, __global int *winner)
{
    const int i = get_global_id(0);
    if (i >= camera.rows * camera.columns)
        return;
    const int t = target[i];
    if (t >= 0 && depth[t] == as_int((float)moved[i]))
        atomic_min(winner + t, i);
}
#endif

// What the winners bring. In: texture float (CHANNELS, rows, columns), weight of this moment. Out, on the padded grid:
// value float (CHANNELS, height, width), radiance times weight; w, 1/mm; coc, signed radius in px; valid: there is
// a winner; status 0. All are 0 where there is none.
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
