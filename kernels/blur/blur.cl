// Blur by scattering: every source adds its radiance L_s to the pixels around it,
//     I(x) = sum_s L_s w(x - x_s; R_s) (1 + l . grad R) V,
// w: the point spread function of the signed blur radius R_s; 1 + l . grad R: the tilt of the surface at lens point
// l = (x - x_s) / R_s; V: the share of the lens that no occluder hides (common/visibility.clh).
// Twin: clsco/reference/blur/blur.py. Host: clsco/passes/blur.py.
//
//   source: common/sources.clh; value, sub_source, sub_value: trace/trace.cl
//   intervals, coefficients: tables of weights, PsfTable of clsco/optics/psf_tables.py
//   sums    fixed_t (CHANNELS, rows, columns), in and out: the irradiance of the frame, or a strip of it, in units of
//           1 / scale
//   total   float (CHANNELS, rows, pitch), out: the same as floats; `pad` columns on both sides of a row are scratch
//
// scatter adds taps one by one in fixed point: the same bits on any device and in any order; it is the oracle of the
// other methods. The host picks it on a GPU for occluders, rims or ellipses, and if taps are few; else it picks
// `gather` (cpu/gather.cl) on processors, `tiles` (tiles.cl) on GPUs, and `convolve` (convolve.cl) for frames of one
// radius. renormalize and prepare_sources serve all of them.

#include "common/geometry.clh"
#include "common/sources.clh"
#include "common/source_visibility.clh"

#pragma OPENCL FP_CONTRACT ON

#if SCATTER
#if HAS_INT64_ATOMICS
#define ADD_FIXED(p, v) atom_add(p, v)
#else
#define ADD_FIXED(p, v) atomic_add(p, v)
#endif

#if OCCLUDED
#define VISIBILITY_ARGUMENT , const visibility_t *visibility
#define VISIBILITY_VALUE , visibility

static float tap_share(const visibility_t *visibility, int dx, int dy, spread_t s)
{
    if (!visibility->wide)
#if WAVES || ELLIPSES
        return narrow_share(visibility, dx, dy);
#else
        return visibility->share[dy + NARROW_MIDDLE][dx + NARROW_MIDDLE];
#endif
    const bool several = visibility->count > 1;
    return FIRST_LANE(free_share(visibility, several, (lanes_t)(dx - s.ox), (lanes_t)(dy - s.oy)));
}
#else
#define VISIBILITY_ARGUMENT
#define VISIBILITY_VALUE
#endif

// Adds one source tap by tap, rounded to multiples of 1 / scale. visibility: its occluders, 0 for none.
static void scatter_source(const grid_t grid, spread_t spread, float4 source, float v, float scale, int row,
                           int column, __global fixed_t *sums VISIBILITY_ARGUMENT)
{
    const int half_width = spread.half_width;
    for (int dy = MAX(-half_width, -row); dy <= MIN(half_width, grid.rows - 1 - row); ++dy)
        for (int dx = MAX(-half_width, -column); dx <= MIN(half_width, grid.columns - 1 - column); ++dx) {
            float light = v * tap(spread, dx, dy, source) * scale;
#if OCCLUDED
            if (visibility)
                light *= tap_share(visibility, dx, dy, spread);
#endif
            ADD_FIXED(sums + (row + dy) * grid.columns + column + dx, (fixed_t)floor(light + 0.5f));
        }
}

// One work-item per source. In and out: sums fixed_t (CHANNELS, rows, columns), in units of 1 / scale.
__kernel void scatter(const grid_t grid, const psf_t psf, __global const float *source,
                      __global const float *value, __global const int2 *intervals,
                      __global const float *coefficients, const float scale, __global fixed_t *sums
                      SUBPIXEL_ARGUMENTS OCCLUSION_ARGUMENTS OF_ELLIPSES)
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int at = y * grid.width + x, row = y - grid.above, column = x - grid.guard;
    const int plane = grid.width * grid.height, sums_plane = grid.rows * grid.columns;
    float4 s = get_source(source, plane, at);
#if SUBPIXELS
    const int slot = as_int(s.w);
    if (slot >= 0) {
        for (int sub = 0; sub < SOURCES_OF(slot); ++sub) {
            const int id = FIRST_SLOT(slot) * EACH + sub;
            float4 p = sub_source[id];
            if (p.x < 0)
                continue;
            spread_t spread = SHAPED(
                subpixel_spread(psf, sub_intervals, sub_coefficients, p, sub PLACE_VALUES(grid.top + row, column)),
                psf, p, at);
#if OCCLUDED
            visibility_t seen;
            const visibility_t *visibility = IS_PARTLY(as_int(p.w)) ? &seen : 0;
            const real sub_row = grid.top + row + spread.oy, sub_column = column + spread.ox;
#if SHARED
            if (as_int(p.w) == PARTLY_SHARED) {
                visibility = &seen;
                pixel_visibility(grid, lens, surfaces, group, psf, lens_cells, grid.top + row, column, depth[at], s,
                                 &seen);
                shared_visibility(grid, lens, psf, lens_cells, sub_row, sub_column, sub_depth[id], spread, &seen);
            } else
#endif
            if (visibility)
                source_visibility(grid, lens, surfaces, group, psf, lens_cells RAY_VALUES, sub_row, sub_column,
                                  sub_depth[id], &spread, &p, (real)1 / SUBPIXELS, &seen);
#endif
            for (int k = 0; k < CHANNELS; ++k)
                scatter_source(grid, spread, p, sub_value[k * capacity * EACH + id], scale, row,
                               column, sums + k * sums_plane VISIBILITY_VALUE);
        }
        return;
    }
#endif
    if (s.x < 0)
        return;
    spread_t spread = SHAPED(
        pixel_spread(psf, intervals, coefficients, s.x PLACE_VALUES(grid.top + row, column)), psf, s, at);
#if OCCLUDED
    visibility_t seen;
    const visibility_t *visibility = IS_PARTLY(as_int(s.w)) ? &seen : 0;
    if (visibility)
        source_visibility(grid, lens, surfaces, group, psf, lens_cells RAY_VALUES, grid.top + row, column, depth[at],
                          &spread, &s,
                          (real)1, &seen);
#endif
    for (int k = 0; k < CHANNELS; ++k)
        scatter_source(grid, spread, s, value[k * plane + at], scale, row, column,
                       sums + k * sums_plane VISIBILITY_VALUE);
}

// Fixed point to float: sums / scale, in the layout of total.
__kernel void resolve(const grid_t grid, const float scale, const int pitch, const int pad,
                      __global const fixed_t *sums, __global float *total)
{
    const int column = get_global_id(0), row = get_global_id(1);
    if (column >= grid.columns || row >= grid.rows)
        return;
    for (int k = 0; k < CHANNELS; ++k)
        total[(k * grid.rows + row) * pitch + column + pad] =
            (float)sums[(k * grid.rows + row) * grid.columns + column] / scale;
}
#endif

#if RENORMALIZE
// Share of a source's radiance that falls inside of the frame.
static float share_inside(const grid_t grid, spread_t spread, float4 source, int row, int column)
{
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
                          OF_ELLIPSES)
{
    const int column = get_global_id(0), y = get_global_id(1), row = FRAME_ROW(grid, y);
    if (column >= grid.columns || y >= grid.height)
        return;
    const int at = y * grid.columns + column, plane = grid.height * grid.columns;
    float4 s = get_source(source, plane, at);
#if SUBPIXELS
    const int slot = as_int(s.w);
    if (slot >= 0) {
        for (int sub = 0; sub < SOURCES_OF(slot); ++sub) {
            const int id = FIRST_SLOT(slot) * EACH + sub;
            float4 p = sub_source[id];
            if (p.x < 0)
                continue;
            const spread_t spread = SHAPED(
                subpixel_spread(psf, sub_intervals, sub_coefficients, p, sub PLACE_VALUES(row, column)), psf, p, at);
            const float share = share_inside(grid, spread, p, row, column);
            for (int k = 0; k < CHANNELS && share > 0; ++k)
                sub_value[k * capacity * EACH + id] /= share;
        }
        return;
    }
#endif
    if (s.x < 0)
        return;
    const spread_t spread =
        SHAPED(pixel_spread(psf, intervals, coefficients, s.x PLACE_VALUES(row, column)), psf, s, at);
    const float share = share_inside(grid, spread, s, row, column);
    for (int k = 0; k < CHANNELS && share > 0; ++k)
        value[k * plane + at] /= share;
}
#endif

#if PREPARE
#if PREPARE == 2
typedef float map_t;
#define MAPS __global const map_t *restrict coc
#define MAPS_VALUE coc
#define RADIUS(r) (real)(r)
#define IS_THERE(at) true
#define ALL_THERE(at) true
#else
typedef real map_t;
#define MAPS __global const map_t *restrict coc, __global const uchar *restrict valid
#define MAPS_VALUE coc, valid
#define RADIUS(r) (r)
#define IS_THERE(at) valid[at]
#define ALL_THERE(at) (LOAD_EIGHT_BYTES(valid + (at)) == 0x0101010101010101ul)
#endif

// Difference of the radius per px along one axis: central, one-sided at an edge, 0 without neighbors.
static real difference(MAPS, int at, int step, bool before, bool after)
{
    before = before && IS_THERE(at - step);
    after = after && IS_THERE(at + step);
    if (before && after)
        return (real)0.5 * (RADIUS(coc[at + step]) - RADIUS(coc[at - step]));
    if (after)
        return RADIUS(coc[at + step]) - RADIUS(coc[at]);
    return before ? RADIUS(coc[at]) - RADIUS(coc[at - step]) : 0;
}

#if RIMS && OCCLUDED
#define OF_RIMS , const lens_t lens, __global real *restrict depth
#define RIM_VALUES , lens, depth
// Record of a source, marked if rims cut its light, and with a negative coordinate if they block it. Out: depth.
static float4 behind_rims(const grid_t grid, const psf_t psf, float4 record, real radius, int x, int y OF_RIMS)
{
    const real3 ray = pixel_ray(grid, FRAME_ROW(grid, y), x - grid.guard);
    const lens_t here = lens_along(grid, lens, ray);
    const real w = (blur_radius(here, ray, 0) - radius) / here.blur_scale;
    const division_t division = division_of(radius, psf.lens_extent, 1, record.yz);
    const int found = meet_rims(here, psf, ray, w, radius, division, 0);
    depth[y * grid.width + x] = w;
    record.x = found == HIDDEN ? -1 : record.x;
    record.w = as_float(found == CLEAR ? WHOLE : CUT);
    return record;
}

// Share of the lens's light that rims let through to each pixel of the frame from its point in focus, whatever the
// scene has there. For depth layers. In: lens_cells. Out: open float (rows, columns).
__kernel void open_share(const grid_t grid, const psf_t psf, const lens_t lens, __constant float *lens_cells,
                         __global float *open)
{
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

// One source from a map of signed radii.
static float4 record_of(const grid_t grid, const psf_t psf, MAPS, int x, int y OF_RIMS)
{
    const int at = y * grid.width + x;
    float4 record = (float4)(-1, 0, 0, as_float(WHOLE));
    if (IS_THERE(at)) {
        record.x = table_coordinate(psf, RADIUS(coc[at]), 0);
#if TILT
        const int w = grid.width;
        const real2 gradient = (real2)(difference(MAPS_VALUE, at, 1, x > 0, x + 1 < w),
                                       difference(MAPS_VALUE, at, w, y > 0, y + 1 < grid.height));
        record.yz = tilt_slope(gradient, RADIUS(coc[at]));
#endif
#if RIMS && OCCLUDED
        record = behind_rims(grid, psf, record, RADIUS(coc[at]), x, y RIM_VALUES);
#endif
    }
    return record;
}

// Makes sources from a map of signed radii, px, instead of surfaces. In: coc real, valid uchar (0 or 1), both (height,
// width); with PREPARE = 2, for an image without gaps, coc float and no valid. Out: source, and with rims depth.
// TAP_LANES at a time, in loops that compilers vectorize if all of them and their neighbors are valid.
__kernel void prepare_sources(const grid_t grid, const psf_t psf, MAPS, __global float *restrict source OF_RIMS)
{
    const int x = get_global_id(0) * TAP_LANES, y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int w = grid.width, at = y * w + x, plane = w * grid.height;
    bool whole = x + TAP_LANES <= w && ALL_THERE(at);
#if RIMS && OCCLUDED
    whole = false;
#endif
#if TILT
    whole &= x > 0 && x + TAP_LANES < w && y > 0 && y + 1 < grid.height;
    whole = whole && ALL_THERE(at - 1) && ALL_THERE(at + 1) && ALL_THERE(at - w) && ALL_THERE(at + w);
#endif
    if (!whole) {
        for (int i = 0; i < MIN(TAP_LANES, w - x); ++i)
            put_source(source, plane, at + i, record_of(grid, psf, MAPS_VALUE, x + i, y RIM_VALUES));
        return;
    }
    // The compiler vectorizes loops over such pointers that compute one slope each.
    __global const map_t *restrict here = coc + at;
    __global float *restrict coordinate = source + at;
    #pragma unroll
    for (int i = 0; i < TAP_LANES; ++i)
        coordinate[i] = table_coordinate(psf, RADIUS(here[i]), 0);
#if TILT
    __global const map_t *restrict above = here - w, *restrict below = here + w;
    __global float *restrict right = coordinate + plane, *restrict down = right + plane;
    #pragma unroll
    for (int i = 0; i < TAP_LANES; ++i) {
        const real across = (real)0.5 * (RADIUS(here[i + 1]) - RADIUS(here[i - 1]));
        right[i] = tilt_slope((real2)(across, 0), RADIUS(here[i])).x;
    }
    #pragma unroll
    for (int i = 0; i < TAP_LANES; ++i) {
        const real along = (real)0.5 * (RADIUS(below[i]) - RADIUS(above[i]));
        down[i] = tilt_slope((real2)(0, along), RADIUS(here[i])).y;
    }
#endif
#if SUBPIXELS || OCCLUDED
    for (int i = 0; i < TAP_LANES; ++i)
        MARKS(source, plane)[at + i] = as_float(WHOLE);
#endif
}
#endif

#pragma OPENCL FP_CONTRACT OFF
