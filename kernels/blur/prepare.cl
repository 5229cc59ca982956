// Makes the sources of a map of blur radii, for an image instead of surfaces. Twin: clsco/reference/blur/blur.py. Host:
// clsco/passes/blur.py, for all methods of blur.

#include "common/sources.clh"
#if RIMS && OCCLUDED
#include "common/source_visibility.clh"
#endif

#pragma OPENCL FP_CONTRACT ON

#if PREPARE
#if PREPARE == 2
typedef float map_t;
#else
typedef real map_t;
#endif
#define MAPS __global const map_t *restrict coc, __global const uchar *restrict valid
#define RADIUS(at) (real)(coc[at])
#define IS_THERE(at) (PREPARE == 2 || valid[at])
#define ALL_THERE(at) (PREPARE == 2 || LOAD_EIGHT_BYTES(valid + (at)) == 0x0101010101010101ul)

// Difference of the radius per px along one axis: central, one-sided at an edge, 0 without neighbors.
static real difference(MAPS, int at, int step, bool before, bool after) {
    before = before && IS_THERE(at - step);
    after = after && IS_THERE(at + step);
    if (before && after)
        return (real)0.5 * (RADIUS(at + step) - RADIUS(at - step));
    if (after)
        return RADIUS(at + step) - RADIUS(at);
    return before ? RADIUS(at) - RADIUS(at - step) : 0;
}

#if RIMS && OCCLUDED
#define OF_RIMS , const lens_t lens, __global real *restrict depth
#define RIM_VALUES , lens, depth
// Share of the lens's light that rims let through to each pixel of the frame from its point in focus, whatever the
// scene has there. For depth layers. In: lens_cells. Out: open float (rows, columns).
__kernel void open_share(const grid_t grid, const psf_t psf, const lens_t lens, __constant float *lens_cells,
                         __global float *open) {
    const int column = get_global_id(0), row = get_global_id(1);
    if (column >= grid.columns || row >= grid.rows)
        return;
    const real3 ray = pixel_ray(grid, grid.top + row, column);
    const lens_t here = lens_along(grid, lens, ray);
    const division_t division = division_of(0, psf.lens_extent, 1, (float2)(0, 0));
    visibility_t visibility;
    const int found = meet_rims(here, psf, ray, blur_radius(here, ray, 0) / here.blur_scale, 0, division, &visibility);
#if CUT_CHORDS
    opening_t whole = {.size = (float)LEAST_OPENING}, cut;
#if BORDERS
    whole.borders = lens_cells + 2 * LENS_ROW * LENS_ROW + 3 * EDGES;
    whole.turned = whole.size;
#endif
    cut = whole;
    cut.cut = &visibility;
    const lanes_t none = 0, passed = open_weight(cut, none, none), all = open_weight(whole, none, none);
    const float share = FIRST_LANE(passed) / FIRST_LANE(all);
#else
    lanes_t passed = 0, whole = 0;
    for (int i = 0; i < LENS_ROW && found == PARTLY; ++i)
        for (int j = 0; j < LENS_ROW; j += LANE_COUNT) {
            const lanes_t x = LANE_OFFSETS + (j + 0.5f - LENS_CELLS), y = i + 0.5f - LENS_CELLS;
            const lanes_t weight = *(__constant unaligned_lanes_t *)(lens_cells + i * LENS_ROW + j);
            passed += weight * rim_share(&visibility, x, y);
            whole += weight;
        }
    const float share = LANE_SUM(passed) / LANE_SUM(whole);
#endif
    open[row * grid.columns + column] = found == PARTLY ? share : found == CLEAR;
}
#else
#define OF_RIMS
#define RIM_VALUES
#endif

// One source from a map of signed radii. Rims mark it if they cut its light, and make its coordinate negative if they
// block it. Out: depth.
static float4 record_of(const grid_t grid, const psf_t psf, MAPS, int x, int y OF_RIMS) {
    const int w = grid.width, at = y * w + x;
    float4 record = (float4)(-1, 0, 0, as_float(WHOLE));
    if (!IS_THERE(at))
        return record;
    const real radius = RADIUS(at);
    record.x = table_coordinate(psf, radius, 0);
    if (TILT)
        record.yz = tilt_slope((real2)(difference(coc, valid, at, 1, x > 0, x + 1 < w),
                                       difference(coc, valid, at, w, y > 0, y + 1 < grid.height)), radius);
#if RIMS && OCCLUDED
    const real3 ray = pixel_ray(grid, FRAME_ROW(grid, y), x - grid.guard);
    const lens_t here = lens_along(grid, lens, ray);
    depth[at] = (blur_radius(here, ray, 0) - radius) / here.blur_scale;
    const division_t division = division_of(radius, psf.lens_extent, 1, record.yz);
    const int state = meet_rims(here, psf, ray, depth[at], radius, division, 0);
    record.x = state == HIDDEN ? -1 : record.x;
    record.w = as_float(state == CLEAR ? WHOLE : CUT);
#endif
    return record;
}

// Makes sources from a map of signed radii, px, instead of surfaces. In: coc real, valid uchar (0 or 1), both (height,
// width); with PREPARE = 2, for an image without gaps, coc float and valid 0. Out: source, and with rims depth.
// TAP_LANES at a time, in loops that compilers vectorize if all of them and their neighbors are valid.
__kernel void prepare_sources(const grid_t grid, const psf_t psf, MAPS, __global float *restrict source OF_RIMS) {
    const int x = get_global_id(0) * TAP_LANES, y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int w = grid.width, at = y * w + x, plane = w * grid.height;
    bool whole = !((RIMS > 0) & (OCCLUDED > 0)) && x + TAP_LANES <= w && ALL_THERE(at);
    if (TILT) {
        whole &= x > 0 && x + TAP_LANES < w && y > 0 && y + 1 < grid.height;
        whole = whole && ALL_THERE(at - 1) && ALL_THERE(at + 1) && ALL_THERE(at - w) && ALL_THERE(at + w);
    }
    if (!whole) {
        for (int i = 0; i < MIN(TAP_LANES, w - x); ++i)
            put_source(source, plane, at + i, record_of(grid, psf, coc, valid, x + i, y RIM_VALUES));
        return;
    }
    // The compiler vectorizes loops over such pointers that compute one slope each.
    __global float *restrict coordinate = source + at;
    #pragma unroll
    for (int i = 0; i < TAP_LANES; ++i)
        coordinate[i] = table_coordinate(psf, RADIUS(at + i), 0);
#if TILT
    __global float *restrict right = coordinate + plane, *restrict down = right + plane;
    #pragma unroll
    for (int i = 0; i < TAP_LANES; ++i) {
        const real across = (real)0.5 * (RADIUS(at + i + 1) - RADIUS(at + i - 1));
        right[i] = tilt_slope((real2)(across, 0), RADIUS(at + i)).x;
    }
    #pragma unroll
    for (int i = 0; i < TAP_LANES; ++i) {
        const real along = (real)0.5 * (RADIUS(at + w + i) - RADIUS(at - w + i));
        down[i] = tilt_slope((real2)(0, along), RADIUS(at + i)).y;
    }
#endif
    for (int i = 0; i < (SUBPIXELS | OCCLUDED ? TAP_LANES : 0); ++i)
        MARKS(source, plane)[at + i] = as_float(WHOLE);
}
#endif

#pragma OPENCL FP_CONTRACT OFF
