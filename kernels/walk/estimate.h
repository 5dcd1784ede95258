/* The local estimate: sunlight that a collision, or the surface, sends along a path. */
#ifndef CLOUDTOMO_ESTIMATE_H
#define CLOUDTOMO_ESTIMATE_H

#include "walk/event.h"

typedef struct {
    float radiance;      /* sr^-1, for a sun of irradiance 1 */
    float removed;       /* by truncation, sr^-1 */
    float optical_depth; /* that the shadow ray was to be followed for; 0: it was not sent */
} LocalEstimate;

/* The ray from a position to the sun. */
inline Ray shadow_ray(const Medium *medium, const Ray *from)
{
    Ray ray = *from;
    ray.direction = sun_direction(medium->scene);
    return ray;
}

/* Radiance of the sunlight that reaches the ray's position: weight (sr^-1) times the
 * transmittance to the sun. A threshold above 0 (sr^-1) plays a roulette that ends shadow rays
 * which would contribute less; the mean is kept. Beyond the scene's truncation it is cut. */
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

/* Whether an estimate depends on the way to the sun: none that is 0, or was truncated. */
inline bool depends_on_shadow_ray(const Medium *medium, const LocalEstimate *estimate)
{
    return estimate->radiance != 0.0f && estimate->radiance < medium->scene->truncation;
}

#endif
