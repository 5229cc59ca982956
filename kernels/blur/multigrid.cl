// An approximation: sources of wide blur are blurred on coarser grids, and their frames enlarged,
//     I = I_0 + E(I_1 + E(I_2 + ...)),  I_k = sum of the sources that have moved to grid k, E: bilinear enlargement.
// Here: which sources move, their radiance and radii at half the resolution, and the way back. Twin:
// clsco/reference/blur/multigrid.py. Host, and which radii move: clsco/passes/multigrid.py.
//
//   grid    of a level: (height, width) as camera has it, px of that level. Node (i, j) of the next one stands at
//           (2 i - 3.5, 2 j - 3.5), in the middle of four pixels.
//   plane   float (height + 2 EDGE_ROWS, pitch) of a grid, with EDGE_COLUMNS columns on the left and at least as many
//           on the right: radii, radiance of moved sources, ...; 0 all around.
//   source: common/sources.clh; value, total: blur.cl. A source that has moved keeps its coordinate u as -2 - u, so
//           that gather leaves it out.
//
// The host picks it for the methods coarse2 to coarse16 only, with `gather` or `tiles` on each grid. Eight pixels at
// a time took `pick` from 60 to 100 to 4 ns per pixel (benchmarks/optimisation_log.md). Features: CHANNELS, TILT, DISC
// (of the finest table), SAMPLED (of the coarser tables).

#pragma OPENCL FP_CONTRACT ON

#define AT(x, y) (((y) + EDGE_ROWS) * pitch + (x) + EDGE_COLUMNS)
#define NOTHING -1.0f  // in a plane of radii: no source that may move
#define MOVED(u) (-2 - (u))  // its own inverse

// Blur radius in px of a coordinate in the finest table, the inverse of table_coordinate; sampled: of a sampled PSF.
static inline float8 radius_of(const psf_t psf, float8 u, int sampled)
{
    if (sampled) {
        const float fine = (float)psf.fine_until * (float)psf.fine_steps;
        const float8 key = u < fine ? u / (float)psf.fine_steps : (float)psf.fine_until + (u - fine);
        const float8 square = key / (float)psf.key, least = (float)(psf.minimum_blur * psf.minimum_blur);
        return sqrt(square > least ? square : least);
    }
    const float8 position = u / (float)psf.steps;
    const int8 octave = convert_int8(position);
    return (as_float8((127 + octave) << 23) * (1 + (position - convert_float8(octave))) - 1) / (float)psf.octaves_from;
}

// Radii of the sources that may move: whole ones, without occluders. In: source of the finest grid, marked:
// with a plane of marks. Out: radius, a plane that is NaN around the grid; tilt, with TILT: planes of R dR/dx and R
// dR/dy. TAP_LANES pixels at a time.
__kernel void measure_radii(const camera_t camera, const psf_t psf, __global const float *source, const int marked,
                            const int sampled, const int pitch, __global float *radius, __global float *tilt)
{
    const int x = get_global_id(0) * TAP_LANES, y = get_global_id(1);
    if (x >= camera.width || y >= camera.height)
        return;
    const int count = MIN(TAP_LANES, camera.width - x), plane = (camera.height + 2 * EDGE_ROWS) * pitch;
    const int all = camera.width * camera.height;
    float8 u, right = 0, down = 0;
    for (int i = 0; i < TAP_LANES; ++i) {
        const int at = y * camera.width + x + MIN(i, count - 1);
        const float4 s = get_source(source, all, at);
        ((float *)&u)[i] = !marked || as_int(MARKS(source, all)[at]) == WHOLE ? s.x : -1;
        ((float *)&right)[i] = s.y;
        ((float *)&down)[i] = s.z;
    }
    const float8 nothing = NOTHING, r = u >= 0 ? radius_of(psf, u, sampled) : nothing;
    __global float *out = radius + AT(x, y);
    for (int i = 0; i < count; ++i)
        out[i] = ((const float *)&r)[i];
#if TILT
    STORE(float, 8, right * r * r, tilt + AT(x, y));
    STORE(float, 8, down * r * r, tilt + plane + AT(x, y));
#endif
}

// Lanes i to i + 7 of a row of twelve, given the first and the last eight of them.
#define FROM_1(a, b) (float8)((a).s1234, (a).s567, (b).s4)
#define FROM_2(a, b) (float8)((a).s2345, (a).s67, (b).s45)
#define FROM_3(a, b) (float8)((a).s3456, (a).s7, (b).s456)
// NaN as b changes nothing.
#define LOWER(a, b) ((b) < (a) ? (b) : (a))
#define HIGHER(a, b) ((b) > (a) ? (b) : (a))

// Moves the sources of |R| >= from px whose neighbors within 2 px may move too and differ by at most `steepest` px: no
// node gets radiance from both sides of a depth discontinuity. From `from` to `to` px the share that moves rises from 0
// to 1, since a PSF's error shows most where its radiance ends. In: radius; value and, maybe the same, kept: all
// radiance, and what stays. In and out: source. Out: moved, radii of those; radiance, a plane for each channel.
// TAP_LANES pixels at a time.
__kernel void pick(const camera_t camera, __global const float *radius, __global const float *value, const float from,
                   const float to, const float steepest, const int pitch, __global float *source, __global float *kept,
                   __global float *moved, __global float *radiance)
{
    const int x = get_global_id(0) * TAP_LANES, y = get_global_id(1);
    if (x >= camera.width || y >= camera.height)
        return;
    const int at = y * camera.width + x, place = AT(x, y), plane = (camera.height + 2 * EDGE_ROWS) * pitch;
    const int count = MIN(TAP_LANES, camera.width - x);
    const float8 r = LOAD(float, 8, radius + place), least = -INFINITY, most = INFINITY, one = 1, none = 0;
    float8 low[2] = {most, most}, high[2] = {least, least};  // of columns from x - 2 and from x + 2 on
    #pragma unroll
    for (int i = -2; i <= 2; ++i) {
        #pragma unroll
        for (int j = 0; j < 2; ++j) {
            const float8 n = LOAD(float, 8, radius + place + i * pitch + 4 * j - 2);
            low[j] = LOWER(low[j], n);
            high[j] = HIGHER(high[j], n);
        }
    }
    float8 lowest = LOWER(low[0], low[1]), highest = HIGHER(high[0], high[1]);
    lowest = LOWER(lowest, FROM_1(low[0], low[1]));
    lowest = LOWER(lowest, FROM_2(low[0], low[1]));
    lowest = LOWER(lowest, FROM_3(low[0], low[1]));
    highest = HIGHER(highest, FROM_1(high[0], high[1]));
    highest = HIGHER(highest, FROM_2(high[0], high[1]));
    highest = HIGHER(highest, FROM_3(high[0], high[1]));
    float8 t = (r - from) / (to - from);
    t = t > 0 ? t : none;
    t = t < 1 ? t : one;
    const float8 share = (lowest >= r - steepest && highest <= r + steepest) ? t * t * (3 - 2 * t) : none;
    STORE(float, 8, share > 0 ? r : none, moved + place);
    for (int k = 0; k < CHANNELS; ++k) {
        const int here = k * camera.height * camera.width + at;
        float8 v = 0;
        if (count == TAP_LANES) {
            v = LOAD(float, 8, value + here);
            STORE(float, 8, v - share * v, kept + here);
        } else
            for (int i = 0; i < count; ++i) {
                ((float *)&v)[i] = value[here + i];
                kept[here + i] = ((float *)&v)[i] * (1 - ((const float *)&share)[i]);
            }
        STORE(float, 8, share * v, radiance + k * plane + place);
    }
    for (int i = 0; i < count; ++i)
        if (((const float *)&share)[i] == 1)
            source[at + i] = MOVED(source[at + i]);
}

// Sums (1, 3, 3, 1) along a row of TAP_LANES nodes, the first of which begins at p.
static inline float8 along(float16 left, float16 right)
{
    return (left.even + right.odd) + 3 * (left.odd + right.even);
}

// Radiance and radii of the next level's nodes: each source is shared among the four around it as bilinear
// interpolation would take it back, so that its radiance stays where it is. loss: what of R^2 the way there and back
// does by itself, px^2. In: moved, radiance; tilt, with TILT. Out: value of the next grid; radius, its plane, NOTHING
// where no radiance is; next_tilt, its planes. TAP_LANES nodes at a time.
__kernel void halve(const camera_t camera, const camera_t next, __global const float *moved,
                    __global const float *radiance, __global const float *tilt, const float loss, const int pitch,
                    const int next_pitch, __global float *value, __global float *radius, __global float *next_tilt)
{
    const int x = get_global_id(0) * TAP_LANES, y = get_global_id(1);
    if (x >= next.width || y >= next.height)
        return;
    const int first = AT(2 * x - 5, 2 * y - 5), plane = (camera.height + 2 * EDGE_ROWS) * pitch;
    const int count = MIN(TAP_LANES, next.width - x), place = (y + EDGE_ROWS) * next_pitch + x + EDGE_COLUMNS;
    const float16 one = 1, none = 0;
    float8 sum = 0, number = 0, right = 0, down = 0;
    #pragma unroll
    for (int i = 0; i < 4; ++i) {
        const float share = i == 0 || i == 3 ? 1 : 3;
        const int row = first + i * pitch;
        const float16 a = LOAD(float, 16, moved + row), b = LOAD(float, 16, moved + row + 2);
        const float16 in_a = a > 0 ? one : none, in_b = b > 0 ? one : none;
        sum += share * along(a, b);
        number += share * along(in_a, in_b);
#if TILT
        right += share * along(in_a * LOAD(float, 16, tilt + row),
                               in_b * LOAD(float, 16, tilt + row + 2));
        down += share * along(in_a * LOAD(float, 16, tilt + plane + row),
                              in_b * LOAD(float, 16, tilt + plane + row + 2));
#endif
    }
    number = number > 0 ? number : -1;
    const float8 mean = sum / number, square = mean * mean - loss, nothing = NOTHING, zero = 0;
    const float8 r = number > 0 ? 0.5f * sqrt(square > 0 ? square : zero) : nothing;
    for (int i = 0; i < count; ++i)
        radius[place + i] = ((const float *)&r)[i];
#if TILT
    const int next_plane = (next.height + 2 * EDGE_ROWS) * next_pitch;
    STORE(float, 8, right / (2 * number), next_tilt + place);
    STORE(float, 8, down / (2 * number), next_tilt + next_plane + place);
#endif
    for (int k = 0; k < CHANNELS; ++k) {
        float8 total = 0;
        #pragma unroll
        for (int i = 0; i < 4; ++i) {
            __global const float *row = radiance + k * plane + first + i * pitch;
            total += (i == 0 || i == 3 ? 1.0f : 3.0f) *
                     along(LOAD(float, 16, row), LOAD(float, 16, row + 2));
        }
        total *= 1.0f / 64;
        __global float *out = value + (k * next.height + y) * next.width + x;
        for (int i = 0; i < count; ++i)
            out[i] = ((const float *)&total)[i];
    }
}

// Records of a coarser level's sources. blunt: second moment of a pixel over that of a PSF of 1 px. In: radius; tilt,
// with TILT. Out: source.
__kernel void aim_nodes(const camera_t camera, const psf_t psf, __global const float *radius,
                        __global const float *tilt, const float blunt, const int pitch, __global float *source)
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= camera.width || y >= camera.height)
        return;
    const int place = AT(x, y), plane = (camera.height + 2 * EDGE_ROWS) * pitch;
    const float r = radius[place];
    float4 record = (float4)(-1, 0, 0, as_float(WHOLE));
    if (r >= 0) {
        record.x = table_coordinate(psf, widened(r), 0);
#if TILT
        // The first moment of the radiance is half the change of its second one: so level radiance stays level.
        record.y = tilt[place] / (r * r + blunt);
        record.z = tilt[plane + place] / (r * r + blunt);
#endif
    }
    put_source(source, camera.width * camera.height, y * camera.width + x, record);
}

// Adds a coarser frame to the next finer one: bilinear interpolation of what a filter (-sharp, 1 + 2 sharp, -sharp)
// along rows and columns makes of it. TAP_LANES pixels at a time.
__kernel void enlarge(const camera_t coarse, const int coarse_pitch, const int coarse_pad,
                      __global const float *coarse_total, const camera_t camera, const int pitch, const int pad,
                      __global float *total, const float sharp)
{
    // From an odd pixel of the grid on, pixels 2 n - 3 and 2 n - 2 lie between nodes n and n + 1.
    const int odd = 1 - (camera.guard & 1);
    const int x = get_global_id(0) * TAP_LANES - odd, y = get_global_id(1);
    if (x >= camera.columns || y >= camera.rows)
        return;
    const int row = y + camera.guard, node = (row + 1) / 2 + 1, column = (x + camera.guard + 1) / 2 + 1;
    // Of four nodes, the second being the nearest.
    const float4 w = (float4)(0, 0.75f, 0.25f, 0) + sharp * (float4)(-0.75f, 1.25f, -0.25f, -0.25f);
    const float4 down = row & 1 ? w : w.wzyx;
    for (int k = 0; k < CHANNELS; ++k) {
        __global const float *at = coarse_total + (k * coarse.rows + node - 1 - coarse.guard) * coarse_pitch
                                   + column - 1 - coarse.guard + coarse_pad;
        float8 left = 0;  // seven nodes of one row, for four pairs of pixels
        #pragma unroll
        for (int i = 0; i < 4; ++i) {
            const float share = i == 0 ? down.x : i == 1 ? down.y : i == 2 ? down.z : down.w;
            left += share * LOAD(float, 8, at + i * coarse_pitch);
        }
        float8 radiance;
        radiance.even = w.x * left.lo + w.y * left.s1234 + w.z * left.s2345 + w.w * left.s3456;
        radiance.odd = w.w * left.lo + w.z * left.s1234 + w.y * left.s2345 + w.x * left.s3456;
        __global float *out = total + (k * camera.rows + y) * pitch + x + pad;
        STORE(float, 8, LOAD(float, 8, out) + radiance, out);
    }
}

// Takes from `missed` what radiance that has left the finest grid would have sent to some pixels by the exact way.
// place: (count) row and column in the frame. In: radiance, planes. In and out: missed float (count, CHANNELS).
__kernel void probe(const camera_t camera, const psf_t psf, __global const float *source,
                    __global const float *radiance,
                    const int pitch, __global const int2 *intervals, __global const float *coefficients,
                    const int count, __global const int2 *place, __global float *missed)
{
    const int n = get_global_id(0);
    if (n >= count)
        return;
    const int row = place[n].x + camera.guard, column = place[n].y + camera.guard;
    const int plane = (camera.height + 2 * EDGE_ROWS) * pitch;
    float sum[CHANNELS];
    for (int k = 0; k < CHANNELS; ++k)
        sum[k] = 0;
    for (int y = MAX(row - psf.reach, 0); y <= MIN(row + psf.reach, camera.height - 1); ++y) {
        float part[CHANNELS];  // of one row, as in gather
        for (int k = 0; k < CHANNELS; ++k)
            part[k] = 0;
        for (int x = MAX(column - psf.reach, 0); x <= MIN(column + psf.reach, camera.width - 1); ++x) {
            const float4 s = get_source(source, camera.width * camera.height, y * camera.width + x);
            if (s.x > -2 && s.x < 0)
                continue;
            const spread_t spread = pixel_spread(psf, intervals, coefficients, s.x < 0 ? MOVED(s.x) : s.x);
            if (MAX(ABS(row - y), ABS(column - x)) > spread.half_width)
                continue;
            const float w = tap(spread, column - x, row - y, s);
            for (int k = 0; k < CHANNELS; ++k)
                part[k] += w * radiance[k * plane + AT(x, y)];
        }
        for (int k = 0; k < CHANNELS; ++k)
            sum[k] += part[k];
    }
    for (int k = 0; k < CHANNELS; ++k)
        missed[n * CHANNELS + k] -= sum[k];
}

// Adds `sign` times the frame at these pixels to `missed`: before radiance comes from coarser grids, and after.
__kernel void sample_frame(const camera_t camera, __global const float *total, const int pitch, const int pad,
                      const float sign, const int count, __global const int2 *place, __global float *missed)
{
    const int n = get_global_id(0);
    if (n >= count)
        return;
    for (int k = 0; k < CHANNELS; ++k)
        missed[n * CHANNELS + k] += sign * total[(k * camera.rows + place[n].x) * pitch + place[n].y + pad];
}

#pragma OPENCL FP_CONTRACT OFF
