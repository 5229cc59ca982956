// Missing pixels: mean/median filling (thesis, chapter 5). Built after fill.cl, which has the planes, the lists and what
// the features mean. Twin: clsco/reference/mean_median.py.
//
// With HOLES, for images with a mask, pixels are those in and around holes only, numbered one after another in a single
// row: first the missing ones, then known ones beside them, and last one that stands for all beyond the border of the
// image and is never valid. There is no depth then, no FILL_FAR, and
//   around   int8 per missing pixel: the numbers of its neighbors

#if FILL_MEAN_MEDIAN
#define LANES 8
#define UNROLL _Pragma("unroll")
#define ORDER(T, a, b) { const T low = MIN(a, b); b = MAX(a, b); a = low; }
// Sorts eight of anything that compares, with the fewest exchanges.
#define SORT(T, s) \
    ORDER(T, s[0], s[2]) ORDER(T, s[1], s[3]) ORDER(T, s[4], s[6]) ORDER(T, s[5], s[7]) \
    ORDER(T, s[0], s[4]) ORDER(T, s[1], s[5]) ORDER(T, s[2], s[6]) ORDER(T, s[3], s[7]) \
    ORDER(T, s[0], s[1]) ORDER(T, s[2], s[3]) ORDER(T, s[4], s[5]) ORDER(T, s[6], s[7]) \
    ORDER(T, s[2], s[4]) ORDER(T, s[3], s[5]) ORDER(T, s[1], s[4]) ORDER(T, s[3], s[6]) \
    ORDER(T, s[1], s[2]) ORDER(T, s[3], s[4]) ORDER(T, s[5], s[6])

// vload8 is a call on PoCL; through these types it is one unaligned move.
typedef float floats_t __attribute__((ext_vector_type(8), aligned(4)));
typedef uchar uchars_t __attribute__((ext_vector_type(8), aligned(1)));
#define FLOATS(p) (*(__global const floats_t *)(p))
#define UCHARS(p) (*(__global const uchars_t *)(p))
#define EACH(v) ((v).s0, (v).s1, (v).s2, (v).s3, (v).s4, (v).s5, (v).s6, (v).s7)

// Whole numbers, exact up to 53 bits at least. Half a unit and more in the last place rounds to the nearest, as rint does.
#if HAS_FP64
typedef double8 exact8;
#define ROUNDER 6755399441055744.0
#define WHOLE(v) ((exact8)EACH(v) + ROUNDER - ROUNDER)
#else
typedef long8 exact8;
#define WHOLE(v) convert_long8_rte(v)
#endif

#define SEGMENT 256  // columns of a row that a work-item scores: no more may be summed up in 53 bits
#define SUMS 13

// Stage 0: sums over all pixels of a row with eight valid neighbors, and all channels, from which the host has the
// squared errors of mean and median of all 163 subsets of k = 4..8 neighbors. With d the sorted differences of the
// neighbors to the center and C binomial coefficients, the subsets of k have
//   of means    (C(6, k-2) (sum d)^2 + C(6, k-1) sum d^2) / k^2,
//   of medians  for odd k = 2 m + 1  C(i, m) C(7-i, m) times d_i^2, for all i,
//               for even k = 2 m + 2  C(i, m) C(7-j, m) times ((d_i + d_j) / 2)^2, for all i < j.
// Values times `scale` are rounded to whole numbers before, which differ by 2^16 at most, so that sums are exact in any
// order. One work-item per SEGMENT columns, LANES pixels at once; value and valid must be readable LANES elements beyond
// their end. Out: sums (height, segments, SUMS): d_i^2 for i = 0..7; (sum d)^2; C(i, m) C(7-j, m) d_i d_j over i < j for
// m = 1, 2, 3; number of pixels times channels.
__kernel void score_mean_median(const camera_t camera, const float scale, __global const float *value,
                                __global const uchar *valid, __global long *sums)
{
    const int pitch = camera.width, segments = (pitch + SEGMENT - 1) / SEGMENT;
    const int segment = get_global_id(0) % segments, y = get_global_id(0) / segments;
    if (y >= camera.height)
        return;
    const int begin = MAX(segment * SEGMENT, 1), end = MIN((segment + 1) * SEGMENT, pitch - 1);
    const uchar8 lane = (uchar8)(0, 1, 2, 3, 4, 5, 6, 7);
    exact8 sum[SUMS];
    for (int k = 0; k < SUMS; ++k)
        sum[k] = 0;
    for (int x = begin; x < end && y > 0 && y < camera.height - 1; x += LANES) {
        const int at = y * pitch + x;
        uchar8 whole = UCHARS(valid + at);
        for (int k = 0; k < 8; ++k)
            whole &= UCHARS(valid + at + NEIGHBOR_Y[k] * pitch + NEIGHBOR_X[k]);
        whole &= as_uchar8(lane < (uchar8)(uchar)MIN(LANES, end - x));
        const exact8 use = (exact8)EACH(whole);
        for (int c = 0; c < CHANNELS; ++c) {
            __global const float *center = value + c * camera.height * pitch + at;
            float8 near[8];
            UNROLL
            for (int k = 0; k < 8; ++k)
                near[k] = FLOATS(center + NEIGHBOR_Y[k] * pitch + NEIGHBOR_X[k]);
            SORT(float8, near)
            const exact8 middle = WHOLE(FLOATS(center) * scale);
            exact8 d[8], total = 0, above = 0;
            UNROLL
            for (int k = 0; k < 8; ++k) {
                d[k] = (WHOLE(near[k] * scale) - middle) * use;
                total += d[k];
                sum[k] += d[k] * d[k];
            }
            sum[8] += total * total;
            UNROLL
            for (int i = 5; i > 0; --i) {
                above += (6 - i) * d[i + 1];
                sum[9] += i * d[i] * above;
            }
            above = 0;
            UNROLL
            for (int i = 4; i > 1; --i) {
                above += (6 - i) * (5 - i) / 2 * d[i + 1];
                sum[10] += i * (i - 1) / 2 * d[i] * above;
            }
            sum[11] += d[3] * d[4];
            sum[12] += use;
        }
    }
    for (int k = 0; k < SUMS; ++k) {
        const exact8 v = sum[k];
        sums[SUMS * get_global_id(0) + k] = (long)(((v.s0 + v.s1) + (v.s2 + v.s3)) + ((v.s4 + v.s5) + (v.s6 + v.s7)));
    }
}

// LANES pixels of a list from the `first` on, with the neighbors that serve them: bit k of `bits` is neighbor k.
typedef struct {
    int from[LANES][8], at[LANES], bits[LANES];
    real8 count, lower, upper, by_median;  // neighbors; places of the middle two; whether their mean is wanted
} around_t;

static around_t look_around(const camera_t camera, __global const uchar *valid, __global const int *list, int first,
                            int entries, int median_wins
#if HOLES
                            , __global const int8 *neighbors
#endif
#if FILL_FAR && !HOLES
                            , __global const wide_t *w, __global const float *far, int minimum
#endif
)
{
    around_t around;
    for (int lane = 0; lane < LANES; ++lane) {
        // The last pixel fills up the last vector.
        const int at = list[MIN(first + lane, entries - 1)];
        int bits = 0, count = 0;
#if HOLES
        *(int8 *)around.from[lane] = neighbors[at];
        UNROLL
        for (int k = 0; k < 8; ++k) {
            const int known = valid[around.from[lane][k]];
            bits |= known << k;
            count += known;
        }
#else
        const int x = at % camera.width, y = at / camera.width;
        const bool inner = x > 0 && y > 0 && x < camera.width - 1 && y < camera.height - 1;
#if FILL_FAR
        const float bound = minimum ? far[at] : INFINITY;
#endif
        UNROLL
        for (int k = 0; k < 8; ++k) {
            const int i = y + NEIGHBOR_Y[k], j = x + NEIGHBOR_X[k], from = i * camera.width + j;
            const bool inside = inner || (i >= 0 && i < camera.height && j >= 0 && j < camera.width);
            const int known = inside ? serves(valid, w, from, bound) : 0;
            bits |= known << k;
            count += known;
            around.from[lane][k] = from;
        }
#endif
        around.at[lane] = at;
        around.bits[lane] = bits;
        ((real *)&around.count)[lane] = count;
        ((real *)&around.lower)[lane] = (count - 1) / 2;
        ((real *)&around.upper)[lane] = count / 2;
        ((real *)&around.by_median)[lane] = median_wins >> count & 1;
    }
    return around;
}

// Values of the neighbors of all lanes; infinity for those that are not valid.
#define NEAR(values, value_at_from) \
    for (int lane = 0; lane < LANES; ++lane) { \
        const int bits = around.bits[lane]; \
        UNROLL \
        for (int k = 0; k < 8; ++k) { \
            const int from = around.from[lane][k]; \
            ((real *)(values + k))[lane] = bits == 255 || bits >> k & 1 ? (value_at_from) : (real)INFINITY; \
        } \
    }

// Mean or median of the values that are not infinite; sorts them. Out: result, one per lane.
static void estimate(const around_t *around, real8 *near, real8 *result)
{
    real8 sum = 0, lower = 0, upper = 0;
    for (int k = 0; k < 8; ++k)
        sum += near[k] < (real)INFINITY ? near[k] : 0;
    SORT(real8, near)
    for (int k = 0; k < 8; ++k) {
        lower = around->lower == k ? near[k] : lower;
        upper = around->upper == k ? near[k] : upper;
    }
    *result = around->by_median > 0 ? (real)0.5 * (lower + upper) : sum / around->count;
}

// Writes the estimates of all planes; of lanes with fewer than `minimum` neighbors nothing.
static void write_estimates(const camera_t camera, const around_t around, int minimum, __global const float *value_in,
                            __global float *value_out
#if !HOLES
                            , __global const wide_t *w_in, __global wide_t *w_out, __global wide_t *coc
#endif
)
{
    real8 near[8], result;
    const real *count = (const real *)&around.count, *found = (const real *)&result;
    for (int c = 0; c < CHANNELS; ++c) {
        const int plane = c * camera.height * camera.width;
        NEAR(near, value_in[plane + from])
        estimate(&around, near, &result);
        for (int lane = 0; lane < LANES; ++lane)
            if (count[lane] >= minimum)
                value_out[plane + around.at[lane]] = (float)found[lane];
    }
#if !HOLES
    NEAR(near, narrow(w_in[from]))
    estimate(&around, near, &result);
    for (int lane = 0; lane < LANES; ++lane)
        if (count[lane] >= minimum) {
            w_out[around.at[lane]] = widened(found[lane]);
            coc[around.at[lane]] = blur_radius(camera, widened(found[lane]));
        }
#endif
}

// Further arguments, where there are such planes.
#if FILL_FAR && !HOLES
#define SERVED_BY(w, minimum) , w, far, minimum
#elif HOLES
#define SERVED_BY(w, minimum) , neighbors
#else
#define SERVED_BY(w, minimum)
#endif
#if HOLES
#define DEPTHS(...)
#else
#define DEPTHS(...) , __VA_ARGS__
#endif

// Stage 1: one sweep, LANES entries per work-item. Bit k of median_wins: of k neighbors the median is the better
// estimator; a pixel needs `minimum` of them, with FILL_FAR and 0 any single one. The object is that of the first one.
// In: list of `count`, neighbors, far, valid. In and out: value, w, coc, status, object.
__kernel void fill_mean_median(const camera_t camera, __global const int *list, const int count, const int median_wins,
                               const int minimum,
#if HOLES
                               __global const int8 *neighbors,
#endif
#if FILL_FAR && !HOLES
                               __global const float *far,
#endif
                               __global const uchar *valid, __global float *value
                               DEPTHS(__global wide_t *w, __global wide_t *coc), __global uchar *status
#if SEVERAL
                               , __global uchar *object
#endif
)
{
    if (get_global_id(0) * LANES >= count)
        return;
    const around_t around =
        look_around(camera, valid, list, get_global_id(0) * LANES, count, median_wins SERVED_BY(w, minimum));
    const int least = MAX(minimum, 1);
    write_estimates(camera, around, least, value, value DEPTHS(w, w, coc));
    for (int lane = 0; lane < LANES; ++lane) {
        if (((const real *)&around.count)[lane] < least)
            continue;
        status[around.at[lane]] = 1;
#if SEVERAL
        int k = 0;
        while (!(around.bits[lane] >> k & 1))
            ++k;
        object[around.at[lane]] = object[around.from[lane][k]];
#endif
    }
}

// Stage 2: one round of the 3x3 median without the center over the filled pixels, LANES entries per work-item; a pixel
// that no neighbor serves stays. In: done, list of `count`; neighbors, far, valid; value_in, w_in, which hold all pixels.
// Out: the same of the filled pixels, coc.
__kernel void smooth_median(const camera_t camera, __global const int *done, const int count,
#if HOLES
                            __global const int8 *neighbors,
#endif
#if FILL_FAR && !HOLES
                            __global const float *far,
#endif
                            __global const uchar *valid, __global const float *value_in
                            DEPTHS(__global const wide_t *w_in), __global float *value_out
                            DEPTHS(__global wide_t *w_out, __global wide_t *coc))
{
    if (get_global_id(0) * LANES >= count)
        return;
    const around_t around =
        look_around(camera, valid, done, get_global_id(0) * LANES, count, ~0 SERVED_BY(w_in, 1));
    write_estimates(camera, around, 1, value_in, value_out DEPTHS(w_in, w_out, coc));
#if FILL_FAR && !HOLES
    for (int lane = 0; lane < LANES; ++lane) {
        const int at = around.at[lane];
        for (int c = 0; c < CHANNELS && !around.bits[lane]; ++c)
            value_out[c * camera.height * camera.width + at] = value_in[c * camera.height * camera.width + at];
        if (!around.bits[lane])
            w_out[at] = w_in[at];
    }
#endif
}

#if HOLES
// What becomes of an entry of the list after a sweep: if that has filled it, it becomes valid, and missing pixels beside
// it come into the list of those `left`, which always holds all that have a valid neighbor.
static void settle_entry(int at, __global const int8 *neighbors, int missing, __global const uchar *status,
                         __global uchar *valid, __global int *listed, __global int *left, __global int *counters)
{
    if (status[at] != 1) {
        left[atomic_inc(counters + LEFT)] = at;
        return;
    }
    const int8 near = neighbors[at];
    valid[at] = 1;
    atomic_inc(counters + FILLED);
    for (int k = 0; k < 8; ++k) {
        const int n = ((const int *)&near)[k];
        if (n < missing && !listed[n] && !atomic_xchg(listed + n, 1))
            left[atomic_inc(counters + LEFT)] = n;
    }
}

// Ends a sweep, one entry per work-item. In: list of `count`, neighbors, status; missing, their number. In and out:
// valid; listed, int per missing pixel, 1 once it was in a list. Out: left (as list), LEFT and FILLED.
__kernel void settle_holes(__global const int *list, const int count, __global const int8 *neighbors, const int missing,
                           __global const uchar *status, __global uchar *valid, __global int *listed,
                           __global int *left, __global int *counters)
{
    const int id = get_global_id(0);
    if (id < count)
        settle_entry(list[id], neighbors, missing, status, valid, listed, left, counters);
}

// Stage 1 sweep by sweep by a single work-group, which takes less than launches while lists are short: until nothing is
// left, or more than `most`. Sweeps that fill nothing relax the minimum by one, all others take it back to `minimum`.
// list, other: room for all missing pixels each; the first one holds `count`, at the end LEFT, and there `other` if
// SWAPPED. Out: SWEEPS that have filled something, and by how many they FILLED. Others as above.
#define SWEEPS 1
#define SWAPPED 3
__kernel void sweep_holes(const camera_t camera, __global int *list, __global int *other, const int count,
                          const int most, const int median_wins, const int minimum, __global const int8 *neighbors,
                          const int missing, __global uchar *valid, __global float *value, __global uchar *status,
                          __global int *listed, __global int *counters)
{
    const int item = get_local_id(0), items = get_local_size(0);
    int entries = count, least = minimum, sweeps = 0, filled = 0, swapped = 0;
    while (entries && entries <= most) {
        __global int *from = swapped ? other : list, *to = swapped ? list : other;
        if (!item)
            counters[LEFT] = counters[FILLED] = 0;
        for (int first = item * LANES; first < entries; first += items * LANES) {
            const around_t around = look_around(camera, valid, from, first, entries, median_wins, neighbors);
            write_estimates(camera, around, least, value, value);
            for (int lane = 0; lane < LANES; ++lane)
                if (((const real *)&around.count)[lane] >= least)
                    status[around.at[lane]] = 1;
        }
        barrier(CLK_GLOBAL_MEM_FENCE);
        for (int i = item; i < entries; i += items)
            settle_entry(from[i], neighbors, missing, status, valid, listed, to, counters);
        barrier(CLK_GLOBAL_MEM_FENCE);
        const int new = counters[FILLED];
        entries = counters[LEFT];
        least = new ? minimum : least - 1;
        sweeps += new > 0;
        filled += new;
        swapped = !swapped;
        barrier(CLK_GLOBAL_MEM_FENCE);
    }
    if (!item) {
        counters[LEFT] = entries;
        counters[SWEEPS] = sweeps;
        counters[FILLED] = filled;
        counters[SWAPPED] = swapped;
    }
}

// Sorts the middle one of nine into its place, with the fewest exchanges.
#define MIDDLE(T, s) \
    ORDER(T, s[1], s[2]) ORDER(T, s[4], s[5]) ORDER(T, s[7], s[8]) ORDER(T, s[0], s[1]) ORDER(T, s[3], s[4]) \
    ORDER(T, s[6], s[7]) ORDER(T, s[1], s[2]) ORDER(T, s[4], s[5]) ORDER(T, s[7], s[8]) ORDER(T, s[0], s[3]) \
    ORDER(T, s[5], s[8]) ORDER(T, s[4], s[7]) ORDER(T, s[3], s[6]) ORDER(T, s[1], s[4]) ORDER(T, s[2], s[5]) \
    ORDER(T, s[4], s[7]) ORDER(T, s[4], s[2]) ORDER(T, s[6], s[4]) ORDER(T, s[4], s[2])

// Stage 3, of the known pixels around holes: Sobel's gradient and the 3x3 median, LANES pixels per work-item; beyond the
// image its edge goes on. In: list of `count` pixels of value (CHANNELS, height, width), all of which are known or filled.
// Out: steepness (count), the largest square of a gradient's magnitude among the channels; blended (CHANNELS, count), the
// medians.
__kernel void blend_border(const camera_t camera, __global const int *list, const int count,
                           __global const float *value, __global float *steepness, __global float *blended)
{
    const int first = get_global_id(0) * LANES;
    if (first >= count)
        return;
    int from[9][LANES];
    for (int lane = 0; lane < LANES; ++lane) {
        const int at = list[MIN(first + lane, count - 1)], x = at % camera.width, y = at / camera.width;
        UNROLL
        for (int k = 0; k < 9; ++k) {
            const int i = MIN(MAX(y + k / 3 - 1, 0), camera.height - 1), j = MIN(MAX(x + k % 3 - 1, 0), camera.width - 1);
            from[k][lane] = i * camera.width + j;
        }
    }
    float8 steepest = 0;
    for (int c = 0; c < CHANNELS; ++c) {
        __global const float *plane = value + c * camera.height * camera.width;
        float8 p[9];
        for (int k = 0; k < 9; ++k)
            for (int lane = 0; lane < LANES; ++lane)
                ((float *)(p + k))[lane] = plane[from[k][lane]];
        const float8 across = (p[2] + 2 * p[5] + p[8]) - (p[0] + 2 * p[3] + p[6]);
        const float8 down = (p[6] + 2 * p[7] + p[8]) - (p[0] + 2 * p[1] + p[2]);
        const float8 square = across * across + down * down;
        steepest = MAX(steepest, square);
        MIDDLE(float8, p)
        for (int lane = 0; lane < LANES && first + lane < count; ++lane)
            blended[c * count + first + lane] = ((const float *)(p + 4))[lane];
    }
    for (int lane = 0; lane < LANES && first + lane < count; ++lane)
        steepness[first + lane] = ((const float *)&steepest)[lane];
}
#endif
#endif
