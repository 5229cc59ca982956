// Pixels at silhouettes, and what their cells see. Planes, twin and host: cast.cl, for scenes with sub-pixel sources.

#include "common/sources.clh"
#include "trace/small.clh"

#if SUBPIXELS
// Gives a slot to every pixel within 2 px of a change of label, and to those whose texture is DETAILED or FINE, and
// more slots to pixels with small surfaces; a work-item has a run of TAP_LANES pixels. The order of slots varies, their
// contents do not. A pixel that got slots in a launch with less capacity keeps them. In: label. Out: marks of source;
// pixels (slots), index p of the pixel, or -1 - 2 p if it is only DETAILED, -2 - 2 p if only FINE; statistics.
__kernel void mark_silhouettes(const grid_t grid, __global const uchar *label, const int capacity,
                               __global float *source, __global int *pixels, __global int *statistics) {
    const int begin = get_global_id(0) * TAP_LANES, y = get_global_id(1);
    if (begin >= grid.width || y >= grid.height)
        return;
    const bool alike = has_one_label(grid, label, begin, y);
    if (TEXTURED + SMALL == 0 && alike)
        return;
    __global float *marks = MARKS(source, grid.height * grid.width);
    for (int x = begin; x < MIN(begin + TAP_LANES, grid.width); ++x) {
        const int at = y * grid.width + x;
        const int mark = as_int(marks[at]);
        if (mark >= 0)
            continue;
        bool fine = TEXTURED && mark == FINE, detailed = fine | (TEXTURED && mark == DETAILED);
        bool differs = SMALL && mark <= SMALL_WITHIN;
        differs = differs || (!alike && is_at_silhouette(grid, label, x, y));
        const int more = SMALL ? MAX(SMALL_WITHIN - mark, 0) : 0;
        if (!differs && !detailed)
            continue;
        const int slot = atomic_add(statistics + STATISTIC_SLOTS, 1 + more);
        for (int i = slot; i < MIN(slot + more + 1, capacity); ++i)
            pixels[i] = differs ? at : -1 - 2 * at - fine;
        if (slot + more >= capacity)
            continue;
        marks[at] = as_float(MARK_OF(slot, more));
    }
}

// Casts rays through the middles of SUBPIXELS x SUBPIXELS cells of every marked pixel at all surfaces that are not
// small. Out, per slot and cell in row-major order: sub_label uchar, without EDGE; sub_depth real.
__kernel void label_subpixels(const grid_t grid, __constant surface_t *surfaces, const group_t group,
                              __global const int *pixels, const int capacity, __global uchar *sub_label,
                              __global real *sub_depth, __global const int *statistics) {
    const int slot = get_global_id(0);
    if (slot >= MIN(statistics[STATISTIC_SLOTS], capacity) || pixels[slot] < 0)
        return;
    const int pixel = pixels[slot];
    group_t behind = group;
#if SMALL
    behind.members &= ~small_members(grid, surfaces, group, FRAME_ROW(grid, pixel / grid.width),
                                     pixel % grid.width - grid.guard);
#endif
    for (int sub = 0; sub < EACH; ++sub) {
        uchar root;
        int object;
        const real3 ray = cell_ray(grid, pixel, sub, 0, 0);
        sub_depth[slot * EACH + sub] = nearest_surface(surfaces, behind, ray, &root, &object);
        sub_label[slot * EACH + sub] = !SMALL || behind.members ? root : 0;
    }
}
#endif
