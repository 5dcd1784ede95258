/* Sensors: the ray of a sample.
 *
 * One formula serves every projection whose rays' origins and directions are affine in the image
 * coordinates (perspective: fixed origin; orthographic: fixed direction; push-broom: the
 * origin moves with v, the direction fans out with u). Image coordinates (u, v) run over
 * [0, 1]^2 from the upper left corner, u to the right and v down. Any other sensor is a list
 * of rays, one for each pixel. */
#ifndef CLOUDTOMO_CAMERA_H
#define CLOUDTOMO_CAMERA_H

#include "walk/rng.h"
#include "walk/grid.h"

inline float3 affine(const __global float *coefficients, float u, float v)
{
    return (float3)(coefficients[0] + u * coefficients[3] + v * coefficients[6],
                    coefficients[1] + u * coefficients[4] + v * coefficients[7],
                    coefficients[2] + u * coefficients[5] + v * coefficients[8]);
}

#define FLOATS_PER_RAY 6 /* origin, km from the domain's lower corner; direction */

/* The ray of a sample: through a random point of its pixel, or its pixel's ray in the list `rays`. */
inline Ray camera_ray(const __constant Scene *scene, const __global View *view, const __global float *rays,
                      const SampleKey *key)
{
    Ray ray;
    ray.voxel = (int3)(0);
    ray.inside = false;
    if (view->first_ray >= 0) {
        const __global float *given = rays + FLOATS_PER_RAY * ((size_t)view->first_ray + key->pixel);
        ray.position = vload3(0, given) / grid_spacing(scene);
        ray.direction = unit_vector(vload3(1, given));
        return ray;
    }
    const float4 jitter = uniforms(key, 0u);
    const float u = ((float)(key->pixel % (uint)view->width) + jitter.x) / (float)view->width;
    const float v = ((float)(key->pixel / (uint)view->width) + jitter.y) / (float)view->height;
    ray.position = affine(view->origin, u, v) / grid_spacing(scene);
    ray.direction = unit_vector(affine(view->direction, u, v));
    return ray;
}

/* The number of the path that a work item walks. Neighbours in a work group walk paths of the same pixel, which go
 * through the same voxels, and all end early where there is no cloud. */
inline uint path_of_item(uint item, uint pixel_count, uint path_count)
{
    const uint samples = path_count / pixel_count;
    return item % samples * pixel_count + item / samples;
}

#endif
