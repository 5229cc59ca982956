// Average of sub-frames, I(x) = sum_t L(x, t) of radiances that have the weight of their time sample in the exposure
// already. Twin: clsco/reference/blur/accumulate.py.
//
// The kernels of the blur add to `total` themselves; the host picks this one for scenes in focus, where nothing is
// blurred.

// In: value float (CHANNELS, height, width), already times the weight of its time sample. In and out: total, the
// frame's part, float (CHANNELS, rows, pitch) with `pad` columns before and after the frame's own.
__kernel void accumulate(const grid_t grid, __global const float *value, const int pitch, const int pad,
                         __global float *total)
{
    const int column = get_global_id(0), row = get_global_id(1);
    if (column >= grid.columns || row >= grid.rows)
        return;
    for (int k = 0; k < CHANNELS; ++k)
        total[(k * grid.rows + row) * pitch + column + pad] +=
            value[(k * grid.height + row + grid.above) * grid.width + column + grid.guard];
}
