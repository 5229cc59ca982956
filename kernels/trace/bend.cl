// Stores the rays through all pixels of frame and apron, bent by a lens that is not thin, for the other kernels:
// once for all time samples in which the lens does not change. Twin: clsco/optics/distortion.py and lens.py. Host:
// clsco/passes/bend.py.
//
//   slopes real2 (height, width): of the rays, where the image is distorted, else null
//   bends  float (height, width, BENDS): see `kept_bend`
//
// Newton's method, square root and divisions in double took 108 ns per pixel of `cast` and `aim`, and 17 without
// distortion; reading stored values takes 8 and 5 (docs/lessons.md).

#include "common/geometry.clh"

#if CURVED
__kernel void bend(const grid_t grid, const lens_t lens, __global float *bends, __global real2 *slopes) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int at = y * grid.width + x;
    const real3 ray = grid_ray(grid, at);
    keep_bend(bends, at, bend_along(grid, lens, ray));
    if (CURVED & CURVED_IMAGE)
        slopes[at] = ray.xy;
}
#endif
