// Missing pixels: how well mean and median of neighbors estimate known pixels (thesis, chapter 5). Twin:
// clsco/reference/score.py.

#if FILL_MEAN_MEDIAN
// Whole numbers, exact up to 53 bits at least. Half a unit and more in the last place rounds to the nearest, as rint
// does.
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
// Values times `scale` are rounded to whole numbers before, which differ by 2^16 at most, so that sums are exact in
// any order. One work-item per SEGMENT columns, LANES pixels at once; value and valid must be readable LANES elements
// beyond their end. Out: sums (height, segments, SUMS): d_i^2 for i = 0..7; (sum d)^2; C(i, m) C(7-j, m) d_i d_j over
// i < j for m = 1, 2, 3; number of pixels times channels.
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
#endif
