// Texture across holes: frequency-selective extrapolation (clsco/inpainting/fse.py has the method and its sources). A
// work-item fills a block of FSE_BLOCK x FSE_BLOCK px from the window of FSE_SIDE x FSE_SIDE px around it, which begins
// FSE_BEFORE px before the block: the window's weighted spectrum is decomposed into waves, the strongest first. On a
// processor the arrays stay in the first-level cache. Twin: clsco/reference/inpainting/fse.py.

#include "common/geometry.clh"
#include "inpainting/lanes.clh"

#define HALF (FSE_SIDE / 2)
#define PIXELS (FSE_BLOCK * FSE_BLOCK)
#define PITCH (FSE_SIDE + HALF)  // columns -HALF to FSE_SIDE - 1 of a spectrum, so that shifted ones are contiguous

// Contraction changes no bit from run to run, and halves the time of the loops below.
#pragma OPENCL FP_CONTRACT ON

#define TABLE(p) LOAD(float, 8, p)

// Spectrum (FSE_SIDE, HALF) of a real window (FSE_SIDE, FSE_SIDE), columns 0 to HALF - 1, and column HALF as `middle`.
// cosines, sines: (FSE_SIDE, HALF) of 2 pi a v / FSE_SIDE.
static void transform(const float *window, __global const float *cosines, __global const float *sines, float *re,
                      float *im, float *middle_re, float *middle_im) {
    float row_re[FSE_SIDE * HALF], row_im[FSE_SIDE * HALF], middle[FSE_SIDE];
    for (int i = 0; i < FSE_SIDE; ++i) {
        float8 re_low = 0, re_high = 0, im_low = 0, im_high = 0;
        float alternating = 0;
        for (int j = 0; j < FSE_SIDE; j += 2) {
            for (int odd = 0; odd < 2; ++odd) {
                const float8 g = window[i * FSE_SIDE + j + odd];
                __global const float *c = cosines + (j + odd) * HALF, *s = sines + (j + odd) * HALF;
                re_low += g * TABLE(c);
                re_high += g * TABLE(c + FILL_LANES);
                im_low -= g * TABLE(s);
                im_high -= g * TABLE(s + FILL_LANES);
            }
            alternating += window[i * FSE_SIDE + j] - window[i * FSE_SIDE + j + 1];
        }
        STORE_PRIVATE(re_low, row_re + i * HALF);
        STORE_PRIVATE(re_high, row_re + i * HALF + FILL_LANES);
        STORE_PRIVATE(im_low, row_im + i * HALF);
        STORE_PRIVATE(im_high, row_im + i * HALF + FILL_LANES);
        middle[i] = alternating;
    }
    // Rows a and a + HALF: the sum of the even terms, plus and minus that of the odd ones.
    for (int a = 0; a < HALF; ++a) {
        for (int h = 0; h < HALF; h += FILL_LANES) {
            float8 sum_re[2] = {0, 0}, sum_im[2] = {0, 0};
            for (int i = 0; i < FSE_SIDE; i += 2)
                for (int odd = 0; odd < 2; ++odd) {
                    const float c = cosines[(i + odd) * HALF + a], s = sines[(i + odd) * HALF + a];
                    const float8 g_re = LOAD_PRIVATE(row_re + (i + odd) * HALF + h);
                    const float8 g_im = LOAD_PRIVATE(row_im + (i + odd) * HALF + h);
                    sum_re[odd] += g_re * c + g_im * s;
                    sum_im[odd] += g_im * c - g_re * s;
                }
            STORE_PRIVATE(sum_re[0] + sum_re[1], re + a * HALF + h);
            STORE_PRIVATE(sum_im[0] + sum_im[1], im + a * HALF + h);
            STORE_PRIVATE(sum_re[0] - sum_re[1], re + (a + HALF) * HALF + h);
            STORE_PRIVATE(sum_im[0] - sum_im[1], im + (a + HALF) * HALF + h);
        }
        float even_re = 0, even_im = 0, odd_re = 0, odd_im = 0;
        for (int i = 0; i < FSE_SIDE; i += 2) {
            even_re += middle[i] * cosines[i * HALF + a];
            even_im -= middle[i] * sines[i * HALF + a];
            odd_re += middle[i + 1] * cosines[(i + 1) * HALF + a];
            odd_im -= middle[i + 1] * sines[(i + 1) * HALF + a];
        }
        middle_re[a] = even_re + odd_re;
        middle_im[a] = even_im + odd_im;
        middle_re[a + HALF] = even_re - odd_re;
        middle_im[a + HALF] = even_im - odd_im;
    }
}

// The same spectrum with its columns -HALF to FSE_SIDE - 1, (FSE_SIDE, PITCH): that of a real window is its own mirror.
static void unfold(const float *re, const float *im, const float *middle_re, const float *middle_im, float *all_re,
                   float *all_im) {
    for (int a = 0; a < FSE_SIDE; ++a) {
        const int mirror = (FSE_SIDE - a) % FSE_SIDE;
        for (int k = 0; k < PITCH; ++k) {
            const int v = k % FSE_SIDE < HALF ? HALF - k % FSE_SIDE : k % FSE_SIDE - HALF;  // |column|, at most HALF
            const int negative = k % FSE_SIDE < HALF && v < HALF;
            const int row = negative ? mirror : a;
            const float x = v == HALF ? middle_re[row] : re[row * HALF + v];
            const float y = v == HALF ? middle_im[row] : im[row * HALF + v];
            all_re[a * PITCH + k] = x;
            all_im[a * PITCH + k] = negative ? -y : y;
        }
    }
}

// Computes the values of the blocks of a list, filled (count, PIXELS, CHANNELS).
// In: value (rows, columns, CHANNELS), about 0 to 1, and its weight (rows, columns), 0 if unknown; window (FSE_SIDE,
// FSE_SIDE), factor of a value's weight by its place; preference (FSE_SIDE, HALF), factor of a wave's energy, 0 for
// waves that are others' mirrors; cosines, sines: see transform; list (count, 2), row and column of the blocks' first
// pixels. step: part of a wave's amplitude that is taken at a time; waves_per_contrast: waves per standard deviation,
// at least `fewest` and at most `most`.
__kernel void extrapolate_blocks(const int rows, const int columns, __global const float *value,
                                 __global const float *weight, __global const float *window,
                                 __global const float *preference, __global const float *cosines,
                                 __global const float *sines, __global const int2 *list, const int count,
                                 const float step, const float waves_per_contrast, const int fewest, const int most,
                                 __global float *filled) {
    const int entry = get_global_id(0);
    if (entry >= count)
        return;
    const int top = list[entry].x - FSE_BEFORE, left = list[entry].y - FSE_BEFORE;

    // What is in the window, and how much it varies.
    float weights[FSE_SIDE * FSE_SIDE], weighted[CHANNELS * FSE_SIDE * FSE_SIDE];
    float sums[CHANNELS] = {0}, squares[CHANNELS] = {0}, total = 0;
    for (int i = 0; i < FSE_SIDE; ++i)
        for (int j = 0; j < FSE_SIDE; ++j) {
            const int y = top + i, x = left + j, k = i * FSE_SIDE + j;
            const bool inside = y >= 0 && y < rows && x >= 0 && x < columns;
            const int at = inside ? y * columns + x : 0;
            const float w = inside ? weight[at] * window[k] : 0;
            weights[k] = w;
            total += w;
            for (int c = 0; c < CHANNELS; ++c) {
                const float f = value[at * CHANNELS + c], wf = w * f;
                weighted[c * FSE_SIDE * FSE_SIDE + k] = wf;
                sums[c] += wf;
                squares[c] += wf * f;
            }
        }
    float variance = 0;
    for (int c = 0; c < CHANNELS; ++c) {
        const float mean = sums[c] / total;
        variance = MAX(variance, squares[c] / total - mean * mean);
    }
    const int waves = MIN(MAX((int)(waves_per_contrast * sqrt(variance) + 0.5f), fewest), most);

    float W_re[FSE_SIDE * PITCH], W_im[FSE_SIDE * PITCH], middle_re[FSE_SIDE], middle_im[FSE_SIDE];
    float R_re[CHANNELS * FSE_SIDE * HALF], R_im[CHANNELS * FSE_SIDE * HALF];
    transform(weights, cosines, sines, R_re, R_im, middle_re, middle_im);
    unfold(R_re, R_im, middle_re, middle_im, W_re, W_im);
    for (int c = 0; c < CHANNELS; ++c)
        transform(weighted + c * FSE_SIDE * FSE_SIDE, cosines, sines, R_re + c * FSE_SIDE * HALF,
                  R_im + c * FSE_SIDE * HALF, middle_re, middle_im);

    float block[CHANNELS * PIXELS] = {0}, q_re[CHANNELS] = {0}, q_im[CHANNELS] = {0};
    int u = 0, v = 0;
    for (int wave = 0; wave < waves; ++wave) {
        // Subtract the wave (u, v) and its mirror from the residual, and find the strongest that is left.
        float8 strongest = -1;
        int8 where = 0;
        for (int a = 0; a < FSE_SIDE; ++a) {
            const int one = ((a - u) & (FSE_SIDE - 1)) * PITCH + HALF - v;
            const int other = ((a + u) & (FSE_SIDE - 1)) * PITCH + HALF + v;
            for (int h = 0; h < HALF; h += FILL_LANES) {
                const float8 one_re = LOAD_PRIVATE(W_re + one + h), one_im = LOAD_PRIVATE(W_im + one + h);
                const float8 other_re = LOAD_PRIVATE(W_re + other + h), other_im = LOAD_PRIVATE(W_im + other + h);
                const float8 sum_re = one_re + other_re, sum_im = one_im + other_im;
                const float8 difference_re = one_re - other_re, difference_im = one_im - other_im;
                float8 energy = 0;
                for (int c = 0; c < CHANNELS; ++c) {
                    float *r = R_re + c * FSE_SIDE * HALF + a * HALF + h;
                    float *i = R_im + c * FSE_SIDE * HALF + a * HALF + h;
                    const float8 left_re = LOAD_PRIVATE(r) - q_re[c] * sum_re + q_im[c] * difference_im;
                    const float8 left_im = LOAD_PRIVATE(i) - q_re[c] * sum_im - q_im[c] * difference_re;
                    STORE_PRIVATE(left_re, r);
                    STORE_PRIVATE(left_im, i);
                    energy += left_re * left_re + left_im * left_im;
                }
                energy *= TABLE(preference + a * HALF + h);
                const int8 stronger = energy > strongest;
                strongest = stronger ? energy : strongest;
                where = stronger ? (int8)(a * HALF + h) : where;
            }
        }
        // Of equally strong ones the first.
        const float *energies = (const float *)&strongest;
        const int *places = (const int *)&where;
        int lane = 0;
        for (int k = 1; k < FILL_LANES; ++k)
            if (energies[k] > energies[lane] ||
                (energies[k] == energies[lane] && places[k] + k < places[lane] + lane))
                lane = k;
        const int best = places[lane] + lane;
        u = best / HALF;
        v = best % HALF;
        const float part = (best ? step : 0.5f * step) / total;  // the constant is its own mirror
        for (int c = 0; c < CHANNELS; ++c) {
            q_re[c] = part * R_re[c * FSE_SIDE * HALF + best];
            q_im[c] = part * R_im[c * FSE_SIDE * HALF + best];
        }
        for (int k = 0; k < PIXELS; ++k) {
            const int phase = (u * (FSE_BEFORE + k / FSE_BLOCK) + v * (FSE_BEFORE + k % FSE_BLOCK)) & (FSE_SIDE - 1);
            for (int c = 0; c < CHANNELS; ++c)
                block[k * CHANNELS + c] +=
                    2 * (q_re[c] * cosines[phase * HALF + 1] - q_im[c] * sines[phase * HALF + 1]);
        }
    }
    for (int k = 0; k < CHANNELS * PIXELS; ++k)
        filled[entry * CHANNELS * PIXELS + k] = block[k];
}

// Copies the values of the blocks of a list, filled (count, PIXELS, CHANNELS), to pixels that are not known, and sets
// their weight to `trust`. In and out: value (rows, columns, CHANNELS), weight (rows, columns), 1 where known.
__kernel void settle_blocks(const int rows, const int columns, __global const float *filled, __global const int2 *list,
                            const int count, const float trust, __global float *value, __global float *weight) {
    const int entry = get_global_id(0);
    if (entry >= count)
        return;
    for (int k = 0; k < PIXELS; ++k) {
        const int y = list[entry].x + k / FSE_BLOCK, x = list[entry].y + k % FSE_BLOCK;
        if (y >= rows || x >= columns || weight[y * columns + x] == 1)
            continue;
        for (int c = 0; c < CHANNELS; ++c)
            value[(y * columns + x) * CHANNELS + c] = filled[(entry * PIXELS + k) * CHANNELS + c];
        weight[y * columns + x] = trust;
    }
}

#pragma OPENCL FP_CONTRACT OFF
