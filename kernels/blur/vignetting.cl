// Vignetting: I(x) = T(x) B(x), where B is the blurred image and T the light of a pixel relative to that of the middle.
// Host: clsco/passes/vignetting.py, for each time sample of a lens that darkens the frame.

#include "common/geometry.clh"

// Darkens a plane, in the layout of accumulate.cl. In: share float (frame_rows, columns), of the whole frame, of which
// row `top` is the first of the plane. In and out: plane.
__kernel void vignette(const int rows, const int columns, const int channels, __global float *restrict plane,
                       const int apart, const int start, const int pitch, __global const float *restrict share,
                       const int top) {
    const int first = get_global_id(0) * SUMMED_PIXELS, row = get_global_id(1);
    if (first >= columns || row >= rows)
        return;
    __global const float *restrict own = share + (top + row) * columns;
    for (int k = 0; k < channels; ++k) {
        __global float *restrict light = plane + k * apart + start + row * pitch;
        for (int x = first; x < MIN(first + SUMMED_PIXELS, columns); ++x)
            light[x] *= own[x];
    }
}
