// An image sensor: the codes that its pixels give for the light of an exposure, by the linear model of EMVA 1288. Twin:
// clsco/reference/sensor/sensor.py. Host: clsco/passes/sensor.py, for scenes with a sensor.
//
//     mean = (1 + prnu z1) scale_c L + dark + leak,    e = min(Poisson(mean), full_well)
//     code = floor(gain (e + dsnu z2 + read_noise z3) + black + 1/2), within 0 .. largest
//
// with z of the standard normal distribution. Random numbers depend on (seed; pixel, noise_seed, frame, stream)
// alone, so that neither strips, work-groups nor the order matter. A work-item has SENSED_PIXELS of a row.

#include "common/geometry.clh"
#include "sensor/noise.clh"

// Vector of the first n floats at p, and 0 in further lanes.
static inline float16 first_lanes(__global const float *p, int n) {
    if (n >= NOISE_LANES)
        return LOAD(float, 16, p);
    float16 v = 0.0f;
    for (int i = 0; i < n; ++i)
        ((float *)&v)[i] = p[i];
    return v;
}

// Reads out a plane, in the layout of accumulate.cl, from row `top` of the frame on; camera: twice the number of the
// frame, plus 1 for a right eye. Out: code (planes, rows, padded), and saturated, 1 where the full well or the largest
// code was reached. padded: columns rounded up to whole vectors, all of which are written.
__kernel void sense(const int rows, const int columns, const int top, const int padded, const uint camera,
                    __global const float *restrict plane, const int apart, const int start, const int pitch,
                    const sensor_t sensor, __global const float *restrict reciprocals,
                    __global ushort *restrict code, __global uchar *restrict saturated) {
    const int first = get_global_id(0) * SENSED_PIXELS, row = get_global_id(1), k = get_global_id(2);
    if (first >= columns || row >= rows || k >= sensor.planes)
        return;
    const uint16 lane = (uint16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    const int16 odd = (lane & 1u) != 0u;
    const int site = 4 * k + 2 * ((top + row) & 1), even = sensor.channel[site], other = sensor.channel[site + 1];
    const float16 scale = odd ? (float16)sensor.scale[site + 1] : (float16)sensor.scale[site];
    const uint2 key = (uint2)(sensor.seed_low, sensor.seed_high);
    __global const float *restrict own = plane + start + row * pitch;
    const uint begin = (uint)(top + row) * (uint)columns;
    const int last = MIN(first + SENSED_PIXELS, columns);
    for (int x = first; x < last; x += NOISE_LANES) {
        float16 light = first_lanes(own + even * apart + x, columns - x);
        if (even != other)
            light = odd ? first_lanes(own + other * apart + x, columns - x) : light;
        float16 mean = light > 0.0f ? light * scale : 0.0f;  // neither negative light nor NaN
        const uint16 pixel = lane + (begin + (uint)x);
        uint16 word[4];
        float16 dark = sensor.dark, added = 0.0f;
#if FIXED_PATTERN
        philox(pixel, 0u, camera & 1u, PATTERN_STREAM + STREAMS * k, key, word);
        const float16 response = 1.0f + sensor.prnu * normal_of(word[0]);
        mean = response > 0.0f ? mean * response : 0.0f;
        added = sensor.dsnu * normal_of(word[1]);
        dark = word[2] < sensor.hot ? dark + sensor.leak * uniform_of(word[3]) : dark;
#endif
        mean = mean + dark;
        mean = mean < sensor.most ? mean : sensor.most;
        philox(pixel, sensor.noise_low, camera, sensor.noise_high | (SHOT_STREAM + STREAMS * k), key, word);
        const float16 count = CONVERT16(float, poisson(mean, word[0], reciprocals));
        const int16 full = count >= sensor.full_well;
        added = added + sensor.read_noise * normal_of(word[1]);
        float16 level = sensor.gain * ((full ? (float16)sensor.full_well : count) + added) + (sensor.black + 0.5f);
        level = level > 0.0f ? level : 0.0f;
        const int16 codes = CONVERT16(int, level < sensor.largest ? level : sensor.largest);
        const int at = (k * rows + row) * padded + x;
        STORE(ushort, 16, CONVERT16(ushort, codes), code + at);
        const int16 most = full | (codes >= sensor.maximum);
        STORE(uchar, 16, CONVERT16(uchar, most & 1), saturated + at);
    }
}
