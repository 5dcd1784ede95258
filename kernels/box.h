/* Starts of photons on the faces of a box around the cloud, for light that enters from outside. */
#ifndef CLOUDTOMO_BOX_H
#define CLOUDTOMO_BOX_H

#include "walk/medium.h"
#include "walk/rng.h"

/* A ray that enters the box: its origin is uniform over all faces, its direction has the density cosine / pi around the
 * face's normal. `box` has the lower and the upper corner, voxel units. */
inline Ray ray_into_box(const __constant Scene *scene, const __global float *box, const SampleKey *key)
{
    const float4 u = uniforms(key, 0u), v = uniforms(key, 1u);
    const float3 lower = vload3(0, box), upper = vload3(1, box), size = (upper - lower) * grid_spacing(scene);
    const float3 area = (float3)(size.y * size.z, size.z * size.x, size.x * size.y);
    const float chosen = u.x * (area.x + area.y + area.z);
    const bool x = chosen < area.x, y = !x && chosen < area.x + area.y, z = !x && !y, below = u.y < 0.5f;
    const float3 within_face = (float3)(x ? 0.0f : u.z, y ? 0.0f : x ? u.z : u.w, z ? 0.0f : u.w);
    const float3 opposite = (float3)(x && !below, y && !below, z && !below);
    const float3 normal = (float3)(x, y, z) * (below ? 1.0f : -1.0f);
    Ray ray;
    ray.position = lower + (within_face + opposite) * (upper - lower);
    ray.direction = direction_around(normal, square_root(v.x), v.y);
    ray.voxel = (int3)(0);
    ray.inside = false;
    return ray;
}

#endif
