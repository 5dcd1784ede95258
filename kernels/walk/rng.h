/* Uniform random numbers as a function of a sample's identity, not of the device or order of computation.
 *
 * Philox4x32-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3"),
 * key = (seed, stream), counter = (pixel, view, sample, block): every block of four
 * numbers has its own counter, so any range of samples can be computed anywhere, in any
 * order, with the same paths.
 */
#ifndef CLOUDTOMO_RNG_H
#define CLOUDTOMO_RNG_H

#include "walk/kept.h"
#include <pyopencl-random123/philox.cl>

typedef struct {
    uint seed;
    uint stream;
    uint pixel; /* row * width + column, within its view */
    uint view;
    uint sample;
} SampleKey;

inline SampleKey kept_key(const KEPT SampleKey *kept)
{
    const SampleKey key = {kept->seed, kept->stream, kept->pixel, kept->view, kept->sample};
    return key;
}

inline void keep_key(KEPT SampleKey *kept, const SampleKey *key)
{
    kept->seed = key->seed;
    kept->stream = key->stream;
    kept->pixel = key->pixel;
    kept->view = key->view;
    kept->sample = key->sample;
}

/* The key of a sample of a camera's pixel (view, row * width + column). */
inline SampleKey sample_key(uint seed, uint stream, uint2 pixel, uint sample)
{
    const SampleKey key = {seed, stream, pixel.y, pixel.x, sample};
    return key;
}

/* The view number of photons that start in the sun's view, for fluxes. */
#define SUN_VIEW 0xFFFFFFFFu
/* Other random numbers have view numbers that no camera has. For those that belong to a camera's path the number is
 * added to the camera's view number, which is smaller: a path's virtual collisions, the path from one of them, and
 * paths that find path lengths. Photons of the radiance table have one number, or two where they start with the light
 * of a path: one for that path, one for the photon. */
#define VIRTUAL_COLLISIONS_VIEW 0x80000000u
#define VIRTUAL_PATHS_VIEW 0x40000000u
#define PATH_LENGTHS_VIEW 0x20000000u
#define TABLE_PHOTONS_VIEW 0x10000000u
#define ARRIVING_VIEW 0x10000001u
#define ARRIVED_VIEW 0x10000002u
/* Of a path's branches, in the order in which they begin, each has this much more than the one before. */
#define BRANCH_VIEW 0x00100000u

/* Blocks of a path: block 0 places the ray in its pixel; event k = 1, 2, ... has the
 * BLOCKS_PER_EVENT blocks from k * BLOCKS_PER_EVENT on. Inside an event: */
#define BLOCKS_PER_EVENT 64u
#define BLOCK_EVENT 0u    /* free path, particle, scattering cosine, azimuth */
#define BLOCK_ROULETTE 1u /* local estimate, path, number of side flights, row of the phase table */
#define BLOCK_SIDE 2u     /* side flight n: blocks 2 + 2 n and 3 + 2 n */
#define BLOCK_BRANCH 63u  /* cosine, azimuth, roulette */

/* 32 random bits -> a float in the open interval (0, 1). (float)bits may round up to
 * 2^32, hence the clamp to the largest float below 1: -log(u) is never 0 nor infinite. */
inline float open_uniform(uint bits)
{
    const float scaled = ((float)bits + 0.5f) * 2.3283064365386963e-10f;
    return scaled < 0.99999994f ? scaled : 0.99999994f;
}

/* Philox4x32-10 as a loop: from unrolled rounds compilers for GPUs keep all keys, twenty numbers, in registers. */
inline philox4x32_ctr_t philox_rounds(philox4x32_ctr_t c, philox4x32_key_t k)
{
    const uint first = 0xD2511F53u, second = 0xCD9E8D57u; /* multipliers; below the keys' steps (Salmon et al.) */
#pragma unroll 1
    for (int round = 0; round < 10; ++round) {
        const uint4 before = (uint4)(c.v[0], c.v[1], c.v[2], c.v[3]);
        c.v[0] = mul_hi(second, before.z) ^ before.y ^ k.v[0];
        c.v[1] = second * before.z;
        c.v[2] = mul_hi(first, before.x) ^ before.w ^ k.v[1];
        c.v[3] = first * before.x;
        k.v[0] += 0x9E3779B9u;
        k.v[1] += 0xBB67AE85u;
    }
    return c;
}

inline float4 uniforms(const SampleKey *key, uint block)
{
    const philox4x32_key_t k = {{key->seed, key->stream}};
    const philox4x32_ctr_t c = {{key->pixel, key->view, key->sample, block}};
    const philox4x32_ctr_t r = KEEPS_LOOPS ? philox_rounds(c, k) : philox4x32(c, k);
    return (float4)(open_uniform(r.v[0]), open_uniform(r.v[1]), open_uniform(r.v[2]), open_uniform(r.v[3]));
}

/* The uniform numbers of an event of a path whose key is kept (kept.h). */
inline float4 event_uniforms(const KEPT SampleKey *key, uint event, uint block)
{
    const SampleKey own = kept_key(key);
    return uniforms(&own, event * BLOCKS_PER_EVENT + block);
}

#endif
