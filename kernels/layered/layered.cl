// Layered occlusion, from the pinhole image alone. Depth layers k of the blur radius are blurred as sheets, which have
// radiance C, radius R and coverage a in all pixels, by the kernels of the blur, and laid over each other from the
// nearest on,
//     I = sum_k T_k B(a C) / B(1),  T_k+1 = T_k (1 - B(a) / B(1)),  T_1 = 1.
// Both sums of a ratio run over the whole sheet: even radiance stays even. With QUADRANTS, T_k is that of each quadrant
// of the lens, so that what hides one side of it leaves the other side free: with sums B_q over the taps of quadrant q,
//     I = sum_kq T_kq B_q(a C) / B(1),  T_k+1,q = T_kq (1 - B_q(a) / B_q(1)),
// divided by the same of C = 1 plus the fraction that is left of the lens, which are 1 unless radii differ much. Small
// discs have too few taps for quadrants, and are laid over all of them. Tiles without an edge in reach are blurred
// without occlusion. Twin: clsco/reference/layered/layered.py. Host: clsco/passes/layered.py, which picks it for
// psf.occlusion = "layered".
//
// On the padded grid (height, width), row-major; a smaller signed radius is nearer:
//   value    float (CHANNELS, height, width): radiance; with ALPHA, times alpha, which is one more plane
//   coc      real: signed blur radius in px
//   valid    uchar: 1 where there is a surface
//   layer    uchar: 1 is the nearest, 0 no surface
//   sides    uchar: next to a discontinuity, 16 times the nearer layer plus the farther one, else 0
//   mixed    float (2 CHANNELS + 1, height, width), only next to discontinuities: radiance of the nearer and of the
//            farther surface in the pixel, and share of the nearer one
// per tile of LAYER_TILE rows and columns
//   reach    int: px that its sources reach, -1 for none; edge: not 0 if light of its sources does not just add up
//   marked   int: 1 if an edge matters in it; to_marked, to_plain: px to the nearest tile that is or is not marked
// and for the sheet that is being blurred
//   pyramid  float, level by level from the second on, each (PLANES, rows, columns): radiance and radius, 1 where they
//            are known; coverage, and 1 where it is known
//   left     int per tile: 1 if it is marked and not yet covered by nearer sheets; to_left: px to the nearest such tile
//   sheet    float (CHANNELS + 2, height, width): radiance times coverage, coverage, and ones
//   sheet_coc, sheet_valid: as coc and valid
// All steps use integers, or sums in a fixed order: the same bits every time.

#include "common/geometry.clh"
#include "layered/tiles.clh"

#pragma OPENCL FP_CONTRACT ON  // as where radiance is summed in the blur

#define MASK_REACH 2      // px, last offset of MASK
#define NOISE 5.0f        // weight of the surfaces' variance against the color of a mixed pixel
#define LEAST_DEVIATION 0.02f  // least standard deviation of a surface, as a share of its color
#define UNEVEN 0.1f       // px, least step of the radius that changes the brightness of an even surface
#define FEWEST_TAPS 4.8f  // least taps in a quadrant of a disc
#define NOWHERE (1 << 24)  // px, farther than anything reaches

// Gaussian of 0.6 px: by it, the labels alone give the share of a layer.
__constant float MASK[MASK_REACH + 1] = {1, 0.24935221f, 0.0038659201f};

static int bin_of(real coc, real low, int bins) {
    const real at = FLOOR((coc - low) / LAYER_BIN);
    return at < 0 ? 0 : at < bins ? (int)at : bins - 1;
}

// One row or column per work-item. In and out: latest int (DISCONTINUITY_CLASSES, bins): for discontinuities of class
// k, larger than DISCONTINUITY 2^k, whose far side is in a bin, 1 + the largest bin of the near side, 0 for none.
__kernel void find_discontinuities(const grid_t grid, const real low, const int bins, const int far,
                                   __global const real *coc, __global const uchar *valid, __global int *latest) {
    const int line = get_global_id(0);
    if (line >= grid.height + grid.width)
        return;
    const bool is_row = line < grid.height;
    const int length = is_row ? grid.width : grid.height, step = is_row ? 1 : grid.width;
    const int start = is_row ? line * grid.width : line - grid.height;
    int last = -far - 1;
    real before = 0;
    for (int i = 0; i < length; ++i) {
        const int at = start + i * step;
        if (!valid[at])
            continue;
        const real now = coc[at], size = ABS(now - before);
        if (size > DISCONTINUITY && i - last <= far && last >= 0) {
            int class = 0;
            while (class < DISCONTINUITY_CLASSES - 1 && size > DISCONTINUITY * (2 << class))
                ++class;
            __global int *entry = latest + class * bins + bin_of(MAX(now, before), low, bins);
            const int begin = bin_of(MIN(now, before), low, bins) + 1;
            if (RELAXED_LOAD(entry) < begin)
                atomic_max(entry, begin);
        }
        last = i;
        before = now;
    }
}

// bounds: first bins of the second and each further layer, `count` of them. Out: layer.
__kernel void label_depth_layers(const grid_t grid, const real low, const int bins, const int count,
                                 const int8 bounds, __global const real *coc, __global const uchar *valid,
                                 __global uchar *layer) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int at = y * grid.width + x, bin = bin_of(coc[at], low, bins);
    int label = 1;
    while (label <= count && bin >= ((const int *)&bounds)[label - 1])
        ++label;
    layer[at] = valid[at] ? label : 0;
}

// Both depth layers at a pixel of layer `own`, as in `sides`; open: set if a neighbor has no surface.
static int sides_of(const grid_t grid, int x, int y, int own, __global const real *coc, __global const uchar *layer,
                    int *open) {
    const int at = y * grid.width + x;
    const int near[4] = {y > 0 ? at - grid.width : at, y + 1 < grid.height ? at + grid.width : at,
                         x > 0 ? at - 1 : at, x + 1 < grid.width ? at + 1 : at};
    int before = 0, behind = 0;
    for (int k = 0; k < 4; ++k) {
        const int other = layer[near[k]];
        const real step = coc[near[k]] - coc[at];
        *open |= !other;
        if (other && other < own && step < -DISCONTINUITY)
            before = MAX(before, other);
        if (other > own && step > DISCONTINUITY)
            behind = behind ? MIN(behind, other) : other;
    }
    return before ? before << 4 | own : behind ? own << 4 | behind : 0;
}

// True if sources of two neighbors do not add up to even light: their radii differ, or the focus is between them.
static bool is_uneven(real coc, real other) {
    return ABS(other - coc) > UNEVEN || (coc < 0) != (other < 0);
}

// One tile per work-item. In: value, coc, layer. Out: sides, reach, edge.
__kernel void find_edges(const grid_t grid, const real2 spread, __global const float *value,
                         __global const real *coc, __global const uchar *layer, __global uchar *sides,
                         __global int *reach, __global int *edge) {
    const int left = get_global_id(0) * LAYER_TILE, top = get_global_id(1) * LAYER_TILE;
    if (left >= grid.width || top >= grid.height)
        return;
    const int right = MIN(left + LAYER_TILE, grid.width), bottom = MIN(top + LAYER_TILE, grid.height);
    real largest = 0;
    int any = 0, edges = 0;
    for (int y = top; y < bottom; ++y)
        for (int x = left; x < right; ++x) {
            const int at = y * grid.width + x, own = layer[at];
            any |= own;
            largest = MAX(largest, own ? ABS(coc[at]) : 0);
            const bool inside = x > 0 && x + 1 < grid.width && y > 0 && y + 1 < grid.height;
            const bool same = inside && layer[at - 1] == own && layer[at + 1] == own &&
                              layer[at - grid.width] == own && layer[at + grid.width] == own;
            sides[at] = same || !own ? 0 : sides_of(grid, x, y, own, coc, layer, &edges);
            if (alpha_of(value, grid.width * grid.height, at) < OPAQUE)
                sides[at] = 0;
            edges |= sides[at];
            if (own && x + 1 < grid.width && layer[at + 1])
                edges |= is_uneven(coc[at], coc[at + 1]);
            if (own && y + 1 < grid.height && layer[at + grid.width])
                edges |= is_uneven(coc[at], coc[at + grid.width]);
        }
    const int tile = tile_of(grid, left, top);
    reach[tile] = any ? reach_of(largest, spread) : -1;
    edge[tile] = edges;
}

// Weighted sums of colors, and of their squares; least and largest color.
typedef struct {
    float weight, color[CHANNELS], square[CHANNELS], least[CHANNELS], most[CHANNELS];
} colors_t;

// Radiance of the two surfaces in a pixel at a discontinuity, and the share of the nearer one. The mean colors of both
// explain the pixel's color; their variances say how much that counts against the mask. Both get what is left, but not
// beyond the colors of their pixels. In: value, layer, sides. Out: mixed.
static void unmix_at(const grid_t grid, int x, int y, __global const float *value, __global const uchar *layer,
                     __global const uchar *sides, __global float *mixed) {
    const int at = y * grid.width + x, near = sides[at] >> 4, far = sides[at] & 15, plane = grid.width * grid.height;
    float mask[2] = {0, 0};
    colors_t sums[4] = {{0}, {0}, {0}, {0}};  // of the near and the far side, away from edges and at edges
    for (int c = 0; c < CHANNELS; ++c)
        for (int k = 0; k < 4; ++k)
            sums[k].least[c] = sums[k].most[c] = value[c * plane + at];
    for (int dy = MAX(-MIXED_AROUND, -y); dy <= MIN(MIXED_AROUND, grid.height - 1 - y); ++dy)
        for (int dx = MAX(-MIXED_AROUND, -x); dx <= MIN(MIXED_AROUND, grid.width - 1 - x); ++dx) {
            const int there = at + dy * grid.width + dx, own = layer[there];
            if ((own != near && own != far) || alpha_of(value, plane, there) < OPAQUE)
                continue;
            const bool behind = own == far;
            if (MAX(ABS(dx), ABS(dy)) <= MASK_REACH)
                mask[behind] += MASK[ABS(dy)] * MASK[ABS(dx)];
            colors_t *sum = sums + behind + 2 * (sides[there] > 0);
            const float weight = (MIXED_AROUND + 1 - ABS(dy)) * (MIXED_AROUND + 1 - ABS(dx));
            sum->weight += weight;
            for (int c = 0; c < CHANNELS; ++c) {
                const float color = value[c * plane + there];
                sum->color[c] += weight * color;
                sum->square[c] += weight * color * color;
                sum->least[c] = MIN(sum->least[c], color);
                sum->most[c] = MAX(sum->most[c], color);
            }
        }
    const float by_mask = mask[0] / (mask[0] + mask[1]);
    float noise = 0, squares = 0, by_color = 0, apart = 0, mean[2][CHANNELS];
    bool alone = false;  // True if one surface is not opaque, so that its color is not known
    for (int c = 0; c < CHANNELS; ++c) {
        for (int k = 0; k < 2; ++k) {
            const colors_t *sum = sums + k + (sums[k].weight > 0 ? 0 : 2);  // thin things are all edge
            alone |= sum->weight == 0;
            mean[k][c] = sum->color[c] / sum->weight;
            noise += MAX(sum->square[c] / sum->weight - mean[k][c] * mean[k][c], 0.0f);
        }
        const float color = value[c * plane + at], difference = mean[0][c] - mean[1][c];
        squares += color * color;
        by_color += (color - mean[1][c]) * difference;
        apart += difference * difference;
    }
    const float doubt = NOISE * (noise + LEAST_DEVIATION * LEAST_DEVIATION * (0.1f + squares));
    alone |= !(apart + doubt < FLT_MAX);
    const float fitting = MIN(MAX((by_color + doubt * by_mask) / (apart + doubt), 0.0f), 1.0f);
    const float share = alone ? layer[at] == near : fitting, rest = 1 - share;
    for (int c = 0; c < CHANNELS; ++c) {
        const float color = value[c * plane + at];
        const float left = (color - share * mean[0][c] - rest * mean[1][c]) / (share * share + rest * rest);
        for (int k = 0; k < 2; ++k) {
            const colors_t *sum = sums + k + (sums[k].weight > 0 ? 0 : 2);
            const float part = mean[k][c] + (k ? rest : share) * left;
            mixed[(k * CHANNELS + c) * plane + at] = alone ? color : MIN(MAX(part, sum->least[c]), sum->most[c]);
        }
    }
    mixed[2 * CHANNELS * plane + at] = share;
}

// `unmix_at` for LAYER_TILE pixels of a row.
__kernel void unmix(const grid_t grid, __global const int *edge, __global const float *value,
                    __global const uchar *layer, __global const uchar *sides, __global float *mixed) {
    const int begin = get_global_id(0) * LAYER_TILE, y = get_global_id(1);
    if (begin >= grid.width || y >= grid.height || !edge[tile_of(grid, begin, y)])
        return;
    for (int x = begin; x < MIN(begin + LAYER_TILE, grid.width); ++x)
        if (sides[y * grid.width + x])
            unmix_at(grid, x, y, value, layer, sides, mixed);
}

// Px between the nearest rows or columns of two tiles, whichever are farther apart.
static int between_tiles(int dx, int dy) {
    return MAX((MAX(ABS(dx), ABS(dy)) - 1) * LAYER_TILE + 1, 0);
}

// Marks the tiles that have an edge as near as a source that reaches them, if `several` sheets are there. far: tiles
// around one, beyond which nothing reaches it. In: reach, edge. Out: marked.
__kernel void mark_tiles(const int rows, const int columns, const int far, __global const int *reach,
                         __global const int *edge, __global int *marked) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= columns || y >= rows)
        return;
    int coming = -1, mark = 0;
    for (int dy = MAX(-far, -y); dy <= MIN(far, rows - 1 - y); ++dy)
        for (int dx = MAX(-far, -x); dx <= MIN(far, columns - 1 - x); ++dx) {
            const int there = reach[(y + dy) * columns + x + dx];
            coming = between_tiles(dx, dy) <= there ? MAX(coming, there) : coming;
        }
    for (int dy = MAX(-far, -y); dy <= MIN(far, rows - 1 - y); ++dy)
        for (int dx = MAX(-far, -x); dx <= MIN(far, columns - 1 - x); ++dx)
            mark |= edge[(y + dy) * columns + x + dx] && between_tiles(dx, dy) <= coming;
    marked[y * columns + x] = mark;
}

// Tiles among `marked` that the sources with `reach` reach. Out: needed.
__kernel void need_tiles(const int rows, const int columns, const int far, __global const int *reach,
                         __global const int *marked, __global int *needed) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= columns || y >= rows)
        return;
    int need = 0;
    for (int dy = MAX(-far, -y); dy <= MIN(far, rows - 1 - y) && marked[y * columns + x]; ++dy)
        for (int dx = MAX(-far, -x); dx <= MIN(far, columns - 1 - x); ++dx)
            need |= between_tiles(dx, dy) <= reach[(y + dy) * columns + x + dx];
    needed[y * columns + x] = need;
}

// Px from each tile to the nearest one whose flag is `which`. In: flags. Out: distance.
__kernel void measure_tiles(const int rows, const int columns, const int far, const int which,
                            __global const int *flags, __global int *distance) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= columns || y >= rows)
        return;
    int least = NOWHERE;
    for (int dy = MAX(-far, -y); dy <= MIN(far, rows - 1 - y); ++dy)
        for (int dx = MAX(-far, -x); dx <= MIN(far, columns - 1 - x); ++dx)
            if (flags[(y + dy) * columns + x + dx] == which)
                least = MIN(least, between_tiles(dx, dy));
    distance[y * columns + x] = least;
}

// Discards the sources that do not reach a tile `distance` px away, LAYER_TILE of a row at a time; sign: of the radii
// of sources to keep, 0 for any. In: coc, distance. In and out: source.
__kernel void keep_sources(const grid_t grid, const real2 spread, const int sign, __global const real *coc,
                           __global const int *distance, __global float *source) {
    const int begin = get_global_id(0) * LAYER_TILE, y = get_global_id(1), row = y * grid.width;
    if (begin >= grid.width || y >= grid.height)
        return;
    const int away = distance[tile_of(grid, begin, y)], end = MIN(begin + LAYER_TILE, grid.width);
    for (int at = row + begin; at < row + end; ++at) {
        const bool near = ABS(coc[at]) * spread.x + spread.y > away - 1 - REACH_MARGIN;  // reach_of is at least `away`
        source[at] = near & (!sign | ((coc[at] < 0) == (sign < 0))) ? source[at] : -1;
    }
}

// First column of the frame in the tile of this work-item, or of the one `further` to the right.
static int first_column(const grid_t grid, int further) {
    return MIN(MAX(((int)get_global_id(0) + further) * LAYER_TILE - grid.guard, 0), grid.columns);
}

// Lays a blurred sheet behind the previous ones in the tiles that it reaches. In: blurred float (CHANNELS + 2, rows,
// from_pitch), of all quadrants if there are, with scratch columns as the total of blur.cl; left, needed. In and out:
// room float (rows, columns), the fraction of the lens that is free, with QUADRANTS of each of the four, and then the
// light of C = 1; light float (CHANNELS, rows, columns); still_left: 1 for tiles with room.
__kernel void composite(const grid_t grid, const int from_pitch, const int from_pad, __global const float *blurred,
                        __global const int *left, __global const int *needed, __global float *room,
                        __global float *light, __global int *still_left
#if QUADRANTS
                        , __global const real *coc  // of the sheet
#endif
                        ) {
    const int row = get_global_id(1), begin = first_column(grid, 0), end = first_column(grid, 1);
    if (begin >= end || row >= grid.rows)
        return;
    const int tile = tile_of(grid, begin + grid.guard, row + grid.above);
    if (!left[tile])
        return;
    bool open = !needed[tile];
    for (int column = begin; column < end && needed[tile]; ++column) {
        __global const float *sums = blurred + row * from_pitch + column + from_pad;
        const int at = row * grid.columns + column, plane = grid.rows * from_pitch;
#if QUADRANTS
        const int pixels = grid.rows * grid.columns, apart = (CHANNELS + 2) * plane;
        const float radius = (float)coc[(row + grid.above) * grid.width + column + grid.guard];
        const bool joined = M_PI_F * radius * radius < 4 * FEWEST_TAPS;
        float coverage[4], covered = 0, unseen = 0;
        for (int q = 0; q < 4; ++q) {
            coverage[q] = sums[q * apart + CHANNELS * plane];
            covered += coverage[q];
            unseen += room[q * pixels + at];
        }
        if (covered > 0) {
            float own[4], ones = 0, mean = 0;
            for (int q = 0; q < 4; ++q) {
                own[q] = sums[q * apart + (CHANNELS + 1) * plane];
                ones += own[q];
                mean += room[q * pixels + at] * own[q];
            }
            unseen = 0;
            for (int q = 0; q < 4; ++q) {
                const float before = room[q * pixels + at], part = (joined ? mean / ones : before) / ones;
                const float share = joined || own[q] <= 0 ? covered / ones : coverage[q] / own[q];
                for (int c = 0; c < CHANNELS; ++c)
                    light[c * pixels + at] += part * sums[q * apart + c * plane];
                room[4 * pixels + at] += part * coverage[q];
                room[q * pixels + at] = before * (1 - MIN(share, 1.0f));
                unseen += room[q * pixels + at];
            }
        }
        open |= unseen > 0;
#else
        const float ones = sums[(CHANNELS + 1) * plane], before = room[at];
        if (ones > 0) {
            for (int c = 0; c < CHANNELS; ++c)
                light[c * grid.rows * grid.columns + at] += before * (sums[c * plane] / ones);
            room[at] = before * (1 - MIN(sums[CHANNELS * plane] / ones, 1.0f));
        }
        open |= room[at] > 0;
#endif
    }
    if (open)
        raise(still_left + tile, 1);
}

// Puts the light of all sheets in place of that without occlusion, in marked tiles; with ALPHA, and what they cover.
// In: marked, light, room. In and out: total float (CHANNELS + ALPHA, rows, pitch), with `pad` scratch columns as in
// blur.cl.
__kernel void put_layers(const grid_t grid, const int pitch, const int pad, __global const int *marked,
                         __global const float *light, __global const float *room, __global float *total) {
    const int row = get_global_id(1), begin = first_column(grid, 0), end = first_column(grid, 1);
    if (begin >= end || row >= grid.rows || !marked[tile_of(grid, begin + grid.guard, row + grid.above)])
        return;
    for (int column = begin; column < end; ++column) {
        const int at = row * grid.columns + column, pixels = grid.rows * grid.columns;
#if QUADRANTS
        const float left = 0.25f * (room[at] + room[pixels + at] + room[2 * pixels + at] + room[3 * pixels + at]);
        const float seen = room[4 * pixels + at], scale = seen > 0 ? 1 / (seen + left) : 0, coverage = seen * scale;
#else
        const float scale = 1, coverage = 1 - room[at];
#endif
        for (int c = 0; c < CHANNELS; ++c)
            total[(c * grid.rows + row) * pitch + column + pad] = scale * light[c * pixels + at];
        if (ALPHA)
            total[(CHANNELS * grid.rows + row) * pitch + column + pad] = coverage;
    }
}

#pragma OPENCL FP_CONTRACT OFF
