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

#include "blur/pixel_sources.clh"
#include "blur/cpu/vectors.clh"
#include "blur/cpu/many.clh"
#include "blur/cpu/taps.clh"
#include "blur/cpu/ellipses.clh"
#include "blur/cpu/gaussians.clh"
#include "blur/cpu/columns.clh"
#include "blur/cpu/spans.clh"

#pragma OPENCL FP_CONTRACT ON

// Adds rows -up..down of one source with all channels, `planes` apart, to `out`, the address of its first tap in its
// own row. visibility: its occluders, 0 for none; light: radiance of each channel.
INLINE void add_rows(spread_t s, const visibility_t *visibility, int up, int down, const float *light, float4 source,
                     __global float *out, int planes, int pitch QUADRANT_ARGUMENTS) {
#if ELLIPSES
    const opening_t opening = s.opening;
    const float around = opening.size + chord_margin(opening), over = 1 / opening.shape.x;
#endif
    for (int dy = -up; dy <= down; ++dy) {
        const float y = dy - s.oy;
        int from = 0, to = s.lanes;
#if QUADRANTS
        const float half_share = HALF_SHARE(side, dy);
        if (half_share == 0)
            continue;
#endif
#if ELLIPSES
        const float outer = opening.shape.x * around * around - y * y;
        if (outer <= 0)
            continue;
        const float middle = s.half_width + s.ox - opening.shape.y * y * over, reach = sqrt(outer) * over;
        from = MAX((int)(middle - reach), 0);
        to = MIN((int)(middle + reach) + 1, 2 * s.half_width + 1);
#endif
        for (int b = from; b < to; b += TAP_LANES) {
            const float8 x = LANE_OFFSETS + (b - s.half_width - s.ox);
            float8 w = own_weights(s, dy, b);
#if OCCLUDED
            if (visibility)
                w *= free_taps(visibility, s, b - s.half_width, dy);
#endif
            const float8 tilt = tilts(s, source, x, y);
#if QUADRANTS
            const float8 aside = LANE_OFFSETS + (b - s.half_width + 0.5f);
            const float8 part = MIN(MAX(aside, (float8)0), (float8)1);
            w *= half_share;
            for (int k = 0; k < CHANNELS; ++k) {
                const float8 all = w * (tilt * light[k]), own = all * part;
                ADD_TAPS(out + (on_right * CHANNELS + k) * planes + dy * pitch + b, own);
                ADD_TAPS(out + (on_left * CHANNELS + k) * planes + dy * pitch + b, all - own);
            }
#else
            for (int k = 0; k < CHANNELS; ++k)
                ADD_TAPS(out + k * planes + dy * pitch + b, w * (tilt * light[k]));
#endif
        }
    }
}

// Moves rows first..last from part to total. apart: distance between planes of part; shift: from a row's place in total
// to that in part.
static void settle(int first, int last, int apart, int shift, int plane, int pitch, __global float *part,
                   __global float *total) {
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
                               int shift, __global scratch_t *ends,
                               int pitch, int pad, __global float *total SUBPIXEL_ARGUMENTS OCCLUSION_ARGUMENTS
                               OF_ELLIPSES QUADRANT_ARGUMENTS) {
    const bool cut = budget.x > 0;
    const int plane = grid.width * grid.height, total_plane = grid.rows * pitch;
    const int from = MAX(first - psf.reach, -grid.above), to = MIN(end + psf.reach, grid.height - grid.above);
    const int blocks = (grid.width + SOURCE_BLOCK - 1) / SOURCE_BLOCK;
    int left = budget.y, block_first = walked % blocks;
    bool added = walked > 0;  // True if something was added to part since it was settled
    for (int y = from + walked / blocks; y < to; ++y, block_first = 0) {
    const int line = (y + grid.above) * grid.width, place = shift + y * pitch - grid.guard + pad;
    __global scratch_t *own_ends = ends + (long)(y - first) * (grid.columns + 1) * END_PLANES;
    for (int block = block_first * SOURCE_BLOCK; block < grid.width; block += SOURCE_BLOCK) {
    if (cut && left <= 0)
        return (y - from) * blocks + block / SOURCE_BLOCK;
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
        const float4 own = get_source(source, plane, at);
#if OCCLUDED
        visibility_t seen[1 + SHARED];
        bool looked = false;
#endif
        for (int n = 0; n < SOURCES_IN(own); ++n) {
            pixel_source_t s = source_in(psf, value, intervals, coefficients, own, n, plane, at, grid.top + y,
                                         x - grid.guard SUBPIXEL_VALUES ELLIPSE_VALUES);
            if (s.record.x < 0)
                continue;
            const int half_width = s.spread.half_width;
            const int up = MIN(half_width, y - first), down = MIN(half_width, end - 1 - y);
            const int vectors = MAX(up + down + 1, 0) * (s.spread.lanes / TAP_LANES);
            __global float *out = part + place + x - half_width;
            float light[CHANNELS];
            for (int k = 0; k < CHANNELS; ++k)
                light[k] = s.light[k * s.apart];
            left -= CHANNELS * vectors;
            const visibility_t *visibility = 0;
#if OCCLUDED
            visibility = occluders_of(grid, psf, own, at, grid.top + y, x - grid.guard, &s, seen,
                                      &looked SUBPIXEL_VALUES OCCLUSION_VALUES);
            left -= visibility ? HIDDEN_WORK + HIDDEN_TAPS * vectors : 0;
            if (visibility && visibility->behind)
                continue;
#endif
#if OCCLUDED && !WAVES && !ELLIPSES
            if (visibility && visibility->wide) {
                add_spans(s.spread, visibility, up, down, light, s.record, out, apart, pitch, own_ends, x - grid.guard,
                          grid.columns);
                continue;
            }
#endif
            add_rows(s.spread, visibility, up, down, light, s.record, out, apart, pitch QUADRANT_VALUES);
        }
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
                     __global scratch_t *scratch, const int scratch_size,  // of a work-item
                     const int start, const int2 budget, __global int *position,
                     const int part_rows, __global float *part, __global scratch_t *ends,
                     const int pitch, const int pad,
                     __global float *total SUBPIXEL_ARGUMENTS OCCLUSION_ARGUMENTS OF_ELLIPSES QUADRANT_ARGUMENTS) {
    const int own = get_global_id(0), first = (start + own) * BAND;
    if (first >= grid.rows)
        return;
    const bool cut = budget.x > 0;
    const int end = MIN(grid.rows, first + BAND), before = cut ? position[own] : 0;
    if (before == DONE)
        return;
    const int steps = BY_COLUMNS ? (grid.columns + COLUMN_STEP - 1) / COLUMN_STEP : 0;
    int at_first = before & (OTHERS - 1);
#if BY_COLUMNS
    if (at_first < steps) {
        const int until = cut ? MIN(at_first + budget.x, steps) : steps;
        const bool others = add_columns(grid, psf, source, value, intervals, taps, outlines, first, end,
                                        at_first * COLUMN_STEP, until * COLUMN_STEP, scratch + own * scratch_size,
                                        pitch, pad, total OCCLUSION_VALUES ELLIPSE_VALUES QUADRANT_VALUES);
        if (cut)
            position[own] = others || (before & OTHERS) ? until | OTHERS : until < steps ? until : DONE;
        if (cut || !others)
            return;
        at_first = steps;
    }
#endif
    const int apart = (part_rows ? (int)get_global_size(0) * BAND : grid.rows) * pitch;
    const int shift = part_rows ? -start * BAND * pitch : 0;
    const int walked = add_others(grid, psf, source, value, intervals, coefficients, outlines, first, end,
                                  at_first - steps, budget, part_rows, part, apart, shift,
                                  ends + (long)own * BAND * (grid.columns + 1) * END_PLANES,
                                  pitch, pad, total SUBPIXEL_VALUES OCCLUSION_VALUES ELLIPSE_VALUES QUADRANT_VALUES);
    if (cut)
        position[own] = walked == DONE ? DONE : steps + walked;
}

#pragma OPENCL FP_CONTRACT OFF
