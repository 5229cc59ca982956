// Exposure of a frame: I(x) = sum_t weight_t(line of x) B_t(x), where B_t is the blurred image of time sample t, and
// lines are rows, or with SCAN_COLUMNS columns. Host: clsco/passes/accumulate.py, for frames of several time samples.
//
// Kahan summation: `lost` is what rounding has added to `sum` so far, and is subtracted with the next time sample. For
// any number of these, a pixel has the error of its weights and of one sum. SUMMED_PIXELS of a row at a time took it
// from 1.6 to 0.4 ns per pixel.

#include "common/geometry.clh"

// Adds the plane of a time sample: its channels are `apart` floats apart, its first pixel is at `start`, its rows are
// `pitch` long. In: begins, 1 for the first plane of a frame, which overwrites sum and lost; weights float (rows) or
// (columns). In and out: sum and lost, float (channels, height, columns), where the plane begins in row `top`.
__kernel void accumulate(const int begins, const int rows, const int columns, const int channels,
                         __global const float *restrict plane, const int apart, const int start, const int pitch,
                         __global const float *restrict weights, const int top, const int height,
                         __global float *restrict sum, __global float *restrict lost) {
    const int first = get_global_id(0) * SUMMED_PIXELS, row = get_global_id(1);
    if (first >= columns || row >= rows)
        return;
    const float weight = SCAN_COLUMNS ? 0 : weights[row];
    for (int k = 0; k < channels; ++k) {
        __global const float *restrict own = plane + k * apart + start + row * pitch;
        __global float *restrict total = sum + (k * height + top + row) * columns, *restrict low = lost + (total - sum);
        for (int x = first; x < MIN(first + SUMMED_PIXELS, columns); ++x) {
            const float before = begins ? 0.0f : total[x];
            const float part = (SCAN_COLUMNS ? weights[x] : weight) * own[x] - (begins ? 0.0f : low[x]);
            const float after = before + part;
            low[x] = (after - before) - part;
            total[x] = after;
        }
    }
}
