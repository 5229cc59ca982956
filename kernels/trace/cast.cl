// Casts rays against analytic surfaces: what one time sample shows. Along a ray r, w = 1/Z solves
// C w^2 + 2 B w + A = 0 (common/geometry.clh); the blur radius is R = blur_scale (focus_power - w) (2.33). Twin:
// clsco/reference/trace/trace.py. Host: clsco/passes/trace.py, for all scenes of analytic surfaces.
//
// Planes cover the frame, or a strip of its rows, and an apron of sources that reach it: (height, width), row-major.
//   source  planes, see common/sources.clh
//   value   float (CHANNELS, height, width): radiance
//   label   uchar (height, width): 0 no surface, else root and object of the hit (`nearest_surface`), and bit EDGE
//   depth   real (height, width): inverse depth
//   texture float (textures, CHANNELS, frame_rows, columns), by number in surface_t; then mipmaps of textures that lie
//           on surfaces, float (sides, rows, columns, CHANNELS) per level, which begin where texture_map_t says
// Square roots and floors as single instructions took a plane from 36 to 12 ns per pixel; casting once for all lenses
// of a sweep took the prepass from 31 to 6 ns, plus 20 per lens.

#include "trace/changes.clh"
#include "trace/texture.clh"

// Casts rays through all pixels of frame and apron at the objects of an occlusion group, for all lenses. Out: value,
// depth, label. With textures on surfaces, value has one more plane: the result of `surface_texture`.
__kernel void cast(const grid_t grid, __constant surface_t *surfaces, const group_t group,
                   __global const float *texture, __constant texture_map_t *maps OF_LIGHT, __global float *value,
                   __global real *depth, __global uchar *label OF_SLOPES OF_CHANGES) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int row = FRAME_ROW(grid, y), column = x - grid.guard, at = y * grid.width + x;
    const real3 ray = KEPT_RAY(grid, at, row, column);
    uchar root;
    int object;
#if DIVIDED
    if (changing && still_from(grid, changes, x, y) == -INFINITY) {
        depth[at] = label[at] = 0;
        return;
    }
#endif
    const real w = nearest_surface(surfaces, group, ray, &root, &object);
    depth[at] = w;
    label[at] = root;
    const int plane = grid.height * grid.width;
    const float texels = take_radiance(grid, surfaces, ray, w, root, row, column, 1,
                                       SHADE_OF(surfaces, root, ray, w), 1, texture, maps, value + at, plane);
    if (TEXTURED)
        value[CHANNELS * plane + at] = texels;
}

// Makes the pinhole image of an occlusion group, for `layered` occlusion. Out: value, as above; coc real, signed R in
// px, and valid uchar, (height, width); statistics.
__kernel void pinhole(const grid_t grid, const lens_t lens, __constant surface_t *surfaces, const group_t group,
                      __global const float *texture, __constant texture_map_t *maps OF_LIGHT, __global float *value,
                          __global real *coc, __global uchar *valid, __global int *statistics OF_SLOPES OF_BENDS) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= grid.width || y >= grid.height)
        return;
    const int row = FRAME_ROW(grid, y), column = x - grid.guard, at = y * grid.width + x;
    const real3 ray = KEPT_RAY(grid, at, row, column);
    uchar root;
    int object;
    const real w = nearest_surface(surfaces, group, ray, &root, &object);
    take_radiance(grid, surfaces, ray, w, root, row, column, 1, SHADE_OF(surfaces, root, ray, w), 1,
                  texture, maps, value + at, grid.height * grid.width);
    const bend_t bend = KEPT_BEND(grid, lens, at, ray);
    coc[at] = root ? bend.stretch * bent_radius(lens, bend.focus, w) : 0;
    valid[at] = root != 0;
    if (root)
        note_radius(statistics, coc[at]);
}
