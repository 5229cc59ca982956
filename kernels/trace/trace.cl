// Casts rays against analytic surfaces: the sources of one time sample. Along a ray r, w = 1/Z solves
// C w^2 + 2 B w + A = 0 (common/geometry.clh); the blur radius is R = blur_scale (focus_power - w) (2.33). Twin:
// clsco/reference/trace/trace.py. Host: clsco/passes/trace.py, for all scenes of analytic surfaces.
//
// Planes cover the frame, or a strip of its rows, and an apron of sources that reach it: (height, width), row-major.
//   source  planes, see common/sources.clh
//   value   float (CHANNELS, height, width): radiance
//   label   uchar (height, width): 0 no surface, else root and object of the hit (`nearest_surface`), and bit EDGE
//   depth   real (height, width): inverse depth
//   texture float (textures, CHANNELS, frame_rows, columns), by number in surface_t; then mipmaps of textures that lie
//           on surfaces, float (sides, rows, columns, CHANNELS) per level, which begin where texture_map_t says
// Square roots and floors as single instructions took a plane from 36 to 12 ns per pixel; casting once for all lenses
// of a sweep took the prepass from 31 to 6 ns, plus 20 per lens.

#include "common/geometry.clh"
#include "common/visibility_test.clh"
#include "common/sources.clh"
#include "trace/texture.clh"
#include "trace/small.clh"

// State of the lens behind its rims, see `meet_rims`.
#if RIMS
#define RIM_STATE(lens, psf, ray, w, radius, division) meet_rims(lens, psf, ray, w, radius, division, 0)
#else
#define RIM_STATE(lens, psf, ray, w, radius, division) CLEAR
#endif
#define EDGE 128  // bit of a label: the hit is behind an odd number of surfaces, or the pixel may show more

// Record of the source at a hit; its coordinate is negative if none of its light reaches the lens. Radius and tilt are
// those of the hit; visibility is tested on seen_ray, at inverse depth seen_w. bend, seen_bend: of the two rays;
// subpixel: 1 for one of SUBPIXELS^2 sources; small: True on a small surface. In and out: label, statistics.
static float4 source_record(const grid_t grid, lens_t lens, __constant surface_t *surfaces, const group_t group,
                            const psf_t psf, real3 ray, bend_t bend, real w, real3 seen_ray, bend_t seen_bend,
                            real seen_w, int subpixel, bool small, uchar *label, __global int *statistics) {
    float4 record = (float4)(-1, 0, 0, as_float(WHOLE));
    if (*label == 0)
        return record;
    lens_t seen_lens = lens;
    seen_lens.blur_scale *= seen_bend.stretch;
    lens.blur_scale *= bend.stretch;
    const real radius = bent_radius(lens, bend.focus, w);
    __constant surface_t *surface = surfaces + (*label - 1) / 2;
    float2 tilt = 0;
    real spread = radius;
    if (TILT) {
        real2 slope = surface_slope(surface, ray, w);
        if (small)
            outline_plane(surface, ray, &slope);
        const real2 gradient = blur_gradient(grid, lens, bend, slope, ray, w);
        tilt = subpixel ? tilt_slope(gradient, radius) : pixel_tilt(gradient, radius, &spread);
        if (ELLIPSES)
            tilt += ellipse_tilt(grid, seen_bend);
    }
#if OCCLUDED
    bool edge;
    const real size = bent_radius(seen_lens, seen_bend.focus, seen_w);
    const division_t division = division_of(size, psf.lens_extent, subpixel ? (real)1 / SUBPIXELS : 1, tilt);
    int seen = check_visibility(seen_lens, surfaces, group, seen_ray, seen_w, division, 0, &edge);
    const int partly = seen == CLEAR && !subpixel ? CUT : PARTLY_OCCLUDED;
    seen = MAX(seen, RIM_STATE(seen_lens, psf, seen_ray, seen_w, size, division));
    *label |= edge ? EDGE : 0;
    if (seen == HIDDEN)
        return record;
    record.w = as_float(seen == PARTLY ? partly : WHOLE);
#endif
    note_radius(statistics, spread);
    record.x = table_coordinate(psf, spread, subpixel);
    record.yz = tilt;
    return record;
}

// Writes the radiance of a hit, times its `part` of the pixel, to a plane of `values` per channel; 0 without a hit.
// share: of the texture that light leaves; sources: per axis of a pixel. Returns what `surface_texture` does, 0 for a
// projected one.
static float take_radiance(const grid_t grid, __constant surface_t *surfaces, real3 ray, real w, uchar label, int row,
                           int column, int sources, float share, float part,
                           __global const float *texture, __constant texture_map_t *maps, __global float *values,
                           int plane) {
    const int object = MAX(label - 1, 0) / 2;
    __constant surface_t *surface = surfaces + object;
    if (TEXTURED && label && maps[object].kind != MAP_PROJECTED) {
        float mean[CHANNELS];
        const float texels = surface_texture(texture, surface, maps + object, grid, ray, w, sources, mean);
        for (int c = 0; c < CHANNELS; ++c)
            values[c * plane] = OF_CHANNEL(share, c) * part * mean[c];
        return texels;
    }
    const real3 point = label ? texture_point(surface, grid, ray, w, row, column) : (real3)(0, 0, 0);
    for (int c = 0; c < CHANNELS; ++c)
        values[c * plane] = label ? OF_CHANNEL(share, c) * part * radiance(texture, surface, grid, c, point) : 0;
    return 0;
}

// Casts rays through all pixels of frame and apron at the objects of an occlusion group, for all lenses. Out: value,
// depth, label. With textures on surfaces, value has one more plane: the result of `surface_texture`.
__kernel void cast(const grid_t grid, __constant surface_t *surfaces, const group_t group,
                   __global const float *texture, __constant texture_map_t *maps OF_LIGHT, __global float *value,
                   __global real *depth, __global uchar *label OF_SLOPES) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int row = FRAME_ROW(grid, y), column = x - grid.guard, at = y * grid.width + x;
    const real3 ray = KEPT_RAY(grid, at, row, column);
    uchar root;
    int object;
    const real w = nearest_surface(surfaces, group, ray, &root, &object);
    depth[at] = w;
    label[at] = root;
    const int plane = grid.height * grid.width;
    const float texels = take_radiance(grid, surfaces, ray, w, root, row, column, 1,
                                       SHADE_OF(surfaces, root, ray, w), 1, texture, maps, value + at, plane);
    if (TEXTURED)
        value[CHANNELS * plane + at] = texels;
}

// True if a hit is outside an object's extent: low and high x and y of rays, and inverse depth.
static bool is_beyond(__constant real *extent, real3 ray, real w) {
    return !(ray.x >= extent[0] && ray.x <= extent[1] && ray.y >= extent[2] && ray.y <= extent[3] &&
             w >= extent[4] && w <= extent[5]);
}

// Mark of a pixel: DETAILED or FINE if one source cannot stand for it, else WHOLE. texels: squared number of texels;
// radius: signed, px.
static int detail_of(__constant texture_map_t *map, float texels, real radius) {
    const float r = (float)(map->spread * ABS(radius));
    const bool finer = texels > (float)FINE_TEXELS * (float)FINE_TEXELS;
    const float most = finer ? (float)FINE_MOST : (float)DETAILED_MOST;
    if (texels <= (float)DETAILED_TEXELS * (float)DETAILED_TEXELS || r <= (float)map->least || r >= most)
        return WHOLE;
    return finer || r < (float)NEAR_FOCUS ? FINE : DETAILED;
}

// Makes the sources of all hits for one lens. In: depth, label, and with textures on surfaces value, from `cast`;
// extents, as predicted for each object. Out: source, a null pointer if the blur needs none; statistics; with textures
// on surfaces share; the bit EDGE of labels.
__kernel void aim(const grid_t grid, const lens_t lens, __constant surface_t *surfaces, const group_t group,
                  const psf_t psf, __global const real *depth, __global uchar *label, __global float *source,
                  __global int *statistics, __constant real *extents, __global const float *value,
                  __constant texture_map_t *maps, __global float *share OF_SLOPES OF_BENDS) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int at = y * grid.width + x;
    const real3 ray = KEPT_RAY(grid, at, FRAME_ROW(grid, y), x - grid.guard);
    const bend_t bend = KEPT_BEND(grid, lens, at, ray);
    const uchar hit = label[at] & ~EDGE;
    uchar root = hit;
    float4 record = source_record(grid, lens, surfaces, group, psf, ray, bend, depth[at], ray, bend, depth[at], 0,
                                  false, &root, statistics);
#if TEXTURED && SUBPIXELS
    __constant texture_map_t *map = maps + MAX(hit - 1, 0) / 2;
    share[at] = 0;
    if (record.x >= 0 && map->kind != MAP_PROJECTED) {
        const real radius = blur_radius(lens_along(grid, lens, ray), ray, depth[at]);
        const int detail = detail_of(map, value[CHANNELS * grid.height * grid.width + at], radius);
        record.w = detail == WHOLE ? record.w : as_float(detail);
        share[at] = sharpening(map, radius);
    }
#endif
#if SMALL && SUBPIXELS
    const ulong small = small_members(grid, surfaces, group, FRAME_ROW(grid, y), x - grid.guard);
    if (small || is_hidden_by_small(grid, surfaces, group, FRAME_ROW(grid, y), x - grid.guard, hit ? depth[at] : 0))
        record.w = as_float(SMALL_WITHIN - (int)popcount(small));
#endif
    if (source)
        put_source(source, grid.height * grid.width, at, record);
    if (SEVERAL && hit && is_beyond(extents + 6 * ((hit - 1) / 2), ray, depth[at]))
        atomic_max(statistics + STATISTIC_BEYOND, 1);
    if (SUBPIXELS * OCCLUDED > 0)
        label[at] = root;
}

#if SUBPIXELS
// Gives a slot to every pixel within 2 px of a change of label, and to those whose texture is DETAILED or FINE, and
// more slots to pixels with small surfaces; a work-item has a run of TAP_LANES pixels. The order of slots varies, their
// contents do not. A pixel that got slots in a launch with less capacity keeps them. In: label. Out: marks of source;
// pixels (slots), index p of the pixel, or -1 - 2 p if it is only DETAILED, -2 - 2 p if only FINE; statistics.
__kernel void mark_silhouettes(const grid_t grid, __global const uchar *label, const int capacity,
                               __global float *source, __global int *pixels, __global int *statistics) {
    const int begin = get_global_id(0) * TAP_LANES, y = get_global_id(1);
    if (begin >= grid.width || y >= grid.height)
        return;
    const bool alike = has_one_label(grid, label, begin, y);
    if (TEXTURED + SMALL == 0 && alike)
        return;
    __global float *marks = MARKS(source, grid.height * grid.width);
    for (int x = begin; x < MIN(begin + TAP_LANES, grid.width); ++x) {
        const int at = y * grid.width + x;
        const int mark = as_int(marks[at]);
        if (mark >= 0)
            continue;
        bool fine = TEXTURED && mark == FINE, detailed = fine | (TEXTURED && mark == DETAILED);
        bool differs = SMALL && mark <= SMALL_WITHIN;
        differs = differs || (!alike && is_at_silhouette(grid, label, x, y));
        const int more = SMALL ? MAX(SMALL_WITHIN - mark, 0) : 0;
        if (!differs && !detailed)
            continue;
        const int slot = atomic_add(statistics + STATISTIC_SLOTS, 1 + more);
        for (int i = slot; i < MIN(slot + more + 1, capacity); ++i)
            pixels[i] = differs ? at : -1 - 2 * at - fine;
        if (slot + more >= capacity)
            continue;
        marks[at] = as_float(MARK_OF(slot, more));
    }
}

// Casts rays through the middles of SUBPIXELS x SUBPIXELS cells of every marked pixel at all surfaces that are not
// small. Out, per slot and cell in row-major order: sub_label uchar, without EDGE; sub_depth real.
__kernel void label_subpixels(const grid_t grid, __constant surface_t *surfaces, const group_t group,
                              __global const int *pixels, const int capacity, __global uchar *sub_label,
                              __global real *sub_depth, __global const int *statistics) {
    const int slot = get_global_id(0);
    if (slot >= MIN(statistics[STATISTIC_SLOTS], capacity) || pixels[slot] < 0)
        return;
    const int pixel = pixels[slot];
    group_t behind = group;
#if SMALL
    behind.members &= ~small_members(grid, surfaces, group, FRAME_ROW(grid, pixel / grid.width),
                                     pixel % grid.width - grid.guard);
#endif
    for (int sub = 0; sub < EACH; ++sub) {
        uchar root;
        int object;
        const real3 ray = cell_ray(grid, pixel, sub, 0, 0);
        sub_depth[slot * EACH + sub] = nearest_surface(surfaces, behind, ray, &root, &object);
        sub_label[slot * EACH + sub] = !SMALL || behind.members ? root : 0;
    }
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
    if (number < 1 || number > mark >> SLOT_BITS)
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
                           __global const int *pixels, const int capacity, __global float4 *sub_source,
                           __global float *sub_value, __global real *sub_depth, __global int *statistics) {
    const int slot = get_global_id(0);
    if (slot >= MIN(statistics[STATISTIC_SLOTS], capacity) || pixels[slot] >= 0)
        return;
    const int code = -1 - pixels[slot], at = code / 2, fine = code & 1, parts = fine ? FINE_PARTS : FEW_PARTS;
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

// Makes the pinhole image of an occlusion group, for `layered` occlusion. Out: value, as above; coc real, signed R in
// px, and valid uchar, (height, width); statistics.
__kernel void pinhole(const grid_t grid, const lens_t lens, __constant surface_t *surfaces, const group_t group,
                      __global const float *texture, __constant texture_map_t *maps OF_LIGHT, __global float *value,
                          __global real *coc, __global uchar *valid, __global int *statistics OF_SLOPES OF_BENDS) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int row = FRAME_ROW(grid, y), column = x - grid.guard, at = y * grid.width + x;
    const real3 ray = KEPT_RAY(grid, at, row, column);
    uchar root;
    int object;
    const real w = nearest_surface(surfaces, group, ray, &root, &object);
    take_radiance(grid, surfaces, ray, w, root, row, column, 1, SHADE_OF(surfaces, root, ray, w), 1,
                  texture, maps, value + at, grid.height * grid.width);
    const bend_t bend = KEPT_BEND(grid, lens, at, ray);
    coc[at] = root ? bend.stretch * bent_radius(lens, bend.focus, w) : 0;
    valid[at] = root != 0;
    if (root)
        note_radius(statistics, coc[at]);
}
