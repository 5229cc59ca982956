// The ground truth of a frame: what pinhole rays through pixel centers meet, at the middle of the exposure. Twin:
// ground_truth of clsco/reference/trace/truth.py. Host: clsco/passes/truth.py, for all scenes of analytic surfaces.
// Outputs are those with `by_rays` in clsco/frame/outputs.py, in its order, each null if not requested: one program
// makes any.

#include "trace/texture.clh"

// Image position of a hit in the pose `other`: column, row, and the hit's depth there over its depth here.
static NOINLINE real3 moved_pixel(__constant surface_t *surface, const grid_t grid, __constant pose_t *other,
                                  real3 ray, real w) {
    const real3 rest = load3(surface->rest) + load3(other->shift);
    const real3 turned_point = turned(other->rotation, body_point(surface, ray, w));
    return project(grid, other->step, rest * w + turned_point);
}

// Writes the way from a pixel to an image position, px right and down; 0 if that is none.
static void put_flow(__global float *flow, bool there, real3 to, int row, int column) {
    flow[0] = there && to.z > 0 ? (float)(to.x - column) : 0;
    flow[1] = there && to.z > 0 ? (float)(to.y - row) : 0;
}

static bool outside_frame(const grid_t grid, real3 at) {
    return !(at.z > 0 && at.x >= (real)-0.5 && at.x < grid.columns - (real)0.5 && at.y >= (real)-0.5 &&
             at.y < grid.frame_rows - (real)0.5);
}

// True if a surface at inverse depth `seen` hides a point whose inverse depth is w here and w / ratio there.
static bool covered(real seen, real ratio, real w) {
    return w * (1 + (REAL_IS_DOUBLE ? (real)1e-6 : (real)1e-5)) < seen * ratio;
}

// True if surfaces hide a point, or if it is outside of the frame. there: its image position and depth ratio; w: its
// inverse depth; step: slope between neighboring rays.
static NOINLINE bool occluded_among(__constant surface_t *surfaces, const grid_t grid, real step,
                                    const group_t group, real3 there, real w) {
    uchar any;
    int nearest;
    const real3 ray = ray_through(grid, step, there.y, there.x);
    const real seen = nearest_surface(surfaces, group, ray, &any, &nearest);
    return outside_frame(grid, there) || covered(seen, there.z, w);
}

// Ground truth of a strip at pixel centers, (rows, columns[, components]), never anti-aliased: depth mm (+inf:
// nothing), coc signed px (0: nothing), mask, object (-1: nothing), normal, flow px to the pose `next`, hidden (the
// point is not visible in the reference pose, so that its texture shows what hides it there), sharp radiance, uv (right
// and up from the lower left corner of the texture, in images of it). For stereo pairs: disparity px, and occluded (the
// point is not visible in the other view). flow_backward: px to the pose `previous`; flow_occluded: the point is not
// visible in the next frame. Surfaces: `still` in the reference pose, `opposite` in the frame of the other view, in
// poses `there`, and `following` in the next frame. to_left: 1 for the right view, -1 for the left one.
__kernel void ground_truth(const grid_t grid, const lens_t lens, __constant surface_t *surfaces,
                           __constant surface_t *still, __constant pose_t *next, const group_t group,
                           __global const float *texture, __constant texture_map_t *maps OF_LIGHT,
                           __constant surface_t *opposite, __constant pose_t *there, const int to_left,
                           __constant pose_t *previous, __constant surface_t *following, __global uchar *mask,
                           __global float *sharp, __global float *depth, __global float *coc, __global int *object_id,
                           __global float *normal, __global float *flow, __global uchar *hidden,
                           __global float *flow_backward, __global uchar *flow_occluded, __global float *uv,
                           __global float *disparity, __global uchar *occluded) {
    const int column = get_global_id(0), row = grid.top + get_global_id(1);
    if (column >= grid.columns || row >= grid.top + grid.rows)
        return;
    const int at = (row - grid.top) * grid.columns + column;
    const real3 ray = pixel_ray(grid, row, column);
    uchar root;
    int object;
    const real w = nearest_surface(surfaces, group, ray, &root, &object);
    const int own = MAX(object, 0);
    __constant surface_t *surface = surfaces + own;
    mask[at] = root != 0;
    bool is_mapped = TEXTURED && root && maps[object].kind != MAP_PROJECTED;  // the texture lies on the surface
    if (object_id)
        object_id[at] = object;
    if (depth)
        depth[at] = root ? (float)(1 / w) : INFINITY;
    if (coc)
        coc[at] = root ? (float)blur_radius(lens_along(grid, lens, ray), ray, w) : 0;
    if (normal) {
        const real3 n = root ? surface_normal(surface, ray, w) : (real3)(0, 0, 0);
        normal[3 * at] = (float)n.x;
        normal[3 * at + 1] = (float)n.y;
        normal[3 * at + 2] = (float)n.z;
    }
    if (hidden) {
        hidden[at] = 0;
        if (root && !is_mapped) {
            const real3 from = rest_pixel(surface, grid, ray, w);
            // 1 / depth in the reference pose of this point, against the depth in that pixel of the pinhole image
            uchar other;
            const real3 rest_ray = ray_through(grid, grid.rest_step, from.y, from.x);
            const real seen = solve_quadric(still + object, rest_ray, &other);
            hidden[at] = outside_frame(grid, from) || covered(seen, from.z, w);
        }
    }
    const float share = root && sharp ? SHADE(surfaces, object, ray, w) : 0;
    if ((sharp || uv) && !is_mapped) {
        const real3 point = texture_point(surface, grid, ray, w, row, column);
        for (int c = 0; c < CHANNELS && sharp; ++c)
            sharp[at * CHANNELS + c] = root ? OF_CHANNEL(share, c) * radiance(texture, surface, grid, c, point) : 0;
        if (uv) {
            const bool before_lens = root && point.z > 0;
            const real right = (point.x + (real)0.5) / grid.columns;
            const real down = (point.y + (real)0.5) / grid.frame_rows;
            uv[2 * at] = before_lens ? (float)right : 0;
            uv[2 * at + 1] = before_lens ? (float)(1 - down) : 0;
        }
    }
#if TEXTURED
    if (sharp && is_mapped) {
        float mean[CHANNELS];
        surface_texture(texture, surface, maps + object, grid, ray, w, 1, mean);
        for (int c = 0; c < CHANNELS; ++c)
            sharp[at * CHANNELS + c] = OF_CHANNEL(share, c) * mean[c];
    }
    if (uv && is_mapped) {
        const real2 there = texture_coordinates(surface, maps + object, grid, ray, w);
        uv[2 * at] = (float)there.x, uv[2 * at + 1] = (float)there.y;
    }
#endif
    if (disparity || occluded) {
        const real3 other = moved_pixel(surface, grid, there + own, ray, w);
        if (disparity)
            disparity[at] = root && other.z > 0 ? (float)(to_left * (other.x - column)) : 0;
        if (occluded)
            occluded[at] = root ? occluded_among(opposite, grid, there->step, group, other, w) : 0;
    }
    if (flow_backward)
        put_flow(flow_backward + 2 * at, root, moved_pixel(surface, grid, previous + own, ray, w), row, column);
    if (flow || flow_occluded) {
        const real3 later = moved_pixel(surface, grid, next + own, ray, w);
        if (flow)
            put_flow(flow + 2 * at, root, later, row, column);
        if (flow_occluded)
            flow_occluded[at] = root ? occluded_among(following, grid, next->step, group, later, w) : 0;
    }
}
