// Blur on processors: the sum of blur.cl, by bands of output rows. Twin: clsco/reference/blur/blur.py.
//
//   source, value, sub_source, sub_value, intervals, coefficients: as in blur.cl
//   taps, outlines: the same weights in the order of columns.clh, PsfTable of clsco/optics/psf_tables.py
//   total   float (CHANNELS, rows, pitch), in and out: the irradiance of the frame, or a strip of it, at a time
//           sample, so far; occlusion groups add up here. `pad` columns on both sides of a row are scratch, so that a
//           vector of taps may reach beyond
//   part    the same, 0 at first: sums over some rows of sources, which are added to total. Summing thousands of equal
//           taps in one float accumulates a systematic rounding error: 1.4e-5 of white at R60, and 1.2e-6 by parts
//   ends    double (bands, BAND, columns + 1, END_PLANES), in and out: 0 at first and in the end, see spans.clh
//
// Each work-item owns a band of BAND output rows and walks the sources that reach it in a fixed order, whole vectors of
// taps at a time: no atomics, the same bits in every run. The host picks it on processors. Pointers to unaligned
// vectors and contraction took it from 131 to 27 ns per pixel at R6 (docs/lessons.md).

#include "common/geometry.clh"
#include "common/sources.clh"
#include "common/source_visibility.clh"
#include "blur/cpu/vectors.clh"
#include "blur/cpu/many.clh"
#include "blur/cpu/taps.clh"
#include "blur/cpu/ellipses.clh"
#include "blur/cpu/gaussians.clh"
#include "blur/cpu/columns.clh"
#include "blur/cpu/spans.clh"

#pragma OPENCL FP_CONTRACT ON

#if TILT
// Share of its light that the tilt of a source leaves to taps (x, y) px from it.
INLINE float8 tilts(spread_t s, float4 source, float8 x, float y)
{
#if WAVES
    const float8 factor = WITHIN_RIM(s.rim, x, y, LANE_SQRT) * (x * source.y + y * source.z) + 1;
#else
    const float8 factor = x * source.y + (1 + y * source.z);
#endif
    return TILT_SHARE((float8)0, factor, LIMB_OF(s));
}
#endif

// Adds rows -up..down of one source to `out`, the address of its first tap in its own row.
INLINE void add_rows(spread_t s, int up, int down, float v, float4 source, __global float *out, int pitch)
{
    const float8 lane = (float8)(0, 1, 2, 3, 4, 5, 6, 7);
    for (int b = 0; b < s.lanes; b += TAP_LANES) {
        for (int dy = -up; dy <= down; ++dy) {
            const float8 w = weights(s, dy, b);
#if TILT
            const float8 factor = tilts(s, source, lane + (b - s.half_width - s.ox), dy - s.oy);
            ADD_TAPS(out + dy * pitch + b, w * (factor * v));
#else
            ADD_TAPS(out + dy * pitch + b, w * v);
#endif
        }
    }
}

#if OCCLUDED
// Share of the lens that is free as seen from TAP_LANES taps of a row, the first one `first` px right of the source.
INLINE float8 free_taps(const visibility_t *visibility, spread_t s, int first, int dy)
{
#if WAVES || ELLIPSES
    float8 share;
    if (visibility->wide)
        return free_share(visibility, visibility->count > 1, LANE_OFFSETS + (first - s.ox), (float8)(dy - s.oy));
    for (int k = 0; k < TAP_LANES; ++k)
        ((float *)&share)[k] = narrow_share(visibility, first + k, dy);
    return share;
#else
    return *(const unaligned_lanes_t *)(visibility->share[dy + NARROW_MIDDLE] + first + NARROW_MIDDLE);
#endif
}
#endif

#if ELLIPSES
#if OCCLUDED
#define HIDDEN_ARGUMENT const visibility_t *visibility,
#define HIDDEN_VALUE(visibility) visibility,
#define FREE_TAPS(w, s, first, dy) (visibility ? (w) * free_taps(visibility, s, first, dy) : (w))
#else
#define HIDDEN_ARGUMENT
#define HIDDEN_VALUE(visibility)
#define FREE_TAPS(w, s, first, dy) (w)
#endif
// Adds rows -up..down of an ellipse with all channels, `planes` apart in `out`. visibility: its occluders, 0 for none;
// light: radiance of each channel.
static NOINLINE void add_ellipse_rows(spread_t s, HIDDEN_ARGUMENT int up, int down, const float *light, float4 source,
                                      __global float *out, int planes, int pitch)
{
    const float8 lane = (float8)(0, 1, 2, 3, 4, 5, 6, 7);
    const opening_t opening = s.opening;
    const float around = opening.size + chord_margin(opening), over = 1 / opening.shape.x;
    for (int dy = -up; dy <= down; ++dy) {
        const float below = dy - s.oy, outer = opening.shape.x * around * around - below * below;
        if (outer <= 0)
            continue;
        const float middle = s.half_width + s.ox - opening.shape.y * below * over, reach = sqrt(outer) * over;
        const int from = MAX((int)(middle - reach), 0), to = MIN((int)(middle + reach) + 1, 2 * s.half_width + 1);
        for (int b = from; b < to; b += TAP_LANES) {
            const float8 x = lane + (b - s.half_width - s.ox);
            float8 w = FREE_TAPS(opening_weight(opening, x, (float8)below), s, b - s.half_width, dy);
#if TILT
            w *= tilts(s, source, x, below);
#endif
            for (int k = 0; k < CHANNELS; ++k)
                ADD_TAPS(out + k * planes + dy * pitch + b, w * light[k]);
        }
    }
}
#endif

#if OCCLUDED && ELLIPSES
#define add_occluded_rows add_ellipse_rows
#elif OCCLUDED
// Adds rows -up..down of a source with occluders and a narrow lens, with all channels, `planes` apart in `out`.
INLINE void add_occluded_rows(spread_t s, const visibility_t *visibility, int up, int down,
                              const float *light, float4 source, __global float *out, int planes, int pitch)
{
    const float8 lane = (float8)(0, 1, 2, 3, 4, 5, 6, 7);
    for (int dy = -up; dy <= down; ++dy)
        for (int b = 0; b < s.lanes; b += TAP_LANES) {
            const int first = b - s.half_width;
            float8 w = own_weights(s, dy, b) * free_taps(visibility, s, first, dy);
#if TILT
            w *= tilts(s, source, lane + (first - s.ox), dy - s.oy);
#endif
            for (int k = 0; k < CHANNELS; ++k)
                ADD_TAPS(out + k * planes + dy * pitch + b, w * light[k]);
        }
}
#endif

#if OCCLUDED
INLINE void add_occluded(spread_t s, const visibility_t *visibility, int up, int down, const float *light,
                         float4 source, __global float *out, int planes, int pitch SPAN_ARGUMENTS)
{
    if (visibility->behind)
        return;
#if !WAVES && !ELLIPSES
    if (visibility->wide)
        add_spans(s, visibility, up, down, light, source, out, planes,
                  pitch SPANS_TO(ends, column, columns));
    else
#endif
        add_occluded_rows(s, visibility, up, down, light, source, out, planes, pitch);
}
#endif

// Moves rows first..last from part to total. apart: distance between planes of part; shift: from a row's place in total
// to that in part.
static void settle(int first, int last, int apart, int shift, int plane, int pitch, __global float *part,
                   __global float *total)
{
    for (int k = 0; k < CHANNELS; ++k)
        for (int at = first * pitch; at < (last + 1) * pitch; at += TAP_LANES) {
            ADD_TAPS(total + k * plane + at, TAPS_OF(part + k * apart + shift + at));
            *(__global tap_lanes_t *)(part + k * apart + shift + at) = 0;
        }
}

#define SOURCE_BLOCK WIDE_LANES  // sources of a row that are classified at once

// Approximate work in vectors of taps: of a block of sources, of a partly hidden source, and for each of its vectors.
#define BLOCK_WORK 32
#define HIDDEN_WORK 256
#define HIDDEN_TAPS 16
#define OTHERS (1 << 30)  // flag in `position`: there are single sources
#define DONE INT_MAX

// Adds to rows first..end - 1 of the frame the light of all single sources, from the `walked`-th block of sources on;
// returns the number of blocks walked then, DONE if these are all. apart: distance between planes of part; shift: from
// a row of the frame to that of part; ends: of the band; further arguments: as of the kernel.
static NOINLINE int add_others(const grid_t grid, const psf_t psf, __global const float *source,
                               __global const float *value, __global const int2 *intervals,
                               __global const float *coefficients, __global const outline_t *outlines, int first,
                               int end, int walked, int2 budget, int part_rows, __global float *part, int apart,
                               int shift,
#if SPANS
                               __global double *ends,
#endif
                               int pitch, int pad, __global float *total SUBPIXEL_ARGUMENTS OCCLUSION_ARGUMENTS
                               OF_ELLIPSES)
{
    const bool cut = budget.x > 0;
    const int plane = grid.width * grid.height, total_plane = grid.rows * pitch;
    const int from = MAX(first - psf.reach, -grid.above), to = MIN(end + psf.reach, grid.height - grid.above);
    const int blocks = (grid.width + SOURCE_BLOCK - 1) / SOURCE_BLOCK;
    int left = budget.y, block_first = walked % blocks;
    bool added = walked > 0;  // True if something was added to part since it was settled
    for (int y = from + walked / blocks; y < to; ++y, block_first = 0) {
    const int line = (y + grid.above) * grid.width, place = shift + y * pitch - grid.guard + pad;
#if SPANS
    __global double *own_ends = ends + (long)(y - first) * (grid.columns + 1) * END_PLANES;
#endif
    for (int block = block_first * SOURCE_BLOCK; block < grid.width; block += SOURCE_BLOCK) {
    if (cut && left <= 0) {
        return (y - from) * blocks + block / SOURCE_BLOCK;
    }
    left -= BLOCK_WORK;
    int single = (1 << MIN(SOURCE_BLOCK, grid.width - block)) - 1;
#if BY_COLUMNS
    const int16 others = take_sources(psf, source, plane, line, block, grid.width, intervals, outlines).others;
    single = bits_of(others.lo) | bits_of(UPPER(others)) << TAP_LANES;
#endif
    added |= single != 0;
    while (single) {
        const int x = block + __builtin_ctz(single);
        single &= single - 1;
        const int at = line + x;
        float4 s = get_source(source, plane, at);
        __global float *out = part + place + x;
#if SUBPIXELS
        const int slot = as_int(s.w);
        if (slot >= 0) {
#if OCCLUDED && SHARED
            visibility_t shared;
            bool looked = false;
#endif
            for (int sub = 0; sub < SOURCES_OF(slot); ++sub) {
                const int id = FIRST_SLOT(slot) * EACH + sub;
                float4 p = sub_source[id];
                if (p.x < 0)
                    continue;
                spread_t spread =
                    SHAPED(subpixel_spread(psf, sub_intervals, sub_coefficients, p,
                                           sub PLACE_VALUES(grid.top + y, x - grid.guard)), psf, p, at);
                const int half_width = spread.half_width;
                const int up = MIN(half_width, y - first), down = MIN(half_width, end - 1 - y);
                const int vectors = MAX(up + down + 1, 0) * (spread.lanes / TAP_LANES);
                left -= CHANNELS * vectors;
#if OCCLUDED && SHARED
                if (as_int(p.w) == PARTLY_SHARED) {
                    left -= (looked ? 0 : HIDDEN_WORK) + HIDDEN_TAPS * vectors;
                    if (!looked)
                        pixel_visibility(grid, lens, surfaces, group, psf, lens_cells, grid.top + y, x - grid.guard,
                                         depth[at], s, &shared);
                    looked = true;
                    shared_visibility(grid, lens, psf, lens_cells, grid.top + y + spread.oy,
                                      x - grid.guard + spread.ox, sub_depth[id], spread, &shared);
                    float light[CHANNELS];
                    for (int k = 0; k < CHANNELS; ++k)
                        light[k] = sub_value[k * capacity * SUBPIXELS * SUBPIXELS + id];
                    add_occluded_rows(spread, &shared, up, down, light, p, out - half_width, apart, pitch);
                    continue;
                }
#endif
#if OCCLUDED
                if (IS_PARTLY(as_int(p.w))) {
                    left -= HIDDEN_WORK + HIDDEN_TAPS * vectors;
                    visibility_t visibility;
                    source_visibility(grid, lens, surfaces, group, psf, lens_cells RAY_VALUES, grid.top + y + spread.oy,
                                      x - grid.guard + spread.ox,
                                      sub_depth[id], &spread, &p, (real)1 / SUBPIXELS, &visibility);
                    float light[CHANNELS];
                    for (int k = 0; k < CHANNELS; ++k)
                        light[k] = sub_value[k * capacity * SUBPIXELS * SUBPIXELS + id];
                    add_occluded(spread, &visibility, up, down, light, p, out - half_width, apart,
                                 pitch SPANS_TO(own_ends, x - grid.guard, grid.columns));
                    continue;
                }
#endif
#if ELLIPSES
                float own[CHANNELS];
                for (int k = 0; k < CHANNELS; ++k)
                    own[k] = sub_value[k * capacity * SUBPIXELS * SUBPIXELS + id];
                add_ellipse_rows(spread, HIDDEN_VALUE(0) up, down, own, p, out - half_width, apart, pitch);
#else
                for (int k = 0; k < CHANNELS; ++k)
                    add_rows(spread, up, down, sub_value[k * capacity * SUBPIXELS * SUBPIXELS + id], p,
                             out + k * apart - half_width, pitch);
#endif
            }
            continue;
        }
#endif
        if (s.x < 0)
            continue;
        spread_t spread = SHAPED(
            pixel_spread(psf, intervals, coefficients, s.x PLACE_VALUES(grid.top + y, x - grid.guard)), psf, s, at);
        const int half_width = spread.half_width;
        const int up = MIN(half_width, y - first), down = MIN(half_width, end - 1 - y);
        const int vectors = MAX(up + down + 1, 0) * (spread.lanes / TAP_LANES);
        left -= CHANNELS * vectors;
#if OCCLUDED
        if (IS_PARTLY(as_int(s.w))) {
            left -= HIDDEN_WORK + HIDDEN_TAPS * vectors;
            visibility_t visibility;
            source_visibility(grid, lens, surfaces, group, psf, lens_cells RAY_VALUES, grid.top + y, x - grid.guard,
                              depth[at], &spread, &s, (real)1, &visibility);
            float light[CHANNELS];
            for (int k = 0; k < CHANNELS; ++k)
                light[k] = value[k * plane + at];
            add_occluded(spread, &visibility, up, down, light, s, out - half_width, apart,
                         pitch SPANS_TO(own_ends, x - grid.guard, grid.columns));
            continue;
        }
#endif
#if ELLIPSES
        float own[CHANNELS];
        for (int k = 0; k < CHANNELS; ++k)
            own[k] = value[k * plane + at];
        add_ellipse_rows(spread, HIDDEN_VALUE(0) up, down, own, s, out - half_width, apart, pitch);
#else
        for (int k = 0; k < CHANNELS; ++k)
            add_rows(spread, up, down, value[k * plane + at], s, out + k * apart - half_width, pitch);
#endif
    }
    }
    if (part_rows && added && ((y + 1 - from) % part_rows == 0 || y + 1 == to)) {
        settle(MAX(first, y + 1 - part_rows - psf.reach), MIN(end - 1, y + psf.reach), apart, shift, total_plane, pitch,
               part, total);
        added = false;
    }
    }
#if SPANS
    finish_spans(ends, end - first, grid.columns, total_plane, pitch, total + first * pitch + pad);
#endif
    return DONE;
}

// Each work-item adds all light that reaches a band of BAND rows to `total`, row by row of sources; `start` is the band
// of the first work-item. budget: 0 for all at once; else a launch adds grouped sources of up to budget.x steps of
// columns, and later ones single sources, up to budget.y vectors of taps. position: progress of each work-item, 0 at
// first, DONE in the end. Such pieces give the sums of the whole, in its order. part: BAND rows for each work-item,
// which are added to total after every `part_rows` rows of sources; part is total if part_rows is 0. scratch: see
// columns.clh, zeros as well.
__kernel void gather(const grid_t grid, const psf_t psf, __global const float *source,
                     __global const float *value, __global const int2 *intervals,
                     __global const float *coefficients,
                     __global const float *taps, __global const outline_t *outlines,
#if BY_COLUMNS
                     __global scratch_t *scratch, const int scratch_size,  // of a work-item
#endif
                     const int start, const int2 budget, __global int *position,
                     const int part_rows, __global float *part,
#if SPANS
                     __global double *ends,
#endif
                     const int pitch, const int pad,
                     __global float *total SUBPIXEL_ARGUMENTS OCCLUSION_ARGUMENTS OF_ELLIPSES)
{
    const int own = get_global_id(0), first = (start + own) * BAND;
    if (first >= grid.rows)
        return;
    const bool cut = budget.x > 0;
    const int end = MIN(grid.rows, first + BAND), before = cut ? position[own] : 0;
    if (before == DONE)
        return;
    int at_first = before & (OTHERS - 1);
#if BY_COLUMNS
    const int steps = (grid.columns + COLUMN_STEP - 1) / COLUMN_STEP;
    if (at_first < steps) {
        const int until = cut ? MIN(at_first + budget.x, steps) : steps;
        const bool others = add_columns(grid, psf, source, value, intervals, taps, outlines, first, end,
                                        at_first * COLUMN_STEP, until * COLUMN_STEP, scratch + own * scratch_size,
                                        pitch, pad, total CUT_VALUES(lens, depth) ELLIPSE_VALUES);
        if (cut)
            position[own] = others || (before & OTHERS) ? until | OTHERS : until < steps ? until : DONE;
        if (cut || !others)
            return;
        at_first = steps;
    }
#else
    const int steps = 0;
#endif
    const int apart = (part_rows ? (int)get_global_size(0) * BAND : grid.rows) * pitch;
    const int shift = part_rows ? -start * BAND * pitch : 0;
    const int walked = add_others(grid, psf, source, value, intervals, coefficients, outlines, first, end,
                                  at_first - steps, budget, part_rows, part, apart, shift,
#if SPANS
                                  ends + (long)own * BAND * (grid.columns + 1) * END_PLANES,
#endif
                                  pitch, pad, total SUBPIXEL_VALUES OCCLUSION_VALUES ELLIPSE_VALUES);
    if (cut)
        position[own] = walked == DONE ? DONE : steps + walked;
}

#pragma OPENCL FP_CONTRACT OFF
