/* The local estimate: sunlight that is scattered into a path at a collision or at the surface. */
#ifndef CLOUDTOMO_ESTIMATE_H
#define CLOUDTOMO_ESTIMATE_H

#include "walk/event.h"

typedef struct {
    float radiance;      /* sr^-1, for a sun of irradiance 1 */
    float removed;       /* radiance removed by truncation, sr^-1 */
    float optical_depth; /* up to which the shadow ray was followed; 0: there was none */
} LocalEstimate;

/* The ray from a position to the sun. */
inline Ray shadow_ray(const Medium *medium, const Ray *from)
{
    Ray ray = *from;
    ray.direction = sun_direction(medium->scene);
    return ray;
}

/* Radiance of the sunlight that reaches the ray's position: weight (sr^-1) times the
 * transmittance to the sun. With a threshold above 0 (sr^-1) a roulette ends shadow rays that
 * would contribute less, and keeps the mean. The radiance is limited to the scene's truncation. */
LARGE_FUNCTION LocalEstimate local_estimate(const Medium *medium, const Ray *at, float weight, float threshold, float u)
{
    LocalEstimate estimate = {0.0f, 0.0f, 0.0f};
    const float least = u * threshold;
    if (weight <= least)
        return estimate;
    Ray ray = shadow_ray(medium, at);
    estimate.optical_depth = threshold > 0.0f ? logarithm(weight / least) : INFINITY;
    const Flight flight = fly(medium, &ray, estimate.optical_depth);
    const float radiance = flight.collided ? 0.0f : greater(weight * exponential(-flight.depth), threshold);
    estimate.radiance = lesser(radiance, medium->scene->truncation);
    estimate.removed = radiance - estimate.radiance;
    return estimate;
}

/* Whether an estimate depends on the extinction on the way to the sun: not if it is 0 or truncated. */
inline bool depends_on_shadow_ray(const Medium *medium, const LocalEstimate *estimate)
{
    return estimate->radiance != 0.0f && estimate->radiance < medium->scene->truncation;
}

#endif
