// Spreads every source over the pixels that it lights, as blur.cl does, for devices with many small cores: a work-item
// for each output pixel, and a group for each tile of them. Twin: clsco/reference/blur/blur.py.
//
//   source, value, sub_source, sub_value, intervals, coefficients, total: as in blur.cl
//
// The group walks the sources around its tile row by row, a chunk at a time. Each work-item looks up one source of the
// chunk, and stores it in local memory if it reaches the tile; then each adds, in the order of the sources, those that
// reach its own pixel: the same bits in every run, without atomics. Sources have no occluders here.

#include "common/sources.clh"
#include "common/source_visibility.clh"

#pragma OPENCL FP_CONTRACT ON

#define CHUNK (GROUP_COLUMNS * GROUP_ROWS)  // sources, one for each work-item; sums have as many taps
#define WORD 32

// Sources of a chunk: a bit for each source that reaches the tile, and for these the position on the grid, the address
// of weights, the rest of the record that is needed (sources.clh), and the radiance (`light`).
typedef struct {
    uint reaching[CHUNK / WORD];
    int x[CHUNK], y[CHUNK];
    spread_t spread[CHUNK];
#if TILT
    float2 slope[CHUNK];
#endif
#if SUBPIXELS
    int slot[CHUNK];
#endif
    float light[CHUNK][CHANNELS];
} chunk_t;

// First and last columns and rows of a tile on the grid.
typedef struct {
    int left, right, top, bottom;
} tile_t;

// Stores source (x, y) of the grid as the i-th of a chunk, if it reaches the tile.
static void note_source(const grid_t grid, const psf_t psf, __global const float *source,
                        __global const float *value, __global const int2 *intervals, __global const float *coefficients,
                        tile_t tile, int x, int y, int i, __local chunk_t *chunk SUBPIXEL_ARGUMENTS) {
    const int at = y * grid.width + x, plane = grid.width * grid.height;
    const float4 s = get_source(source, plane, at);
    int far = -1;
#if SUBPIXELS
    const int slot = as_int(s.w);
    chunk->slot[i] = slot;
    for (int sub = 0; slot >= 0 && sub < SOURCES_OF(slot); ++sub) {
        const float coordinate = sub_source[FIRST_SLOT(slot) * EACH + sub].x;
        if (coordinate >= 0)
            far = MAX(far, sub_intervals[(int)coordinate - psf.sub_first].y);
    }
    if (slot < 0)
#endif
    if (s.x >= 0) {
        const spread_t spread = pixel_spread(
            psf, intervals, coefficients, s.x PLACE_VALUES(FRAME_ROW(grid, y), x - grid.guard));
        chunk->spread[i] = spread;
        far = spread.half_width;
    }
    if (MAX(MAX(tile.left - x, x - tile.right), MAX(tile.top - y, y - tile.bottom)) > far || far < 0)
        return;
    atomic_or(&chunk->reaching[i / WORD], 1u << i % WORD);
    chunk->x[i] = x;
    chunk->y[i] = y;
#if TILT
    chunk->slope[i] = s.yz;
#endif
    for (int k = 0; k < CHANNELS; ++k)
        chunk->light[i][k] = value[k * plane + at];
}

// Adds the radiance of one source to the pixel (dx, dy) from it.
static void add_source_tap(spread_t spread, int dx, int dy, float4 source, const float *light,
                           float *sum QUADRANT_ARGUMENTS) {
    if (MAX(ABS(dx), ABS(dy)) > spread.half_width)
        return;
    const float weight = tap(spread, dx, dy, source);
    for (int k = 0; k < CHANNELS; ++k) {
#if QUADRANTS
        sum[k] += HALF_SHARE(side, dy) * HALF_SHARE(1, dx) * weight * light[k];
        sum[CHANNELS + k] += HALF_SHARE(side, dy) * HALF_SHARE(-1, dx) * weight * light[k];
#else
        sum[k] += weight * light[k];
#endif
    }
}

// Adds the radiance of the i-th source of a chunk to pixel (x, y) of the grid.
static void add_source(const grid_t grid, const psf_t psf, int x, int y, int i, __local const chunk_t *chunk,
                       float *sum SUBPIXEL_ARGUMENTS QUADRANT_ARGUMENTS) {
    const int dx = x - chunk->x[i], dy = y - chunk->y[i];
    float light[CHANNELS];
#if SUBPIXELS
    if (chunk->slot[i] >= 0) {
        for (int sub = 0; sub < SOURCES_OF(chunk->slot[i]); ++sub) {
            const int id = FIRST_SLOT(chunk->slot[i]) * EACH + sub;
            const float4 s = sub_source[id];
            if (s.x < 0)
                continue;
            for (int k = 0; k < CHANNELS; ++k)
                light[k] = sub_value[k * capacity * EACH + id];
            const spread_t spread = subpixel_spread(
                psf, sub_intervals, sub_coefficients, s,
                sub PLACE_VALUES(FRAME_ROW(grid, chunk->y[i]), chunk->x[i] - grid.guard));
            add_source_tap(spread, dx, dy, s, light, sum QUADRANT_VALUES);
        }
        return;
    }
#endif
    float4 s = 0;
#if TILT
    s.yz = chunk->slope[i];
#endif
    for (int k = 0; k < CHANNELS; ++k)
        light[k] = chunk->light[i][k];
    add_source_tap(chunk->spread[i], dx, dy, s, light, sum QUADRANT_VALUES);
}

// One work-item per pixel, in groups of a tile. In and out: total.
__attribute__((reqd_work_group_size(GROUP_COLUMNS, GROUP_ROWS, 1)))
__kernel void tiles(const grid_t grid, const psf_t psf, __global const float *source, __global const float *value,
                    __global const int2 *intervals, __global const float *coefficients, const int pitch, const int pad,
                    __global float *total SUBPIXEL_ARGUMENTS QUADRANT_ARGUMENTS) {
    __local chunk_t chunk;
    const int column = get_global_id(0), row = get_global_id(1);
    const int item = get_local_id(1) * GROUP_COLUMNS + get_local_id(0);
    const int x = column + grid.guard, y = row + grid.above;
    const int left = x - (int)get_local_id(0), top = y - (int)get_local_id(1);
    const tile_t tile = {left, left + GROUP_COLUMNS - 1, top, top + GROUP_ROWS - 1};
    // Chunks go beyond the grid, where nothing is, so that they, and all bits, do not depend on the width of the apron.
    const int first_x = tile.left - psf.reach, across = GROUP_COLUMNS + 2 * psf.reach;
    const int first_y = tile.top - psf.reach, down = GROUP_ROWS + 2 * psf.reach;
    float sum[SIDES * CHANNELS], over[SIDES * CHANNELS];
    for (int k = 0; k < SIDES * CHANNELS; ++k)
        sum[k] = over[k] = 0;  // not as {0}, for which PoCL 3.0 makes wrong code with two channels
    // Work-items beyond the end of the frame look up sources, too.
    for (int start = 0; start < across * down; start += CHUNK) {
        barrier(CLK_LOCAL_MEM_FENCE);  // all are done with the previous chunk
        if (item < CHUNK / WORD)
            chunk.reaching[item] = 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        const int n = start + item, source_x = first_x + n % across, source_y = first_y + n / across;
        if (n < across * down && source_x >= 0 && source_x < grid.width && source_y >= 0 && source_y < grid.height)
            note_source(grid, psf, source, value, intervals, coefficients, tile, source_x, source_y, item,
                        &chunk SUBPIXEL_VALUES);
        barrier(CLK_LOCAL_MEM_FENCE);
        float part[SIDES * CHANNELS];
        for (int k = 0; k < SIDES * CHANNELS; ++k)
            part[k] = 0;
        for (int word = 0; word < CHUNK / WORD; ++word)
            for (uint left_over = chunk.reaching[word]; left_over; left_over &= left_over - 1) {
                const int lowest = WORD - 1 - (int)clz(left_over & -left_over);
                add_source(grid, psf, x, y, word * WORD + lowest, &chunk, part SUBPIXEL_VALUES QUADRANT_VALUES);
            }
        for (int k = 0; k < SIDES * CHANNELS; ++k) {  // Kahan summation, as wide PSFs have thousands of chunks
            const float more = part[k] - over[k], next = sum[k] + more;
            over[k] = (next - sum[k]) - more;
            sum[k] = next;
        }
    }
    if (column < grid.columns && row < grid.rows)
        for (int k = 0; k < SIDES * CHANNELS; ++k) {
#if QUADRANTS
            const int plane = (k < CHANNELS ? on_right : on_left - 1) * CHANNELS + k;
#else
            const int plane = k;
#endif
            total[(plane * grid.rows + row) * pitch + column + pad] += sum[k];
        }
}

#pragma OPENCL FP_CONTRACT OFF
