// Casts rays against analytic surfaces: the sources of one time sample, and the ground truth of a frame. Along a ray r
// w = 1/Z solves C w^2 + 2 B w + A = 0 (common/geometry.clh); the blur radius is R = blur_scale (focus_power - w)
// (2.33). Twin: clsco/reference/trace/trace.py. Host: clsco/engine/renderer.py, for all scenes of analytic surfaces.
//
// Sources lie on the frame, or a strip of its rows, and on the apron around it that contributes to it: (height, width),
// row-major.
//   source  planes, see common/sources.clh
//   value   float (CHANNELS, height, width): radiance times the weight of the time sample in the exposure
//   label   uchar (height, width): 0 no surface, else which root of which object was hit, and on which side of others
//   depth   wide_t (height, width): inverse depth, with OCCLUDED
//   texture float (textures, CHANNELS, frame_rows, columns); surface_t names its object's
// Features besides geometry.clh's: MOVED (not all is in its reference pose), TILT, SUBPIXELS (sources per axis in a
// pixel at a silhouette, 0 none), SAMPLED, OCCLUDED, PINHOLE, LENSES, and TRUTH_* for the outputs of ground_truth.
// Square roots and floors as instructions took a plane from 36 to 12 ns per pixel, one cast for all lenses of a sweep
// the prepass from 31 to 6 and 20 per lens (benchmarks/optimisation_log.md).

// Where a hit takes its radiance from in the texture: (column, row, in front of the lens). In the reference pose a
// pixel shows its own texel.
static wide3_t texture_point(__constant surface_t *surface, const camera_t camera, wide3_t ray, wide_t w, int row,
                             int column)
{
#if MOVED
    return rest_pixel(surface, camera, ray, w);
#else
    return wide_vector(widened(column), widened(row), widened(1));
#endif
}

// 0 for what is behind the lens in the reference pose, which the texture does not hold.
static float radiance(__global const float *texture, __constant surface_t *surface, const camera_t camera, int channel,
                      wide3_t point)
{
    const int number = surface->texture * CHANNELS + channel;
    __global const float *plane = texture + (size_t)number * camera.frame_rows * camera.columns;
#if MOVED
    return narrow(point.z) > 0 ? sample_texture(plane, camera, point.y, point.x) : 0;
#else
    return plane[mirror_index((int)narrow(point.y), camera.frame_rows) * camera.columns +
                 mirror_index((int)narrow(point.x), camera.columns)];
#endif
}

// What the lens makes of a hit: its record; below 0 where none of its radiance reaches the lens. subpixel: the source
// is one of SUBPIXELS^2. In and out: label, statistics.
static float4 source_record(const camera_t camera, __constant surface_t *surfaces, const layer_t layer, const psf_t psf,
                            wide3_t ray, wide_t w, int subpixel, uchar *label, __global int *statistics)
{
    float4 record = (float4)(-1, 0, 0, as_float(WHOLE));
    if (*label == 0)
        return record;
    const wide_t whole_radius = blur_radius(camera, w);
    const real radius = narrow(whole_radius);
    __constant surface_t *surface = surfaces + (*label - 1) / 2;
#if OCCLUDED
    bool edge;
    const lens_t lens = lens_of(radius, psf.lens_extent, subpixel ? (real)1 / SUBPIXELS : 1);
    const int seen = check_visibility(camera, surfaces, layer, ray, w, lens, 0, &edge);
    *label |= edge << 7;
    if (seen == HIDDEN)
        return record;
    record.w = as_float(seen == PARTLY ? PARTLY_OCCLUDED : WHOLE);
#endif
    note_radius(statistics, radius);
    record.x = table_coordinate(psf, whole_radius, subpixel);
#if TILT
    record.yz = tilt_slope(blur_gradient(camera, surface_slope(surface, ray, w)), radius);
#endif
    return record;
}

// Radiance of a hit on a pixel's ray, times the weight, to a plane of `values` per channel; 0 without one.
static void take_radiance(const camera_t camera, __constant surface_t *surfaces, wide3_t ray, wide_t w, uchar label,
                          int row, int column, float weight, __global const float *texture, __global float *values,
                          int plane)
{
    __constant surface_t *surface = surfaces + MAX(label - 1, 0) / 2;
    const wide_t zero = widened(0);
    const wide3_t nowhere = wide_vector(zero, zero, zero);
    const wide3_t point = label ? texture_point(surface, camera, ray, w, row, column) : nowhere;
    for (int c = 0; c < CHANNELS; ++c)
        values[c * plane] = label ? weight * radiance(texture, surface, camera, c, point) : 0;
}

// One source per pixel of frame and apron, on the nearest object of the occlusion group `layer`. Out: source, value,
// label, statistics, depth.
__kernel void trace(const camera_t camera, __constant surface_t *surfaces, const layer_t layer, const psf_t psf,
                    const float weight, __global const float *texture, __global float *source, __global float *value,
                    __global uchar *label, __global int *statistics
#if OCCLUDED
                    , __global wide_t *depth
#endif
)
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= camera.width || y >= camera.height)
        return;
    const int row = FRAME_ROW(camera, y), column = x - camera.guard, at = y * camera.width + x;
    const wide3_t ray = pixel_ray(camera, widened(row), widened(column));
    uchar root;
    int object;
    const wide_t w = nearest_surface(surfaces, layer, ray, &root, &object);
    take_radiance(camera, surfaces, ray, w, root, row, column, weight, texture, value + at,
                  camera.height * camera.width);
    put_source(source, camera.height * camera.width, at,
               source_record(camera, surfaces, layer, psf, ray, w, 0, &root, statistics));
#if OCCLUDED
    depth[at] = w;
#endif
#if SUBPIXELS
    label[at] = root;
#endif
}

#if LENSES
// The part of trace that all lenses have in common. Out: value, depth, and hit uchar (height, width), the label before
// any visibility test.
__kernel void cast(const camera_t camera, __constant surface_t *surfaces, const layer_t layer, const float weight,
                   __global const float *texture, __global float *value, __global wide_t *depth, __global uchar *hit)
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= camera.width || y >= camera.height)
        return;
    const int row = FRAME_ROW(camera, y), column = x - camera.guard, at = y * camera.width + x;
    const wide3_t ray = pixel_ray(camera, widened(row), widened(column));
    uchar root;
    int object;
    depth[at] = nearest_surface(surfaces, layer, ray, &root, &object);
    hit[at] = root;
    take_radiance(camera, surfaces, ray, depth[at], root, row, column, weight, texture, value + at,
                  camera.height * camera.width);
}

// The rest of it, for one lens. In: depth, hit. Out: source, label, statistics.
__kernel void aim(const camera_t camera, __constant surface_t *surfaces, const layer_t layer, const psf_t psf,
                  __global const wide_t *depth, __global const uchar *hit, __global float *source,
                  __global uchar *label, __global int *statistics)
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= camera.width || y >= camera.height)
        return;
    const int at = y * camera.width + x;
    const wide3_t ray = pixel_ray(camera, widened(FRAME_ROW(camera, y)), widened(x - camera.guard));
    uchar root = hit[at];
    put_source(source, camera.height * camera.width, at,
               source_record(camera, surfaces, layer, psf, ray, depth[at], 0, &root, statistics));
#if SUBPIXELS
    label[at] = root;
#endif
}
#endif

#if SUBPIXELS
// Gives a slot to every pixel within 2 px of a change of label. Slots come in any order; what is in them does
// not. In: label. Out: marks of source, pixels (slots): index of the pixel, statistics.
__kernel void mark_silhouettes(const camera_t camera, __global const uchar *label, const int capacity,
                               __global float *source, __global int *pixels, __global int *statistics)
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= camera.width || y >= camera.height)
        return;
    const int at = y * camera.width + x;
    const uchar own = label[at];
    bool differs = false;
    if (x >= 2 && x < camera.width - 2) {
        // Five labels of a row at a time, four of them as one int.
        for (int i = MAX(y - 2, 0); i <= MIN(y + 2, camera.height - 1); ++i) {
            __global const uchar *line = label + i * camera.width + x - 2;
            differs |= LOAD_FOUR_BYTES(line) != own * 0x01010101u || line[4] != own;
        }
    } else {
        for (int i = MAX(y - 2, 0); i <= MIN(y + 2, camera.height - 1); ++i)
            for (int j = MAX(x - 2, 0); j <= MIN(x + 2, camera.width - 1); ++j)
                differs |= label[i * camera.width + j] != own;
    }
    if (!differs)
        return;
    const int slot = atomic_inc(statistics + STATISTIC_SLOTS);
    if (slot >= capacity)
        return;
    pixels[slot] = at;
    MARKS(source, camera.height * camera.width)[at] = as_float(slot);
}

// SUBPIXELS x SUBPIXELS point sources of every marked pixel. Out, per slot and sub-pixel in row-major order: sub_source
// float4 (coordinate, tilt right, tilt down, WHOLE or PARTLY_OCCLUDED), sub_value float (CHANNELS, slots, SUBPIXELS^2),
// sub_depth wide_t.
__kernel void trace_subpixels(const camera_t camera, __constant surface_t *surfaces, const layer_t layer,
                              const psf_t psf, const float weight, __global const float *texture,
                              __global const int *pixels, const int capacity, __global float4 *sub_source,
                              __global float *sub_value, __global int *statistics
#if OCCLUDED
                              , __global wide_t *sub_depth
#endif
)
{
    const int id = get_global_id(0), each = SUBPIXELS * SUBPIXELS;
    const int slot = id / each, sub = id % each;
    if (id == 0)
        atomic_max(statistics + STATISTIC_MOST_SLOTS, statistics[STATISTIC_SLOTS]);
    if (slot >= MIN(statistics[STATISTIC_SLOTS], capacity))
        return;
    const int row = FRAME_ROW(camera, pixels[slot] / camera.width), column = pixels[slot] % camera.width - camera.guard;
    const wide_t down = widened((sub / SUBPIXELS + (real)0.5) / SUBPIXELS - (real)0.5);
    const wide_t right = widened((sub % SUBPIXELS + (real)0.5) / SUBPIXELS - (real)0.5);
    const wide3_t ray = pixel_ray(camera, wide_add(widened(row), down), wide_add(widened(column), right));
    uchar root;
    int object;
    const wide_t w = nearest_surface(surfaces, layer, ray, &root, &object);
    take_radiance(camera, surfaces, ray, w, root, row, column, weight / each, texture, sub_value + id, capacity * each);
    sub_source[id] = source_record(camera, surfaces, layer, psf, ray, w, 1, &root, statistics);
#if OCCLUDED
    sub_depth[id] = w;
#endif
}
#endif

#if PINHOLE
// The pinhole image of the occlusion group `layer`, for `layered` occlusion. Out: value as in trace; coc wide_t, signed
// R in px, and valid uchar, (height, width); statistics.
__kernel void pinhole(const camera_t camera, __constant surface_t *surfaces, const layer_t layer, const float weight,
                      __global const float *texture, __global float *value, __global wide_t *coc, __global uchar *valid,
                      __global int *statistics)
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= camera.width || y >= camera.height)
        return;
    const int row = FRAME_ROW(camera, y), column = x - camera.guard, at = y * camera.width + x;
    const wide3_t ray = pixel_ray(camera, widened(row), widened(column));
    uchar root;
    int object;
    const wide_t w = nearest_surface(surfaces, layer, ray, &root, &object);
    take_radiance(camera, surfaces, ray, w, root, row, column, weight, texture, value + at,
                  camera.height * camera.width);
    const wide_t none = widened(0);
    coc[at] = root ? blur_radius(camera, w) : none;
    valid[at] = root != 0;
    if (root)
        note_radius(statistics, narrow(coc[at]));
}
#endif

#if TRUTH_FLOW || TRUTH_DISPARITY || TRUTH_OCCLUDED
// Where a hit is in the image in the pose `other`: column, row, and its depth there over its depth here.
static wide3_t moved_pixel(__constant surface_t *surface, const camera_t camera, __constant pose_t *other, wide3_t ray,
                           wide_t w)
{
    const wide3_t rest = wide3_add(wide_load(surface->rest), wide_load(other->shift));
    const wide3_t turned_point = turned(other->rotation, body_point(surface, ray, w));
    return project(camera, wide3_add(wide3_scale(rest, w), turned_point));
}
#endif

#if TRUTH_HIDDEN || TRUTH_OCCLUDED
static bool outside_frame(const camera_t camera, wide3_t whole)
{
    const real3 at = narrow3(whole);
    return !(at.z > 0 && at.x >= (real)-0.5 && at.x < camera.columns - (real)0.5 && at.y >= (real)-0.5 &&
             at.y < camera.frame_rows - (real)0.5);
}

// Whether a surface at inverse depth `seen` hides a point at inverse depth w here, w / ratio there.
static bool covered(wide_t seen, wide_t ratio, wide_t w)
{
    return wide_less(wide_mul(w, wide_add(widened(1), widened((real)1e-6))), wide_mul(seen, ratio));
}
#endif

// Ground truth of a strip at pixel centers, (rows, columns[, components]), never anti-aliased: depth mm (+inf:
// nothing), coc signed px (0: nothing), mask, object (-1: nothing), normal, flow px to the pose `next`, hidden (the
// point is not visible from the pinhole in the reference pose), sharp radiance; of a stereo pair disparity px and
// occluded (the point is not visible in the other view). `still` are the surfaces in the reference pose, `opposite`
// those in the frame of the other view, in poses `there`; to_left: 1 for the right view, -1 for the left one.
#if TRUTH
__kernel void ground_truth(const camera_t camera, __constant surface_t *surfaces, __constant surface_t *still,
                           __constant pose_t *next, const layer_t layer, __global const float *texture,
                           __global uchar *mask
#if TRUTH_OBJECT_ID
                           , __global int *object_id
#endif
#if TRUTH_DEPTH
                           , __global float *depth
#endif
#if TRUTH_BLUR_RADIUS
                           , __global float *coc
#endif
#if TRUTH_NORMAL
                           , __global float *normal
#endif
#if TRUTH_FLOW
                           , __global float *flow
#endif
#if TRUTH_HIDDEN
                           , __global uchar *hidden
#endif
#if TRUTH_SHARP
                           , __global float *sharp
#endif
#if TRUTH_DISPARITY || TRUTH_OCCLUDED
                           , __constant surface_t *opposite, __constant pose_t *there, const int to_left
#endif
#if TRUTH_DISPARITY
                           , __global float *disparity
#endif
#if TRUTH_OCCLUDED
                           , __global uchar *occluded
#endif
)
{
    const int column = get_global_id(0), row = camera.top + get_global_id(1);
    if (column >= camera.columns || row >= camera.top + camera.rows)
        return;
    const int at = (row - camera.top) * camera.columns + column;
    const wide3_t ray = pixel_ray(camera, widened(row), widened(column));
    uchar root;
    int object;
    const wide_t w = nearest_surface(surfaces, layer, ray, &root, &object);
    __constant surface_t *surface = surfaces + MAX(object, 0);
    mask[at] = root != 0;
#if TRUTH_OBJECT_ID
    object_id[at] = object;
#endif
#if TRUTH_DEPTH
    depth[at] = root ? (float)narrow(wide_div(widened(1), w)) : INFINITY;
#endif
#if TRUTH_BLUR_RADIUS
    coc[at] = root ? (float)narrow(blur_radius(camera, w)) : 0;
#endif
#if TRUTH_NORMAL
    const real3 n = root ? surface_normal(surface, ray, w) : (real3)(0, 0, 0);
    normal[3 * at] = (float)n.x;
    normal[3 * at + 1] = (float)n.y;
    normal[3 * at + 2] = (float)n.z;
#endif
#if TRUTH_FLOW
    const wide3_t later = moved_pixel(surface, camera, next + MAX(object, 0), ray, w);
    flow[2 * at] = root && narrow(later.z) > 0 ? (float)narrow(wide_sub(later.x, widened(column))) : 0;
    flow[2 * at + 1] = root && narrow(later.z) > 0 ? (float)narrow(wide_sub(later.y, widened(row))) : 0;
#endif
#if TRUTH_HIDDEN
    hidden[at] = 0;
    if (root) {
        const wide3_t from = rest_pixel(surface, camera, ray, w);
        // 1 / depth in the reference pose of this point, against the depth in that pixel of the pinhole image
        uchar other;
        const wide_t seen = solve_quadric(still + object, pixel_ray(camera, from.y, from.x), &other);
        hidden[at] = outside_frame(camera, from) || covered(seen, from.z, w);
    }
#endif
#if TRUTH_SHARP
    const wide3_t point = texture_point(surface, camera, ray, w, row, column);
    for (int c = 0; c < CHANNELS; ++c)
        sharp[at * CHANNELS + c] = root ? radiance(texture, surface, camera, c, point) : 0;
#endif
#if TRUTH_DISPARITY || TRUTH_OCCLUDED
    const wide3_t other = moved_pixel(surface, camera, there + MAX(object, 0), ray, w);
#endif
#if TRUTH_DISPARITY
    disparity[at] = root && narrow(other.z) > 0 ? (float)(to_left * narrow(wide_sub(other.x, widened(column)))) : 0;
#endif
#if TRUTH_OCCLUDED
    occluded[at] = 0;
    if (root) {
        uchar any;
        int nearest;
        const wide_t seen = nearest_surface(opposite, layer,
                                            pixel_ray(camera, other.y, other.x), &any, &nearest);
        occluded[at] = outside_frame(camera, other) || covered(seen, other.z, w);
    }
#endif
}
#endif
