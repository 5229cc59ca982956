// Holes of images with a mask: mean/median filling and blending of their border (thesis, chapter 5). The device holds
// what is in and around holes only. Twin: clsco/reference/holes.py.
//
// Pixels are numbered one after another: first the missing ones, then known ones beside them, and last one that stands
// for all beyond the border of the image and is never valid.
//   value      float (CHANNELS, slots): of all these pixels
//   valid      uchar (slots): 1 known or filled, else 0
//   neighbors  int8 per missing pixel: their numbers
//   near       int per missing pixel: how many of them are valid
//   lists      int (minimum, missing): list k - 1 has the missing pixels that have come to k valid neighbors, one after
//              another; the last one those that had more in the beginning, too
//   state      int2 (minimum + 1): sweeps and filled pixels; and of each list what has been swept, and where it ends
//
// A sweep takes the new entries of the last list that has any: those of the list for k < minimum are there when no
// missing pixel has more than k valid neighbors. Some may have been filled since, and stay.

// Tells which neighbors of a missing pixel serve it.
static void look_around(around_t *around, int lane, int at, int median_wins, __global const int8 *neighbors,
                        __global const uchar *valid)
{
    int bits = 0, count = 0;
    *(int8 *)around->from[lane] = neighbors[at];
    UNROLL
    for (int k = 0; k < 8; ++k) {
        const int known = valid[around->from[lane][k]];
        bits |= known << k;
        count += known;
    }
    around->at[lane] = at;
    use_neighbors(around, lane, bits, count, median_wins);
}

// Fills LANES missing pixels of a list from the `first` on, before `end`; the last pixel fills up the last vector.
static void fill_vector(const int slots, __global const int *list, int first, int end, int median_wins,
                        __global const int8 *neighbors, __global const uchar *valid, __global float *value)
{
    around_t around;
    real8 near[8], result;
    int open = 0;
    for (int lane = 0; lane < LANES; ++lane)
        open |= !valid[list[MIN(first + lane, end - 1)]];
    if (!open)
        return;
    for (int lane = 0; lane < LANES; ++lane)
        look_around(&around, lane, list[MIN(first + lane, end - 1)], median_wins, neighbors, valid);
    for (int c = 0; c < CHANNELS; ++c) {
        NEAR(near, value[c * slots + from])
        estimate(&around, near, &result);
        for (int lane = 0; lane < LANES; ++lane)
            if (!valid[around.at[lane]])
                value[c * slots + around.at[lane]] = ((const real *)&result)[lane];
    }
}

// What becomes of an entry that a sweep has taken: it is valid, and those beside it come into the next list.
static void settle_entry(int at, __global const int8 *neighbors, int missing, int minimum, __global uchar *valid,
                         __global int *near, __global int *lists, __global int *state)
{
    if (valid[at])
        return;
    const int8 beside = neighbors[at];
    valid[at] = 1;
    atomic_inc(state + 1);
    for (int k = 0; k < 8; ++k) {
        const int n = ((const int *)&beside)[k], count = n < missing ? atomic_inc(near + n) + 1 : INT_MAX;
        if (count <= minimum)
            lists[(count - 1) * missing + atomic_inc(state + 2 * count + 1)] = n;
    }
}

// Stage 1: one sweep over what the lists have from `begin` to before `end`, LANES per work-item. Bit k of median_wins:
// of k neighbors the median is the better estimator. In: lists, neighbors, valid. In and out: value.
__kernel void fill_holes(const int slots, const int begin, const int end, const int median_wins,
                         __global const int *lists, __global const int8 *neighbors, __global const uchar *valid,
                         __global float *value)
{
    const int first = begin + get_global_id(0) * LANES;
    if (first < end)
        fill_vector(slots, lists, first, end, median_wins, neighbors, valid, value);
}

// Ends such a sweep, one entry per work-item. In: neighbors; missing, their number. In and out: valid, near, lists,
// state.
__kernel void settle_holes(const int begin, const int end, __global const int8 *neighbors, const int missing,
                           const int minimum, __global uchar *valid, __global int *near, __global int *lists,
                           __global int *state)
{
    const int id = begin + get_global_id(0);
    if (id < end)
        settle_entry(lists[id], neighbors, missing, minimum, valid, near, lists, state);
}

// Stage 1 sweep after sweep by a single work-group, which takes less than launches for few pixels, while no sweep has
// more than `most` entries. Buffers as above.
__kernel void sweep_holes(const int slots, const int most, const int median_wins, __global const int8 *neighbors,
                          const int missing, const int minimum, __global uchar *valid, __global float *value,
                          __global int *near, __global int *lists, __global int *state)
{
    const int item = get_local_id(0), items = get_local_size(0);
    while (true) {
        int k = minimum;
        while (k && state[2 * k] == state[2 * k + 1])
            --k;
        const int begin = state[2 * k], end = state[2 * k + 1], before = state[1];
        barrier(CLK_GLOBAL_MEM_FENCE);
        if (!k || end - begin > most)
            return;
        __global const int *list = lists + (k - 1) * missing;
        for (int first = begin + item * LANES; first < end; first += items * LANES)
            fill_vector(slots, list, first, end, median_wins, neighbors, valid, value);
        barrier(CLK_GLOBAL_MEM_FENCE);
        for (int i = begin + item; i < end; i += items)
            settle_entry(list[i], neighbors, missing, minimum, valid, near, lists, state);
        barrier(CLK_GLOBAL_MEM_FENCE);
        if (!item) {
            state[2 * k] = end;
            state[0] += state[1] > before;
        }
        barrier(CLK_GLOBAL_MEM_FENCE);
    }
}

// Stage 2: one round of the 3x3 median without the center over all missing pixels, which are filled, LANES per
// work-item. In: neighbors; runs, uchar per LANES pixels, bit k where their neighbors k are numbered one after another;
// valid, value_in. Out: value_out of missing pixels.
__kernel void smooth_holes(const int slots, __global const int8 *neighbors, const int missing,
                           __global const uchar *runs, __global const uchar *valid, __global const float *value_in,
                           __global float *value_out)
{
    const int first = get_global_id(0) * LANES;
    if (first >= missing)
        return;
    around_t around;
    real8 near[8], result;
    int8 beyond = 0;
    for (int lane = 0; lane < LANES; ++lane)
        beyond |= neighbors[MIN(first + lane, missing - 1)] == slots - 1;
    const bool inside = !any(beyond) && first + LANES <= missing;
    if (!inside)
        for (int lane = 0; lane < LANES; ++lane)
            look_around(&around, lane, MIN(first + lane, missing - 1), ~0, neighbors, valid);
    for (int c = 0; c < CHANNELS; ++c) {
        __global const float *plane = value_in + c * slots;
        if (inside) {  // as nearly all are: no need to look which neighbors there are
            __global const int *from = (__global const int *)(neighbors + first);
            const int run = runs[get_global_id(0)];
            UNROLL
            for (int k = 0; k < 8; ++k)
                if (run >> k & 1)
                    near[k] = (real8)EACH(FLOATS(plane + from[k]));
                else
                    UNROLL
                    for (int lane = 0; lane < LANES; ++lane)
                        ((real *)(near + k))[lane] = plane[from[8 * lane + k]];
            SORT(real8, near)
            result = (real)0.5 * (near[3] + near[4]);
            *(__global floats_t *)(value_out + c * slots + first) = (float8)EACH(result);
        } else {
            NEAR(near, plane[from])
            estimate(&around, near, &result);
            for (int lane = 0; lane < LANES && first + lane < missing; ++lane)
                value_out[c * slots + first + lane] = ((const real *)&result)[lane];
        }
    }
}

// Sorts the middle one of nine into its place, with the fewest exchanges.
#define MIDDLE(T, s) \
    ORDER(T, s[1], s[2]) ORDER(T, s[4], s[5]) ORDER(T, s[7], s[8]) ORDER(T, s[0], s[1]) ORDER(T, s[3], s[4]) \
    ORDER(T, s[6], s[7]) ORDER(T, s[1], s[2]) ORDER(T, s[4], s[5]) ORDER(T, s[7], s[8]) ORDER(T, s[0], s[3]) \
    ORDER(T, s[5], s[8]) ORDER(T, s[4], s[7]) ORDER(T, s[3], s[6]) ORDER(T, s[1], s[4]) ORDER(T, s[2], s[5]) \
    ORDER(T, s[4], s[7]) ORDER(T, s[4], s[2]) ORDER(T, s[6], s[4]) ORDER(T, s[4], s[2])

// Stage 3, of the known pixels around holes: Sobel's gradient and the 3x3 median, LANES pixels per work-item; beyond
// the image its edge goes on. In: list of `count` pixels of value (CHANNELS, height, width), all of which are known or
// filled. Out: steepness (count), the largest square of a gradient's magnitude among the channels; blended (CHANNELS,
// count), the medians.
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
            const int i = MIN(MAX(y + k / 3 - 1, 0), camera.height - 1);
            const int j = MIN(MAX(x + k % 3 - 1, 0), camera.width - 1);
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
