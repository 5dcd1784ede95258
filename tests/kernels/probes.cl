/* Every function of the kernel headers behind a kernel of its own: one work item, one call. */
#include "walk/accumulate.h"
#include "walk/camera.h"
#include "walk/flight.h"

#define PROBE(count) \
    const size_t i = get_global_id(0); \
    if (i >= (count)) \
    return

/* Keys: seed, iteration, pixel, view, sample, block. */
__kernel void probe_uniforms(const uint count, const __global uint *keys, __global float *result)
{
    PROBE(count);
    const __global uint *k = keys + 6 * i;
    const SampleKey key = {k[0], k[1], k[2], k[3], k[4]};
    vstore4(uniforms(&key, k[5]), i, result);
}

__kernel void probe_open_uniform(const uint count, const __global uint *bits, __global float *result)
{
    PROBE(count);
    result[i] = open_uniform(bits[i]);
}

/* The logarithm, square root and exponential (of what is not above 0), cosine and sine of a turn. */
__kernel void probe_arithmetic(const uint count, const __global float *positive, const __global float *negative,
                               const __global float *turn, __global float *logarithms, __global float *roots,
                               __global float *cube_roots, __global float *exponentials, __global float *cosines,
                               __global float *sines, __global float *turns)
{
    PROBE(count);
    logarithms[i] = logarithm(positive[i]);
    roots[i] = square_root(positive[i]);
    cube_roots[i] = cube_root(positive[i]);
    exponentials[i] = exponential(negative[i]);
    const float2 both = cosine_and_sine_of_turn(turn[i]);
    cosines[i] = both.x;
    sines[i] = both.y;
    turns[i] = turn_of(positive[i] * both.x, positive[i] * both.y);
}

/* Henyey-Greenstein and Rayleigh at a cosine; cosines drawn from both with a uniform number. */
__kernel void probe_phase(const uint count, const float g, const __global float *cosine, const __global float *u,
                          __global float *result)
{
    PROBE(count);
    vstore4((float4)(henyey_greenstein(cosine[i], g), rayleigh(cosine[i]), sample_henyey_greenstein(u[i], g),
                     sample_rayleigh(u[i])),
            i, result);
}

__kernel void probe_direction_around(const uint count, const __global float *axis, const __global float *cosine,
                                     const __global float *u, __global float *result)
{
    PROBE(count);
    vstore3(direction_around(vload3(i, axis), cosine[i], u[i]), i, result);
}

/* A scattered direction, and its density. */
__kernel void probe_scatter(const uint count, __constant Scene *scene, const __global float *profiles,
                            const int particle, const __global float *from, const __global float *u,
                            __global float *result)
{
    PROBE(count);
    const float3 before = vload3(i, from);
    const Medium medium = make_medium(scene, 0, 0, 0, profiles);
    const float3 after = sample_scatter(&medium, particle, before, vload2(i, u));
    vstore4((float4)(after, scatter_density(&medium, particle, before, after)), i, result);
}

inline Ray probe_ray(const __global float *position, const __global float *direction, size_t i)
{
    Ray ray;
    ray.position = vload3(i, position); /* voxel units */
    ray.direction = vload3(i, direction);
    ray.voxel = (int3)(0);
    ray.inside = false;
    return ray;
}

/* Lengths of a ray's crossings, km: the voxels' indices and lengths in their order. */
__kernel void probe_crossings(const uint count, __constant Scene *scene, const __global float *position,
                              const __global float *direction, const uint most, __global int *voxel,
                              __global float *length, __global uint *number)
{
    PROBE(count);
    Ray ray = probe_ray(position, direction, i);
    uint n = 0;
    float distance;
    if (enter_domain(scene, &ray, &distance)) {
        VoxelWalk walk = walk_begin(scene, &ray);
        float exit;
        do {
            exit = walk_exit(&walk);
            if (n < most) {
                voxel[most * i + n] = walk.index;
                length[most * i + n] = exit - walk.distance;
            }
            ++n;
        } while (n < most && walk_advance(scene, &walk, exit));
    }
    number[i] = n;
}

/* A flight: optical depth, whether it collided, and where it ended (km from the domain's corner). */
__kernel void probe_fly(const uint count, __constant Scene *scene, const __global float *extinction,
                        const __global float *profiles, const __global float *position, const __global float *direction,
                        const __global float *optical_depth, __global float *result)
{
    PROBE(count);
    const Medium medium = make_medium(scene, extinction, 0, 0, profiles);
    Ray ray = probe_ray(position, direction, i);
    const Flight flight = fly(&medium, &ray, optical_depth[i]);
    const float3 end = ray.position * grid_spacing(scene);
    vstore8((float8)(flight.depth, flight.collided, flight.droplets, flight.air, (float)flight.index, end), i, result);
}

__kernel void probe_camera(const uint count, __constant Scene *scene, const __global View *view,
                           const __global float *rays, const uint seed, const uint sample, __global float *position,
                           __global float *direction)
{
    PROBE(count);
    const SampleKey key = {seed, 0u, (uint)i, 0u, sample};
    const Ray ray = camera_ray(scene, view, rays, &key);
    vstore3(ray.position * grid_spacing(scene), i, position);
    vstore3(ray.direction, i, direction);
}

__kernel void probe_accumulate(const uint count, const uint sums, const __global float *value,
                               volatile __global Accumulator *sum)
{
    PROBE(count);
    accumulate(sum + i % sums, value[i]);
}

/* Adds `terms` times the same value, one after the other. */
__kernel void probe_compensated(const uint count, const uint terms, const __global float *value, __global float *result)
{
    PROBE(count);
    float sum = result[2 * i], low = result[2 * i + 1];
    for (uint n = 0; n < terms; ++n)
        add_compensated(&sum, &low, value[i]);
    vstore2((float2)(sum, low), i, result);
}
