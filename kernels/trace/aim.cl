// Makes sources of the hits of `cast` for a lens. Planes: cast.cl. Twin: clsco/reference/trace/trace.py. Host:
// clsco/passes/trace.py.

#include "trace/record.clh"
#include "trace/small.clh"
#if TEXTURED && SUBPIXELS
#include "trace/footprint.clh"
#endif

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
// extents, as predicted for each object; spare: outer px of the guard band, without sources. Out: source, null if the
// blur needs none; statistics; with textures on surfaces share; the bit EDGE of labels.
__kernel void aim(const grid_t grid, const lens_t lens, __constant surface_t *surfaces, const group_t group,
                  const psf_t psf, __global const real *depth, __global uchar *label, __global float *source,
                  __global int *statistics, __constant real *extents, const int spare,
                  __global const float *value, __constant texture_map_t *maps,
                  __global float *share OF_SLOPES OF_BENDS OF_CHANGES) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int at = y * grid.width + x, row = FRAME_ROW(grid, y), column = x - grid.guard, far = grid.guard - spare;
    const real3 ray = KEPT_RAY(grid, at, row, column);
    const bend_t bend = KEPT_BEND(grid, lens, at, ray);
    const bool needed = row >= -far && row < grid.frame_rows + far && column >= -far && column < grid.columns + far;
    const uchar hit = needed ? label[at] & ~EDGE : 0;
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
    const ulong small = needed ? small_members(grid, surfaces, group, row, column) : 0;
    if (small || (needed && is_hidden_by_small(grid, surfaces, group, row, column, hit ? depth[at] : 0)))
        record.w = as_float(SMALL_WITHIN - (int)popcount(small));
#endif
#if DIVIDED
    const bool within = as_int(record.w) <= SMALL_WITHIN;
    if (is_changing(grid, changes, depth, label, within, x, y) != (changing != 0))
        record.x = ELSEWHERE;
#endif
    if (source)
        put_source(source, grid.height * grid.width, at, record);
    if (SEVERAL && hit && is_beyond(extents + 6 * ((hit - 1) / 2), ray, depth[at]))
        atomic_max(statistics + STATISTIC_BEYOND, 1);
    if (SUBPIXELS * OCCLUDED > 0 && needed)
        label[at] = root;
}
