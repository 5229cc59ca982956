// Makes the sub-pixel sources of pixels that silhouettes.cl has marked. Planes, twin and host: cast.cl.

#include "trace/record.clh"
#include "trace/small.clh"
#include "trace/texture.clh"
#if TEXTURED
#include "trace/detail.clh"
#endif

#if SUBPIXELS
// Empties the slot of a pixel whose sources belong to the other part of the exposure; returns False for another pixel.
static bool is_elsewhere(__global const float *source, int pixel, int slot, __global float4 *sub_source) {
    for (int sub = 0; sub < EACH && source[pixel] == ELSEWHERE; ++sub)
        sub_source[slot * EACH + sub] = (float4)(-1, 0, 0, as_float(WHOLE));
    return source[pixel] == ELSEWHERE;
}

// Makes point sources of these cells, beside outlines of the part of a cell that its surface covers, see outline.clh.
// In: source, sub_label, sub_depth. Out: sub_source float4 (coordinate, tilt right, tilt down, mark), sub_value float
// (CHANNELS, slots, SUBPIXELS^2), sub_depth.
__kernel void trace_subpixels(const grid_t grid, const lens_t lens, __constant surface_t *surfaces, const group_t group,
                              const psf_t psf, __global const float *texture, __constant texture_map_t *maps OF_LIGHT,
                              __global const int *pixels, const int capacity, __global const float *source,
                              __global float4 *sub_source, __global float *sub_value, __global const uchar *sub_label,
                              __global real *sub_depth, __global int *statistics) {
    const int slot = get_global_id(0);
    if (slot >= MIN(statistics[STATISTIC_SLOTS], capacity) || pixels[slot] < 0)
        return;
    const int pixel = pixels[slot], row = FRAME_ROW(grid, pixel / grid.width), column = pixel % grid.width - grid.guard;
    uchar labels[CELLS_AROUND * CELLS_AROUND];
    coverage_t coverage;
    __global const float *marks = MARKS(source, grid.height * grid.width);
#if SMALL
    if (slot != FIRST_SLOT(as_int(marks[pixel])))
        return;  // of a small surface
#endif
    if (is_elsewhere(source, pixel, slot, sub_source))
        return;
#if SMALL
    float left[EACH];
    leave_cells(grid, surfaces, group, row, column, left LIGHT);
#endif
    const bool outlined = labels_around(grid, marks, pixels, sub_label, slot, labels);
    if (outlined)
        cell_coverage(grid, lens, surfaces, row, column, labels, &coverage);
    for (int sub = 0; sub < EACH; ++sub) {
        const int id = slot * EACH + sub, cell = CELL_AROUND(sub);
        const real3 middle = cell_ray(grid, pixel, sub, 0, 0);
        const uchar hit = outlined ? coverage.label[cell] : sub_label[id];  // empty cells may have one, too
        uchar root = hit;
        real3 ray = middle;
        real w = sub_depth[id];
        float covered = 1;
        float2 aside = 0;
        if (outlined && root != 0) {
            aside = (float2)((float)coverage.right[cell], (float)coverage.down[cell]);
            covered = coverage.covered[cell];
        }
        const bool is_moved = aside.x != 0 || aside.y != 0;
        if (is_moved) {
            const real3 moved = cell_ray(grid, pixel, sub, aside.x, aside.y);
            uchar there;
            int object;
            const real moved_w = nearest_surface(surfaces, group, moved, &there, &object);
            // Beside a corner, the moved ray may hit another surface.
            ray = there == root ? moved : ray;
            w = there == root ? moved_w : w;
            root = there == root || hit == sub_label[id] ? root : 0;
        }
        const real depth = sub_depth[id] = hit == sub_label[id] ? sub_depth[id] : w;
#if SMALL
        covered *= left[sub];
#endif
        take_radiance(grid, surfaces, ray, w, root, row, column, SUBPIXELS, SHADE_OF(surfaces, root, ray, w),
                      covered / EACH, texture, maps, sub_value + id, capacity * EACH);
        // The lens is tested from the middle of the cell, as by the blur.
        float4 record = source_record(grid, lens, surfaces, group, psf, ray, bend_along(grid, lens, ray), w, middle,
                                      bend_along(grid, lens, middle), depth, 1, false, &root, statistics);
        if (TILT && QUADRATIC && record.x >= 0 && is_moved && is_at_limb(grid, surfaces, hit, ray))
            record.w = as_float(as_int(record.w) == WHOLE ? LIMB : PARTLY_LIMB);
        sub_source[id] = record;
    }
}

#if SMALL
// Fills the slots of small surfaces, see small.clh. In: source, pixels. Out: sub_source, sub_value, sub_depth, as of
// trace_subpixels.
__kernel void trace_small(const grid_t grid, const lens_t lens, __constant surface_t *surfaces, const group_t group,
                          const psf_t psf, __global const float *texture, __constant texture_map_t *maps OF_LIGHT,
                          __global const int *pixels, const int capacity, __global const float *source,
                          __global float4 *sub_source, __global float *sub_value, __global real *sub_depth,
                          __global int *statistics) {
    const int slot = get_global_id(0);
    if (slot >= MIN(statistics[STATISTIC_SLOTS], capacity) || pixels[slot] < 0)
        return;
    const int pixel = pixels[slot], row = FRAME_ROW(grid, pixel / grid.width), column = pixel % grid.width - grid.guard;
    const int mark = as_int(MARKS(source, grid.height * grid.width)[pixel]), number = slot - FIRST_SLOT(mark);
    if (number < 1 || number > mark >> SLOT_BITS || is_elsewhere(source, pixel, slot, sub_source))
        return;
    ulong small = small_members(grid, surfaces, group, row, column);
    for (int i = 1; i < number; ++i)
        small &= small - 1;
    const int object = (int)popcount((small & -small) - 1);
    float4 cover[EACH];
    small_cover(grid, surfaces, group, object, row, column, cover LIGHT);
    for (int sub = 0; sub < EACH; ++sub) {
        const int id = slot * EACH + sub;
        const float4 own = cover[sub];
        if (!(own.x > 0)) {
            sub_source[id] = (float4)(-1, 0, 0, as_float(WHOLE));
            continue;
        }
        const real3 ray = pixel_ray(grid, row + own.z / own.x, column + own.y / own.x);
        const real3 middle = cell_ray(grid, pixel, sub, 0, 0);
        const real w = small_depth(surfaces + object, group, ray);
        sub_depth[id] = w;
        uchar root;
        const real hit = solve_root(surfaces + object, ray, group.root, &root);
        take_radiance(grid, surfaces, ray, root ? hit : w, 2 * object + 1, row, column, SUBPIXELS, own.w / own.x,
                      own.x / EACH, texture, maps, sub_value + id, capacity * EACH);
        root = 2 * object + 1;
        sub_source[id] = source_record(grid, lens, surfaces, group, psf, ray, bend_along(grid, lens, ray), w, middle,
                                       bend_along(grid, lens, middle), w, 1, true, &root, statistics);
    }
}
#endif

#if TEXTURED
// Makes the point sources of pixels that are marked for their textures alone, see detail.clh.
__kernel void trace_detail(const grid_t grid, const lens_t lens, __constant surface_t *surfaces, const group_t group,
                           const psf_t psf, __global const float *texture, __constant texture_map_t *maps OF_LIGHT,
                           __global const int *pixels, const int capacity, __global const float *source,
                           __global float4 *sub_source, __global float *sub_value, __global real *sub_depth,
                           __global int *statistics) {
    const int slot = get_global_id(0);
    if (slot >= MIN(statistics[STATISTIC_SLOTS], capacity) || pixels[slot] >= 0)
        return;
    const int code = -1 - pixels[slot], at = code / 2, fine = code & 1, parts = fine ? FINE_PARTS : FEW_PARTS;
    if (is_elsewhere(source, at, slot, sub_source))
        return;
    const int row = FRAME_ROW(grid, at / grid.width), column = at % grid.width - grid.guard;
    const real3 ray = pixel_ray(grid, row, column);
    uchar root;
    int object;
    const real w = nearest_surface(surfaces, group, ray, &root, &object);
    const lens_t here = lens_along(grid, lens, ray);
    const real middle = blur_radius(here, ray, w);
    const real2 slope = surface_slope(surfaces + object, ray, w);
    const bend_t bend = bend_along(grid, lens, ray);
    const real2 gradient = blur_gradient(grid, here, bend, slope, ray, w);
#if OCCLUDED
    bool edge;
    real spread = middle;
    float2 tilt = TILT ? pixel_tilt(gradient, middle, &spread) : (float2)(0, 0);
    if (TILT && ELLIPSES)
        tilt += ellipse_tilt(grid, bend);
    const division_t division = division_of(middle, psf.lens_extent, 1, tilt);
    visibility_t visibility;
    const int seen = check_visibility(here, surfaces, group, ray, w, division, SHARED ? &visibility : 0, &edge);
    // All sources see the lens as the pixel's middle does if their radius changes little, and the lens is not wide.
    const real most = ABS(middle) + (real)0.5 * (ABS(gradient.x) + ABS(gradient.y));
    const bool shared = SHARED && most * psf.lens_extent < WIDE_LENS && visibility.nearest >= SHARED_PLACE &&
                        size2(gradient.x, gradient.y) * psf.lens_extent <= 1;
    int behind_rims = seen == PARTLY ? PARTLY : RIM_STATE(here, psf, ray, w, middle, division);
    const bool partly = behind_rims != CLEAR;
#endif
    float values[FINE_PARTS * FINE_PARTS * CHANNELS];
    detailed_texture(texture, surfaces + object, maps + object, grid, ray, w, middle, fine, values);
    const float share = SHADE(surfaces, object, ray, w);
    for (int sub = 0; sub < EACH; ++sub) {
        const int i = sub / SUBPIXELS, j = sub % SUBPIXELS, id = slot * EACH + sub;
        const real right = (j + (real)0.5) / SUBPIXELS - (real)0.5, down = (i + (real)0.5) / SUBPIXELS - (real)0.5;
        const real radius = middle + (right * gradient.x + down * gradient.y);
        note_radius(statistics, radius);
        float4 record = (float4)(table_coordinate(psf, radius, 1), 0, 0, as_float(WHOLE));
        // In its own pixel, a source is visible from all of the lens until its disc crosses the pixel's border.
        if (TILT)
            record.yz = tilt_slope(gradient, radius) * MIN((float)ABS(radius), 1.0f);
        if (TILT && ELLIPSES)
            record.yz += ellipse_tilt(grid, bend);
#if OCCLUDED
        const real2 aside = ray_change(grid, ray, right, -down);
        sub_depth[id] = w + aside.x * slope.x + aside.y * slope.y;
        if (shared) {
            record.x = seen == HIDDEN ? -1 : record.x;
            record.w = as_float(partly ? PARTLY_SHARED : WHOLE);
        } else if (partly) {
            const real3 towards = pixel_ray(grid, row + down, column + right);
            const division_t own = division_of(radius, psf.lens_extent, (real)1 / SUBPIXELS, record.yz);
            const lens_t there = lens_along(grid, lens, towards);
            int own_seen = check_visibility(there, surfaces, group, towards, sub_depth[id], own, 0, &edge);
            own_seen = MAX(own_seen, RIM_STATE(there, psf, towards, sub_depth[id], radius, own));
            record.x = own_seen == HIDDEN ? -1 : record.x;
            record.w = as_float(own_seen == PARTLY ? PARTLY_OCCLUDED : WHOLE);
        }
#endif
        sub_source[id] = record;
        const int part = (i * parts / SUBPIXELS) * parts + j * parts / SUBPIXELS;
        for (int c = 0; c < CHANNELS; ++c)
            sub_value[c * capacity * EACH + id] = OF_CHANNEL(share, c) * (1.0f / EACH) * values[part * CHANNELS + c];
    }
}

// Radiance after the exchange between neighbors that compensates for sources that are squares, for textures on
// surfaces, see footprint.clh. Only pixels with one source take part, which are at least 2 px from other objects. In:
// value, share, marks of source. Out: sharper, as value.
__kernel void sharpen(const grid_t grid, __global const float *value, __global const float *share,
                      __global float *source, __global float *sharper) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int at = y * grid.width + x, plane = grid.height * grid.width;
    __global const float *marks = MARKS(source, plane);
    float shares[4] = {0};
    const int neighbors[4] = {at - 1, at + 1, at - grid.width, at + grid.width};
    const bool there[4] = {x > 0, x < grid.width - 1, y > 0, y < grid.height - 1};
    const bool alone = as_int(marks[at]) < 0;
    for (int k = 0; k < 4; ++k)
        if (alone && there[k] && as_int(marks[neighbors[k]]) < 0 && share[at] > 0 && share[neighbors[k]] > 0)
            shares[k] = 0.5f * (share[at] + share[neighbors[k]]);
    for (int c = 0; c < CHANNELS; ++c) {
        const float own = value[c * plane + at];
        float sum = own;
        for (int k = 0; k < 4; ++k)
            if (shares[k] > 0)
                sum += shares[k] * (own - value[c * plane + neighbors[k]]);
        sharper[c * plane + at] = sum;
    }
}
#endif
#endif
