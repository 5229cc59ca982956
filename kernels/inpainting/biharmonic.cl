// The biharmonic equation in holes: conjugate gradients with a preconditioner of splines at all sizes
// (clsco/inpainting/biharmonic.py has the method and its sources). Unknown pixels are in lists: `list` has their
// numbers, row by row; `index` (rows, columns) has their places in the list, -1 for known pixels. Vectors are (count,
// CHANNELS). Sums have a fixed order. One work-item per unknown unless said otherwise.

#include "common/geometry.clh"

__constant int STEP_Y[4] = {-1, 1, 0, 0}, STEP_X[4] = {0, 0, -1, 1};

// Value of a known pixel of `image`, or of an unknown one of `vector`, else 0; the other pointer is 0.
static inline real value_at(__global const float *image, __global const real *vector, int place, int at, int c) {
    if (image)
        return place < 0 ? image[at * CHANNELS + c] : 0;
    return place < 0 ? 0 : vector[place * CHANNELS + c];
}

// Five-point Laplacian; nothing flows over the border of the image.
static void laplacian(const int rows, const int columns, __global const float *image, __global const real *vector,
                      __global const int *index, int y, int x, real *result) {
    const int at = y * columns + x;
    for (int c = 0; c < CHANNELS; ++c)
        result[c] = 0;
    for (int k = 0; k < 4; ++k) {
        const int i = y + STEP_Y[k], j = x + STEP_X[k], near = i * columns + j;
        if (i < 0 || i >= rows || j < 0 || j >= columns)
            continue;
        for (int c = 0; c < CHANNELS; ++c)
            result[c] += value_at(image, vector, index[near], near, c) - value_at(image, vector, index[at], at, c);
    }
}

// The Laplacian of the Laplacian.
static void biharmonic(const int rows, const int columns, __global const float *image, __global const real *vector,
                       __global const int *index, int at, real *result) {
    const int y = at / columns, x = at % columns;
    real center[CHANNELS], near[CHANNELS];
    laplacian(rows, columns, image, vector, index, y, x, center);
    for (int c = 0; c < CHANNELS; ++c)
        result[c] = 0;
    for (int k = 0; k < 4; ++k) {
        const int i = y + STEP_Y[k], j = x + STEP_X[k];
        if (i < 0 || i >= rows || j < 0 || j >= columns)
            continue;
        laplacian(rows, columns, image, vector, index, i, j, near);
        for (int c = 0; c < CHANNELS; ++c)
            result[c] += near[c] - center[c];
    }
}

// Residual of the solution 0. In: image (rows, columns, CHANNELS), of which known pixels are used. Out: residual.
__kernel void start_residual(const int rows, const int columns, __global const float *image, __global const int *index,
                             __global const int *list, const int count, __global real *residual) {
    const int entry = get_global_id(0);
    if (entry >= count)
        return;
    real result[CHANNELS];
    biharmonic(rows, columns, image, 0, index, list[entry], result);
    for (int c = 0; c < CHANNELS; ++c)
        residual[entry * CHANNELS + c] = -result[c];
}

// Applies the biharmonic operator. In: direction. Out: applied.
__kernel void apply_biharmonic(const int rows, const int columns, __global const real *direction,
                               __global const int *index, __global const int *list, const int count,
                               __global real *applied) {
    const int entry = get_global_id(0);
    if (entry >= count)
        return;
    real result[CHANNELS];
    biharmonic(rows, columns, 0, direction, index, list[entry], result);
    for (int c = 0; c < CHANNELS; ++c)
        applied[entry * CHANNELS + c] = result[c];
}

// Sums of products of DOT_SEGMENT entries each, one work-item per sum. Out: partial (ceil(count / DOT_SEGMENT),
// CHANNELS).
__kernel void add_products(__global const real *a, __global const real *b, const int count, __global real *partial) {
    const int first = get_global_id(0) * DOT_SEGMENT;
    if (first >= count)
        return;
    real sum[CHANNELS];
    for (int c = 0; c < CHANNELS; ++c)
        sum[c] = 0;
    for (int k = first; k < MIN(first + DOT_SEGMENT, count); ++k)
        for (int c = 0; c < CHANNELS; ++c)
            sum[c] += a[k * CHANNELS + c] * b[k * CHANNELS + c];
    for (int c = 0; c < CHANNELS; ++c)
        partial[get_global_id(0) * CHANNELS + c] = sum[c];
}

// Adds up these sums, one work-item per channel. Out: row `slot` of sums (3, CHANNELS).
__kernel void add_partials(__global const real *partial, const int count, const int slot, __global real *sums) {
    const int c = get_global_id(0);
    if (c >= CHANNELS)
        return;
    real sum = 0;
    for (int k = 0; k < count; ++k)
        sum += partial[k * CHANNELS + c];
    sums[slot * CHANNELS + c] = sum;
}

// A step along the direction, to the minimum of the energy. In: sums, of residual x preconditioned residual in row
// `now`, of direction x applied in row 2; a solved channel does not change. In and out: solution, residual.
__kernel void take_step(__global const real *sums, const int now, __global const real *direction,
                        __global const real *applied, const int count, __global real *solution,
                        __global real *residual) {
    const int entry = get_global_id(0);
    if (entry >= count)
        return;
    for (int c = 0; c < CHANNELS; ++c) {
        const int k = entry * CHANNELS + c;
        const real energy = sums[2 * CHANNELS + c], size = energy > 0 ? sums[now * CHANNELS + c] / energy : 0;
        solution[k] += size * direction[k];
        residual[k] -= size * applied[k];
    }
}

// The next direction, conjugate to all former ones. In: sums of residual x preconditioned residual, the former one in
// row `now` and that of this step in the other of rows 0 and 1; preconditioned. In and out: direction.
__kernel void turn_direction(__global const real *sums, const int now, __global const real *preconditioned,
                             const int count, __global real *direction) {
    const int entry = get_global_id(0);
    if (entry >= count)
        return;
    for (int c = 0; c < CHANNELS; ++c) {
        const int k = entry * CHANNELS + c;
        const real before = sums[now * CHANNELS + c];
        const real part = before > 0 ? sums[(1 - now) * CHANNELS + c] / before : 0;
        direction[k] = preconditioned[k] + part * direction[k];
    }
}

// Weight of a coarse pixel's spline at fine pixel i, along an axis of `size` fine pixels: quadratic B-splines are
// refined by 1/4, 3/4, 3/4, 1/4, and mirrored at the border.
static inline real refinement(int coarse, int i, int size) {
    const bool mirrored = i == 0 || (i == size - 1 && size % 2 == 0);
    return (i / 2 == coarse ? (real)0.75 : (real)0.25) + (mirrored ? (real)0.25 : 0);
}

// Residuals of the splines of twice the size, times `gain`; one work-item per coarse unknown. In: fine vector of an
// image (rows, columns) and its index; list of coarse pixels. Out: coarse vector.
__kernel void coarser(const int rows, const int columns, __global const real *fine, __global const int *index,
                      __global const int *list, const int count, const real gain, __global real *coarse) {
    const int entry = get_global_id(0);
    if (entry >= count)
        return;
    const int width = (columns + 1) / 2, y = list[entry] / width, x = list[entry] % width;
    real sum[CHANNELS];
    for (int c = 0; c < CHANNELS; ++c)
        sum[c] = 0;
    for (int i = MAX(2 * y - 1, 0); i <= MIN(2 * y + 2, rows - 1); ++i)
        for (int j = MAX(2 * x - 1, 0); j <= MIN(2 * x + 2, columns - 1); ++j) {
            const real weight = refinement(y, i, rows) * refinement(x, j, columns);
            for (int c = 0; c < CHANNELS; ++c)
                sum[c] += weight * fine[index[i * columns + j] * CHANNELS + c];
        }
    for (int c = 0; c < CHANNELS; ++c)
        coarse[entry * CHANNELS + c] = gain * sum[c];
}

// A fine vector plus the splines of twice the size; one work-item per fine unknown. In: fine, of an image (rows,
// columns), its list, and coarse with its index. Out: sum, which may be fine itself.
__kernel void finer(const int rows, const int columns, __global const real *fine, __global const int *list,
                    const int count, __global const real *coarse, __global const int *coarse_index,
                    __global real *sum) {
    const int entry = get_global_id(0);
    if (entry >= count)
        return;
    const int y = list[entry] / columns, x = list[entry] % columns;
    const int height = (rows + 1) / 2, width = (columns + 1) / 2;
    real result[CHANNELS];
    for (int c = 0; c < CHANNELS; ++c)
        result[c] = fine[entry * CHANNELS + c];
    for (int k = 0; k < 4; ++k) {
        const int i = y / 2 + k / 2 * (y % 2 * 2 - 1), j = x / 2 + k % 2 * (x % 2 * 2 - 1);
        if (i < 0 || i >= height || j < 0 || j >= width)
            continue;
        const int place = coarse_index[i * width + j];
        if (place < 0)
            continue;
        const real weight = refinement(i, y, rows) * refinement(j, x, columns);
        for (int c = 0; c < CHANNELS; ++c)
            result[c] += weight * coarse[place * CHANNELS + c];
    }
    for (int c = 0; c < CHANNELS; ++c)
        sum[entry * CHANNELS + c] = result[c];
}
