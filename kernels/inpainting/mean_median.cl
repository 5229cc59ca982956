// Images with a mask: mean/median filling of their holes and blending of their border (thesis, chapter 5). The device
// has only the pixels in and around holes. fill_mean_median.cl does the same to warped frames. Twin:
// clsco/reference/inpainting/mean_median.py.
//
// Missing pixels and all their neighbors are numbered row by row, `slots` of them, including a frame of pixels around
// the image. So the eight neighbors of a missing pixel have consecutive numbers in each row.
//   value      float (CHANNELS, slots): infinite beyond the image, and where nothing has been filled yet
//   found      the same: results of a sweep or a round
//   beside     int2 (slots): for missing pixels, the numbers of the pixels above and below
//   near       int (slots): number of valid neighbors of a missing pixel; for other pixels more than 8
//   lists      int (minimum, missing): list k - 1 has the missing pixels that have reached k valid neighbors, one after
//              another; the last list also has those that had more in the beginning
//   state      int2 (minimum + 1): numbers of sweeps and of filled pixels; for each list how much is swept, and its end
//
// A sweep takes the new entries of the last list that has any: list k - 1, k < minimum, is only used while no missing
// pixel has more than k valid neighbors. Entries that have been filled since are skipped.

#include "common/geometry.clh"
#include "inpainting/estimate.clh"

#if ALONE  // one work-item at a time settles: on processors, where atomics take longer than all the rest
#define COUNTED(p) ((*(p))++)
#else
#define COUNTED(p) atomic_inc(p)
#endif

#define UNKNOWN(v) ((v) == (real)INFINITY)
// Sets `near` to the values of all lanes' neighbors in the plane of a channel; row: numbers of the pixels above the
// lanes' own ones, of these, and below.
#define GATHER_NEAR(plane) \
    { \
        float8 in_row[3][3]; \
        for (int k = 0; k < 3; ++k) \
            gather_row(in_row[k], row, k, plane); \
        UNROLL \
        for (int k = 0; k < 8; ++k) \
            near[k] = (real8)EACH(in_row[1 + NEIGHBOR_Y[k]][1 + NEIGHBOR_X[k]]); \
    }

static void rows_of(int row[3], int at, __global const int2 *beside) {
    row[0] = beside[at].x;
    row[1] = at;
    row[2] = beside[at].y;
}

// Chooses mean or median by the numbers of valid neighbors of all lanes.
static estimator_t estimator_of(const real8 *near, int median_wins) {
    int8 count = 0;
    for (int k = 0; k < 8; ++k)
        count -= INTS(near[k] < (real)INFINITY);
    return choose_estimator(count, median_wins);
}

// Finds values for FILL_LANES missing pixels of a list, from `first` on and before `end`; the last pixel fills up the
// vector.
static void fill_vector(const int slots, __global const int *list, int first, int end, int median_wins,
                        __global const int2 *beside, __global const float *value, __global float *found) {
    int row[FILL_LANES][3], open = 0;
    for (int lane = 0; lane < FILL_LANES; ++lane) {
        rows_of(row[lane], list[MIN(first + lane, end - 1)], beside);
        open |= UNKNOWN(value[row[lane][1]]);
    }
    if (!open)
        return;
    estimator_t estimator;
    real8 near[8], result;
    for (int c = 0; c < CHANNELS; ++c) {
        GATHER_NEAR(value + c * slots)
        if (!c)
            estimator = estimator_of(near, median_wins);
        result = estimate(&estimator, near);
        for (int lane = 0; lane < FILL_LANES; ++lane)
            found[c * slots + row[lane][1]] = ((const real *)&result)[lane];
    }
}

// Settles an entry of a sweep: the pixel gets its value, and its missing neighbors are added to their next lists.
static void settle_entry(const int slots, int at, __global const int2 *beside, int missing, int minimum,
                         __global const float *found, __global float *value, __global int *near, __global int *lists,
                         __global int *state) {
    if (!UNKNOWN(value[at]))
        return;
    for (int c = 0; c < CHANNELS; ++c)
        value[c * slots + at] = found[c * slots + at];
    COUNTED(state + 1);
    int row[3];
    rows_of(row, at, beside);
    UNROLL
    for (int k = 0; k < 8; ++k) {
        const int n = row[1 + NEIGHBOR_Y[k]] + NEIGHBOR_X[k], count = COUNTED(near + n) + 1;
        if (count <= minimum)
            lists[(count - 1) * missing + COUNTED(state + 2 * count + 1)] = n;
    }
}

// Stage 1: one sweep over entries begin..end - 1 of `lists`, FILL_LANES per work-item. Bit k of median_wins: with k
// neighbors the median is the better estimator. In: lists, beside, value. Out: found.
__kernel void fill_holes(const int slots, const int begin, const int end, const int median_wins,
                         __global const int *lists, __global const int2 *beside, __global const float *value,
                         __global float *found) {
    const int first = begin + get_global_id(0) * FILL_LANES;
    if (first < end)
        fill_vector(slots, lists, first, end, median_wins, beside, value, found);
}

// Ends such a sweep, with ALONE by a single work-item. In: beside; missing, number of missing pixels; found. In and
// out: value, near, lists, state.
__kernel void settle_holes(const int slots, const int begin, const int end, __global const int2 *beside,
                           const int missing, const int minimum, __global const float *found, __global float *value,
                           __global int *near, __global int *lists, __global int *state) {
    for (int i = begin + get_global_id(0); i < end; i += ALONE ? 1 : end - begin)
        settle_entry(slots, lists[i], beside, missing, minimum, found, value, near, lists, state);
}

// Stage 1 by a single work-group, which for few pixels takes less time than a launch per sweep: sweeps until one would
// have more than `most` entries, or there have been `limit` sweeps. Buffers as above.
__kernel void sweep_holes(const int slots, const int most, const int limit, const int median_wins,
                          __global const int2 *beside, const int missing, const int minimum, __global float *found,
                          __global float *value, __global int *near, __global int *lists, __global int *state) {
    const int item = get_local_id(0), items = get_local_size(0);
    while (true) {
        int k = minimum;
        while (k && state[2 * k] == state[2 * k + 1])
            --k;
        const int begin = state[2 * k], end = state[2 * k + 1], before = state[1];
        barrier(CLK_GLOBAL_MEM_FENCE);
        if (!k || end - begin > most || state[0] >= limit)
            return;
        __global const int *list = lists + (k - 1) * missing;
        for (int first = begin + item * FILL_LANES; first < end; first += items * FILL_LANES)
            fill_vector(slots, list, first, end, median_wins, beside, value, found);
        barrier(CLK_GLOBAL_MEM_FENCE);
        for (int i = begin + item; i < end; i += items)
            settle_entry(slots, list[i], beside, missing, minimum, found, value, near, lists, state);
        barrier(CLK_GLOBAL_MEM_FENCE);
        if (!item) {
            state[2 * k] = end;
            state[0] += state[1] > before;
        }
        barrier(CLK_GLOBAL_MEM_FENCE);
    }
}

// The median of the neighbors that are not infinite; sorts them.
static real8 median_of(real8 *near) {
    SORT(real8, near)
    if (any(UNKNOWN(near[7]))) {  // at the border of the image
        const estimator_t estimator = estimator_of(near, ~0);
        return estimate(&estimator, near);
    }
    return (real)0.5 * (near[3] + near[4]);
}

// Smooths number `id` of the runs of missing pixels, or of the vectors of single ones: see smooth_holes.
static void smooth_vector(const int slots, int id, __global const int2 *run, int runs, __global const int *single,
                          int singles, __global const int2 *beside, __global const float *value,
                          __global float *found) {
    real8 near[8];
    if (id < runs) {
        const int count = run[id].y;
        int row[3];
        rows_of(row, run[id].x, beside);
        for (int c = 0; c < CHANNELS; ++c) {
            UNROLL
            for (int k = 0; k < 8; ++k) {
                const float8 one = LOAD(float, 8, value + c * slots + row[1 + NEIGHBOR_Y[k]] + NEIGHBOR_X[k]);
                near[k] = (real8)EACH(one);
            }
            const real8 result = median_of(near);
            __global float *out = found + c * slots + row[1];
            if (count == FILL_LANES)
                STORE(float, 8, (float8)EACH(result), out);
            else
                for (int lane = 0; lane < count; ++lane)
                    out[lane] = ((const real *)&result)[lane];
        }
        return;
    }
    const int first = (id - runs) * FILL_LANES;
    if (first >= singles)
        return;
    int row[FILL_LANES][3];
    for (int lane = 0; lane < FILL_LANES; ++lane)
        rows_of(row[lane], single[MIN(first + lane, singles - 1)], beside);
    for (int c = 0; c < CHANNELS; ++c) {
        GATHER_NEAR(value + c * slots)
        const real8 result = median_of(near);
        for (int lane = 0; lane < FILL_LANES; ++lane)
            found[c * slots + row[lane][1]] = ((const real *)&result)[lane];
    }
}

// Stage 2: rounds of the 3x3 median without the center over missing pixels, all of which are filled; several rounds
// only by a single work-item. Work-items before `runs` take one entry of `run` each: number of its first pixel, and of
// its consecutive pixels, up to FILL_LANES; the others take FILL_LANES of the `singles` pixels in `single`. In: beside.
// In and out: value, found, written in turn; the first round writes `found`.
__kernel void smooth_holes(const int slots, const int rounds, __global const int2 *run, const int runs,
                           __global const int *single, const int singles, __global const int2 *beside,
                           __global float *value, __global float *found) {
    const int items = runs + (singles + FILL_LANES - 1) / FILL_LANES;
    for (int n = 0; n < rounds; ++n)
        for (int id = get_global_id(0); id < items; id += rounds > 1 ? 1 : items)
            smooth_vector(slots, id, run, runs, single, singles, beside, n % 2 ? found : value, n % 2 ? value : found);
}

// Sorts the median of nine into its place, with the fewest exchanges.
#define MIDDLE(T, s) \
    ORDER(T, s[1], s[2]) ORDER(T, s[4], s[5]) ORDER(T, s[7], s[8]) ORDER(T, s[0], s[1]) ORDER(T, s[3], s[4]) \
    ORDER(T, s[6], s[7]) ORDER(T, s[1], s[2]) ORDER(T, s[4], s[5]) ORDER(T, s[7], s[8]) ORDER(T, s[0], s[3]) \
    ORDER(T, s[5], s[8]) ORDER(T, s[4], s[7]) ORDER(T, s[3], s[6]) ORDER(T, s[1], s[4]) ORDER(T, s[2], s[5]) \
    ORDER(T, s[4], s[7]) ORDER(T, s[4], s[2]) ORDER(T, s[6], s[4]) ORDER(T, s[4], s[2])

// Stage 3, for the known pixels around holes: Sobel's gradient and the 3x3 median, FILL_LANES pixels per work-item;
// edge pixels of the image are repeated beyond it. In: list of `count` pixels of value (height, width, CHANNELS), all
// of which are known or filled. Out: steepness (count), the largest square of a gradient's magnitude among the
// channels; blended (count, CHANNELS), the medians.
__kernel void blend_border(const grid_t grid, __global const int *list, const int count,
                           __global const float *value, __global float *steepness, __global float *blended) {
    const int first = get_global_id(0) * FILL_LANES;
    if (first >= count)
        return;
    int from[9][FILL_LANES];
    for (int lane = 0; lane < FILL_LANES; ++lane) {
        const int at = list[MIN(first + lane, count - 1)], x = at % grid.width, y = at / grid.width;
        UNROLL
        for (int k = 0; k < 9; ++k) {
            const int i = MIN(MAX(y + k / 3 - 1, 0), grid.height - 1);
            const int j = MIN(MAX(x + k % 3 - 1, 0), grid.width - 1);
            from[k][lane] = (i * grid.width + j) * CHANNELS;
        }
    }
    float8 steepest = 0;
    for (int c = 0; c < CHANNELS; ++c) {
        float8 p[9];
        for (int k = 0; k < 9; ++k)
            for (int lane = 0; lane < FILL_LANES; ++lane)
                ((float *)(p + k))[lane] = value[from[k][lane] + c];
        const float8 across = (p[2] + 2 * p[5] + p[8]) - (p[0] + 2 * p[3] + p[6]);
        const float8 down = (p[6] + 2 * p[7] + p[8]) - (p[0] + 2 * p[1] + p[2]);
        const float8 square = across * across + down * down;
        steepest = MAX(steepest, square);
        MIDDLE(float8, p)
        for (int lane = 0; lane < FILL_LANES && first + lane < count; ++lane)
            blended[(first + lane) * CHANNELS + c] = ((const float *)(p + 4))[lane];
    }
    for (int lane = 0; lane < FILL_LANES && first + lane < count; ++lane)
        steepness[first + lane] = ((const float *)&steepest)[lane];
}
