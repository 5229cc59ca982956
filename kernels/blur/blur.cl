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
// radius. renormalize serves all of them.

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

#pragma OPENCL FP_CONTRACT OFF
