// Point sources of small surfaces, see small.clh. Host: clsco/passes/trace.py.

#include "trace/trace.cl"

#if SMALL && SUBPIXELS
// Fills the slots of small surfaces. In: source, pixels. Out: sub_source, sub_value, sub_depth, as of trace_subpixels.
__kernel void trace_small(const grid_t grid, const lens_t lens, __constant surface_t *surfaces, const group_t group,
                          const psf_t psf, __global const float *texture OF_TEXTURE_MAPS OF_LIGHT,
                          __global const int *pixels, const int capacity, __global const float *source,
                          __global float4 *sub_source, __global float *sub_value, __global real *sub_depth,
                          __global int *statistics)
{
    const int slot = get_global_id(0);
    if (slot >= MIN(statistics[STATISTIC_SLOTS], capacity) || pixels[slot] < 0)
        return;
    const int pixel = pixels[slot], row = FRAME_ROW(grid, pixel / grid.width), column = pixel % grid.width - grid.guard;
    const int mark = as_int(MARKS(source, grid.height * grid.width)[pixel]), number = slot - FIRST_SLOT(mark);
    if (number < 1 || number > mark >> SLOT_BITS)
        return;
    ulong small = small_members(grid, surfaces, group, row, column);
    for (int i = 1; i < number; ++i)
        small &= small - 1;
    const int object = (int)popcount((small & -small) - 1);
    float4 cover[EACH];
    small_cover(grid, surfaces, group, object, row, column, cover LIGHT);
    for (int sub = 0; sub < EACH; ++sub) {
        const int id = slot * EACH + sub;
        const float4 own = cover[sub];
        if (!(own.x > 0)) {
            sub_source[id] = (float4)(-1, 0, 0, as_float(WHOLE));
            continue;
        }
        const real3 ray = pixel_ray(grid, row + own.z / own.x, column + own.y / own.x);
        const real3 middle = cell_ray(grid, pixel, sub, 0, 0);
        const real w = small_depth(surfaces + object, group, ray);
        sub_depth[id] = w;
        uchar root;
        const real hit = solve_root(surfaces + object, ray, group.root, &root);
        take_radiance(grid, surfaces, ray, root ? hit : w, 2 * object + 1, row, column, SUBPIXELS, own.w / own.x,
                      own.x / EACH, texture TEXTURE_MAPS, sub_value + id, capacity * EACH);
        root = 2 * object + 1;
        sub_source[id] = source_record(grid, lens, surfaces, group, psf, ray, bend_along(grid, lens, ray), w, middle,
                                       bend_along(grid, lens, middle), w, 1, true, &root, statistics);
    }
}
#endif
