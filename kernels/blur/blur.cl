// Blur by scattering: every source adds its radiance L_s to the pixels around it,
//     I(x) = sum_s L_s w(x - x_s; R_s) (1 + l . grad R) V,
// w: the point spread function of the signed blur radius R_s; 1 + l . grad R: the tilt of the surface at lens point
// l = (x - x_s) / R_s; V: the share of the lens that no occluder hides (common/visibility.clh).
// Twin: clsco/reference/blur/blur.py. Host: clsco/passes/blur.py.
//
//   source: common/sources.clh; value, sub_source, sub_value: trace/cast.cl, subpixels.cl
//   intervals, coefficients: tables of weights, PsfTable of clsco/optics/psf_tables.py
//   sums    fixed_t (CHANNELS, rows, columns), in and out: the irradiance of the frame, or a strip of it, in units of
//           1 / scale
//   total   float (CHANNELS, rows, pitch), out: the same as floats; `pad` columns on both sides of a row are scratch
//
// scatter adds taps one by one in fixed point: the same bits on any device and in any order; it is the oracle of the
// other methods. The host picks it on a GPU for occluders, rims or ellipses, and if taps are few; else it picks
// `gather` (cpu/gather.cl) on processors, `tiles` (tiles.cl) on GPUs, and `convolve` (convolve.cl) for frames of one
// radius. renormalize and prepare_sources serve all of them.

#include "blur/pixel_sources.clh"

#pragma OPENCL FP_CONTRACT ON

#if SCATTER
#if HAS_INT64_ATOMICS
#define ADD_FIXED(p, v) atom_add(p, v)
#else
#define ADD_FIXED(p, v) atomic_add(p, v)
#endif

// Adds one channel of a source tap by tap, rounded to multiples of 1 / scale. visibility: its occluders, 0 for none.
static void scatter_source(const grid_t grid, spread_t spread, const visibility_t *visibility, float4 source, float v,
                           float scale, int row, int column, __global fixed_t *sums QUADRANT_ARGUMENTS) {
    const int half_width = spread.half_width;
    for (int dy = MAX(-half_width, -row); dy <= MIN(half_width, grid.rows - 1 - row); ++dy)
        for (int dx = MAX(-half_width, -column); dx <= MIN(half_width, grid.columns - 1 - column); ++dx) {
            float light = v * tap(spread, dx, dy, source) * scale;
#if OCCLUDED
            if (visibility)
                light *= FIRST_LANE(free_taps(visibility, spread, dx, dy));
#endif
#if QUADRANTS
            light *= HALF_SHARE(side, dy) * (dx ? 1 : 0.5f);
            const int own = (row + dy) * grid.columns + column + dx, apart = CHANNELS * grid.rows * grid.columns;
            if (dx >= 0)
                ADD_FIXED(sums + on_right * apart + own, (fixed_t)floor(light + 0.5f));
            if (dx <= 0)
                ADD_FIXED(sums + on_left * apart + own, (fixed_t)floor(light + 0.5f));
#else
            ADD_FIXED(sums + (row + dy) * grid.columns + column + dx, (fixed_t)floor(light + 0.5f));
#endif
        }
}

// One work-item per source. In and out: sums fixed_t (CHANNELS, rows, columns), in units of 1 / scale.
__kernel void scatter(const grid_t grid, const psf_t psf, __global const float *source,
                      __global const float *value, __global const int2 *intervals,
                      __global const float *coefficients, const float scale, __global fixed_t *sums
                      SUBPIXEL_ARGUMENTS OCCLUSION_ARGUMENTS OF_ELLIPSES QUADRANT_ARGUMENTS) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int at = y * grid.width + x, row = y - grid.above, column = x - grid.guard;
    const int plane = grid.width * grid.height, sums_plane = grid.rows * grid.columns;
    const float4 own = get_source(source, plane, at);
#if OCCLUDED
    visibility_t seen[1 + SHARED];
    bool looked = false;
#endif
    for (int n = 0; n < SOURCES_IN(own); ++n) {
        pixel_source_t s = source_in(psf, value, intervals, coefficients, own, n, plane, at, grid.top + row,
                                     column SUBPIXEL_VALUES ELLIPSE_VALUES);
        if (s.record.x < 0)
            continue;
        const visibility_t *visibility = 0;
#if OCCLUDED
        visibility = occluders_of(grid, psf, own, at, grid.top + row, column, &s, seen,
                                  &looked SUBPIXEL_VALUES OCCLUSION_VALUES);
#endif
        for (int k = 0; k < CHANNELS; ++k)
            scatter_source(grid, s.spread, visibility, s.record, s.light[k * s.apart], scale, row, column,
                           sums + k * sums_plane QUADRANT_VALUES);
    }
}

// Fixed point to float: sums / scale, in the layout of total.
__kernel void resolve(const grid_t grid, const float scale, const int pitch, const int pad,
                      __global const fixed_t *sums, __global float *total) {
    const int column = get_global_id(0), row = get_global_id(1);
    if (column >= grid.columns || row >= grid.rows)
        return;
    for (int k = 0; k < SIDES * SIDES * CHANNELS; ++k)
        total[(k * grid.rows + row) * pitch + column + pad] =
            (float)sums[(k * grid.rows + row) * grid.columns + column] / scale;
}
#endif

#if RENORMALIZE
// Share of a source's radiance that falls inside of the frame.
static float share_inside(const grid_t grid, spread_t spread, float4 source, int row, int column) {
    const int half_width = spread.half_width;
    float sum = 0;
    for (int dy = MAX(-half_width, -row); dy <= MIN(half_width, grid.frame_rows - 1 - row); ++dy)
        for (int dx = MAX(-half_width, -column); dx <= MIN(half_width, grid.columns - 1 - column); ++dx)
            sum += tap(spread, dx, dy, source);
    return sum;
}

// Divides radiance by the share of a source's weights in the frame (border = "renormalize"), so that none is lost over
// the border; there is no apron then. In and out: value, sub_value.
__kernel void renormalize(const grid_t grid, const psf_t psf, __global const float *source,
                          __global float *value, __global const int2 *intervals,
                          __global const float *coefficients
#if SUBPIXELS
                          , __global const float4 *sub_source, __global float *sub_value, const int capacity,
                          __global const int2 *sub_intervals, __global const float *sub_coefficients
#endif
                          OF_ELLIPSES) {
    const int column = get_global_id(0), y = get_global_id(1), row = FRAME_ROW(grid, y);
    if (column >= grid.columns || y >= grid.height)
        return;
    const int at = y * grid.columns + column, plane = grid.height * grid.columns;
    const float4 own = get_source(source, plane, at);
    for (int n = 0; n < SOURCES_IN(own); ++n) {
        const pixel_source_t s = source_in(psf, value, intervals, coefficients, own, n, plane, at, row,
                                           column SUBPIXEL_VALUES ELLIPSE_VALUES);
        if (s.record.x < 0)
            continue;
        const float share = share_inside(grid, s.spread, s.record, row, column);
        for (int k = 0; k < CHANNELS && share > 0; ++k)
            ((__global float *)s.light)[k * s.apart] /= share;
    }
}
#endif

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
