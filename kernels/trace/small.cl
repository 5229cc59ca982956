// Point sources of small surfaces, see small.clh. Host: clsco/passes/trace.py.

#if SMALL && SUBPIXELS
// Divides the cells of marked pixels anew where small surfaces are in them. In: source, sub_label, and in and out
// sub_source, sub_value, sub_depth as trace_subpixels leaves them.
__kernel void trace_small(const grid_t grid, const lens_t lens, __constant surface_t *surfaces, const group_t group,
                          const psf_t psf, __global const float *texture OF_TEXTURE_MAPS OF_LIGHT,
                          __global const int *pixels, const int capacity, __global const float *source,
                          __global float4 *sub_source, __global float *sub_value, __global const uchar *sub_label,
                          __global real *sub_depth, __global int *statistics OF_EXPOSURE)
{
    const int slot = get_global_id(0);
    if (slot >= MIN(statistics[STATISTIC_SLOTS], capacity) || pixels[slot] < 0)
        return;
    const int pixel = pixels[slot], row = FRAME_ROW(grid, pixel / grid.width), column = pixel % grid.width - grid.guard;
    const ulong small = small_members(grid, surfaces, group, row, column);
    if (!small)
        return;
    uchar labels[CELLS_AROUND * CELLS_AROUND];
    coverage_t found;
    divided_t all;
    const bool outlined = labels_around(grid, MARKS(source, grid.height * grid.width), pixels, sub_label, slot, labels);
    if (outlined)
        cell_coverage(grid, surfaces, row, column, labels, &found);
    for (int sub = 0; sub < EACH; ++sub)
        all.left[sub] = outlined ? found.covered[CELL_AROUND(sub)] : 1;
    divide_cells(grid, surfaces, group, small, row, column, sub_label + slot * EACH, &all LIGHT);
#if DIVIDED
    const bool pixel_still = (source[pixel] <= ELSEWHERE) != exposure.still;
#endif
    for (int sub = 0; sub < EACH; ++sub) {
        const int id = slot * EACH + sub, object = all.owner[sub] - 1;
        if (object < 0) {
            const float covered = outlined ? found.covered[CELL_AROUND(sub)] : 1;
            for (int c = 0; c < CHANNELS; ++c)
                sub_value[c * capacity * EACH + id] *= covered > 0 ? all.left[sub] / covered : 0;
            continue;
        }
        const float4 own = all.own[sub];
        const real3 ray = pixel_ray(grid, row + own.z / own.x, column + own.y / own.x);
        const real3 middle = cell_ray(grid, pixel, sub, 0, 0);
        const real w = small_depth(surfaces + object, group, ray);
        sub_depth[id] = w;
#if DIVIDED
        const bool still = pixel_still && is_still(grid, lens, surfaces, group, psf, exposure, places, middle, w,
                                                   object, MOVING_MARGIN);
        if (!still)
            check_window(grid, exposure, pixel, statistics);
        if (still != exposure.still) {
            sub_source[id] = (float4)(ELSEWHERE, 0, 0, as_float(WHOLE));
            continue;
        }
#endif
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
