// Missing pixels: mean/median filling (thesis, chapter 5). Built after fill.cl, which has the planes, the lists and what
// the features mean. Twin: clsco/reference/mean_median.py.

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
#define WIDE(v) ((real8)((v).s0, (v).s1, (v).s2, (v).s3, (v).s4, (v).s5, (v).s6, (v).s7))

// Stage 0: sums over all pixels of a row with eight valid neighbors, and all channels, from which the host has the
// squared errors of mean and median of all 163 subsets of k = 4..8 neighbors. With d the sorted differences of the
// neighbors to the center and C binomial coefficients, the subsets of k have
//   of means    (C(6, k-2) (sum d)^2 + C(6, k-1) sum d^2) / k^2,
//   of medians  for odd k = 2 m + 1  C(i, m) C(7-i, m) times d_i^2, for all i,
//               for even k = 2 m + 2  C(i, m) C(7-j, m) times ((d_i + d_j) / 2)^2, for all i < j.
// One work-item per row, LANES pixels at once; the host adds the rows in their order. value and valid must be readable
// LANES elements beyond their end. Out: sums real (height, 7): (sum d)^2, sum d^2, medians of k = 4..8, those of even k
// not yet divided by 4.
__kernel void score_mean_median(const camera_t camera, __global const float *value, __global const uchar *valid,
                                __global real *sums)
{
    const int y = get_global_id(0), pitch = camera.width;
    if (y >= camera.height)
        return;
    const uchar8 lane = (uchar8)(0, 1, 2, 3, 4, 5, 6, 7);
    real8 sum[7] = {0, 0, 0, 0, 0, 0, 0};
    for (int x = 1; x < pitch - 1 && y > 0 && y < camera.height - 1; x += LANES) {
        const int at = y * pitch + x;
        uchar8 whole = UCHARS(valid + at);
        for (int k = 0; k < 8; ++k)
            whole &= UCHARS(valid + at + NEIGHBOR_Y[k] * pitch + NEIGHBOR_X[k]);
        whole &= as_uchar8(lane < (uchar8)(uchar)MIN(LANES, pitch - 1 - x));
        const real8 use = WIDE(whole);
        for (int c = 0; c < CHANNELS; ++c) {
            __global const float *center = value + c * camera.height * pitch + at;
            float8 near[8];
            for (int k = 0; k < 8; ++k)
                near[k] = FLOATS(center + NEIGHBOR_Y[k] * pitch + NEIGHBOR_X[k]);
            SORT(float8, near)
            const real8 middle = WIDE(FLOATS(center));
            real8 d[8], total = 0;
            for (int k = 0; k < 8; ++k) {
                d[k] = (WIDE(near[k]) - middle) * use;
                total += d[k];
                sum[1] += d[k] * d[k];
            }
            sum[0] += total * total;
            for (int i = 1; i < 7; ++i) {
                const real8 odd = d[i] * d[i];
                sum[3] += (real)(i * (i - 1) * (7 - i) * (6 - i) / 4) * odd;
                sum[5] += (real)(i * (i - 1) * (i - 2) * (7 - i) * (6 - i) * (5 - i) / 36) * odd;
                for (int j = i + 1; j < 7; ++j) {
                    const real8 even = (d[i] + d[j]) * (d[i] + d[j]);
                    sum[2] += (real)(i * (7 - j)) * even;
                    sum[4] += (real)(i * (i - 1) * (7 - j) * (6 - j) / 4) * even;
                }
            }
            sum[6] += (d[3] + d[4]) * (d[3] + d[4]);
        }
    }
    for (int k = 0; k < 7; ++k) {
        const real8 v = sum[k];
        sums[7 * y + k] = ((v.s0 + v.s1) + (v.s2 + v.s3)) + ((v.s4 + v.s5) + (v.s6 + v.s7));
    }
}

// LANES pixels of a list, with the neighbors that serve them: bit k of `bits` is neighbor k.
typedef struct {
    int at[LANES], bits[LANES];
    real8 count, lower, upper, by_median;  // neighbors; places of the middle two; whether their mean is wanted
} around_t;

static around_t look_around(const camera_t camera, __global const uchar *valid, __global const int *list, int entries,
                            int median_wins
#if FILL_FAR
                            , __global const wide_t *w, __global const float *far, int minimum
#endif
)
{
    around_t around;
    for (int lane = 0; lane < LANES; ++lane) {
        // The last pixel fills up the last vector.
        const int at = list[MIN((int)get_global_id(0) * LANES + lane, entries - 1)];
        const int x = at % camera.width, y = at / camera.width;
        const bool inner = x > 0 && y > 0 && x < camera.width - 1 && y < camera.height - 1;
        int bits = 0, count = 0;
#if FILL_FAR
        const float bound = minimum ? far[at] : INFINITY;
#endif
        UNROLL
        for (int k = 0; k < 8; ++k) {
            const int i = y + NEIGHBOR_Y[k], j = x + NEIGHBOR_X[k];
            const bool inside = inner || (i >= 0 && i < camera.height && j >= 0 && j < camera.width);
            const int known = inside ? serves(valid, w, i * camera.width + j, bound) : 0;
            bits |= known << k;
            count += known;
        }
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
            const int from = around.at[lane] + NEIGHBOR_Y[k] * camera.width + NEIGHBOR_X[k]; \
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
                            __global const wide_t *w_in, __global float *value_out, __global wide_t *w_out,
                            __global wide_t *coc)
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
    NEAR(near, narrow(w_in[from]))
    estimate(&around, near, &result);
    for (int lane = 0; lane < LANES; ++lane)
        if (count[lane] >= minimum) {
            w_out[around.at[lane]] = widened(found[lane]);
            coc[around.at[lane]] = blur_radius(camera, widened(found[lane]));
        }
}

#if FILL_FAR
#define BOUNDED_BY(w, far, minimum) , w, far, minimum
#else
#define BOUNDED_BY(w, far, minimum)
#endif

// Stage 1: one sweep, LANES entries per work-item. Bit k of median_wins: of k neighbors the median is the better
// estimator; a pixel needs `minimum` of them, with FILL_FAR and 0 any single one. The object is that of the first one.
// In: list of `count`, valid, far. In and out: value, w, coc, status, object.
__kernel void fill_mean_median(const camera_t camera, __global const int *list, const int count, const int median_wins,
                               const int minimum,
#if FILL_FAR
                               __global const float *far,
#endif
                               __global const uchar *valid, __global float *value, __global wide_t *w,
                               __global wide_t *coc, __global uchar *status
#if SEVERAL
                               , __global uchar *object
#endif
)
{
    if (get_global_id(0) * LANES >= count)
        return;
    const around_t around = look_around(camera, valid, list, count, median_wins BOUNDED_BY(w, far, minimum));
    const int least = MAX(minimum, 1);
    write_estimates(camera, around, least, value, w, value, w, coc);
    for (int lane = 0; lane < LANES; ++lane) {
        if (((const real *)&around.count)[lane] < least)
            continue;
        status[around.at[lane]] = 1;
#if SEVERAL
        int k = 0;
        while (!(around.bits[lane] >> k & 1))
            ++k;
        object[around.at[lane]] = object[around.at[lane] + NEIGHBOR_Y[k] * camera.width + NEIGHBOR_X[k]];
#endif
    }
}

// Stage 2: one round of the 3x3 median without the center over the filled pixels, LANES entries per work-item; a pixel
// that no neighbor serves stays. In: done, list of `count`; valid, far; value_in, w_in, which hold all pixels. Out: the
// same of the filled pixels, coc.
__kernel void smooth_median(const camera_t camera, __global const int *done, const int count,
#if FILL_FAR
                            __global const float *far,
#endif
                            __global const uchar *valid, __global const float *value_in, __global const wide_t *w_in,
                            __global float *value_out, __global wide_t *w_out, __global wide_t *coc)
{
    if (get_global_id(0) * LANES >= count)
        return;
    const around_t around = look_around(camera, valid, done, count, ~0 BOUNDED_BY(w_in, far, 1));
    write_estimates(camera, around, 1, value_in, w_in, value_out, w_out, coc);
#if FILL_FAR
    for (int lane = 0; lane < LANES; ++lane) {
        const int at = around.at[lane];
        for (int c = 0; c < CHANNELS && !around.bits[lane]; ++c)
            value_out[c * camera.height * camera.width + at] = value_in[c * camera.height * camera.width + at];
        if (!around.bits[lane])
            w_out[at] = w_in[at];
    }
#endif
}
#endif
