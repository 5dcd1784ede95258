/* Radiance by paths from the cameras (backward Monte Carlo): every interaction adds a local estimate of the
 * sunlight, and side flights add the local estimates of the next order of scattering. Paths may branch (branches.h).
 *
 * The including file defines, before it includes this, the struct `Tally` with at least
 *
 *   float radiance;   sum of the local estimates so far, sr^-1; starts as 0
 *   float own_share;  share of the path itself in the local estimate at its next collision; starts as 1
 *
 * and inline functions that are called with the pieces of a path:
 *
 *   Flight tally_fly(medium, Ray *ray, const Segment *segment, tally)
 *       as on_flight of path.h; tally->radiance is the sum before this flight
 *   void tally_segment(medium, const Segment *segment, const Flight *flight, Particle end, float share,
 *                      float local_radiance, tally)
 *       a flight of the path itself has ended, in `end` (PARTICLE_NONE: it left). `local_radiance` is the local
 *       estimate there (sr^-1), which tally->radiance already includes; at a collision it has been multiplied by
 *       the flight's `share`, and side flights have the rest. Called after tally_shadow_ray
 *   void tally_side_flight(medium, const Segment *segment, const Flight *flight, Particle end, float share,
 *                          float local_radiance, tally)
 *       the same for a side flight; its local estimate is not yet in tally->radiance. Called before tally_shadow_ray
 *   void tally_shadow_ray(medium, const Ray *from, const LocalEstimate *estimate, tally)
 *       a local estimate has been made
 *
 * and on_absorption, on_roulette and on_termination of path.h; where paths branch, what branches.h says. A tally that
 * flies a segment again, to deposit something in the voxels that it crosses, defines a traversal for that
 * (traversal.h).
 */
#ifndef CLOUDTOMO_RADIANCE_H
#define CLOUDTOMO_RADIANCE_H

#include "walk/branches.h"
#include "walk/camera.h"
#include "walk/companions.h"
#include "walk/estimate.h"

/* Threshold of the roulette on local estimates, sr^-1. Found by measurement: docs/explanation/radiance.md. */
#define LOCAL_ESTIMATE_ROULETTE 0.03f

/* Side flights: from a collision, flights in directions drawn around the sun estimate the
 * next order's sunlight. This is the one of number n. */
inline void side_flight(const Medium *medium, const KEPT Interaction *at, Companions companions, uint n,
                        const KEPT SampleKey *key, Tally *tally)
{
    const uint block = BLOCK_SIDE + 2u * n;
    const float4 v = event_uniforms(key, at->event, block);
    Ray ray = kept_ray(&at->ray);
    const float3 arriving = ray.direction;
    ray.direction = sample_around_sun(medium, v.zw);
    const Densities densities = densities_in(medium, at->particle, arriving, ray.direction, companions);
    if (!(densities.path > 0.0f))
        return;
    const float share = share_of_side_flight(densities);
    const float optical_depth = -logarithm(v.x);
    const Flight flight = fly(medium, &ray, optical_depth);
    Segment segment = {kept_ray(&at->ray), optical_depth, at->throughput, at->event + 1u};
    segment.start.direction = ray.direction;
    if (!flight.collided) {
        tally_side_flight(medium, &segment, &flight, PARTICLE_NONE, share, 0.0f, tally);
        return;
    }
    const float2 w = event_uniforms(key, at->event, block + 1u).xy;
    float albedo;
    const Particle end = choose_particle(medium, flight.droplets, flight.air, flight.index, v.y, w.y, &albedo);
    const float weight =
        at->throughput * albedo * share * scatter_density(medium, end, ray.direction, sun_direction(medium->scene));
    const LocalEstimate estimate = local_estimate(medium, &ray, weight, LOCAL_ESTIMATE_ROULETTE, w.x);
    tally_side_flight(medium, &segment, &flight, end, share, estimate.radiance, tally);
    tally_shadow_ray(medium, &ray, &estimate, tally);
    tally->radiance += estimate.radiance;
}

LARGE_FUNCTION void side_flights(const Medium *medium, const KEPT Interaction *at, Companions companions,
                                 const KEPT SampleKey *key, Tally *tally)
{
    const uint flights = (uint)(companions.side_flights + at->u_companions);
    for (uint n = 0; n < flights; ++n)
        side_flight(medium, at, companions, n, key, tally);
}

inline Flight on_flight(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    return tally_fly(medium, ray, segment, tally);
}

inline void on_leaving(const Medium *medium, const Segment *segment, const Flight *flight, const Ray *ray,
                       Termination termination, bool ends, Tally *tally)
{
    if (ends)
        tally_segment(medium, segment, flight, PARTICLE_NONE, tally->own_share, 0.0f, tally);
}

inline void on_interaction(const Medium *medium, const Segment *segment, const Flight *flight,
                           const KEPT Interaction *at, Tally *tally)
{
    const __constant Scene *scene = medium->scene;
    const bool on_surface = at->particle == PARTICLE_SURFACE;
    const float share = tally->own_share;
    const float weight = (on_surface ? 1.0f : share) * at->throughput
                         * scatter_density(medium, at->particle, kept_vector(&at->ray.direction), sun_direction(scene));
    /* The roulette must not add noise to light that a camera sees directly, nor to the ground. */
    const bool plays = scene->side_flights && at->event > 1u && !on_surface;
    RAY_OF(ray, &at->ray);
    const LocalEstimate estimate =
        local_estimate(medium, ray, weight, plays ? LOCAL_ESTIMATE_ROULETTE : 0.0f, at->u_estimate);
    RAY_OF(again, &at->ray);
    tally_shadow_ray(medium, again, &estimate, tally);
    tally->radiance += estimate.radiance;
    tally_segment(medium, segment, flight, at->particle, share, estimate.radiance, tally);
    tally->own_share = 1.0f;
}

inline void on_scattering(const Medium *medium, KEPT Interaction *at, const KEPT SampleKey *key, Tally *tally)
{
    const __constant Scene *scene = medium->scene;
    if (!scene->side_flights)
        return;
    const Companions companions = companions_of(scene, at, tally);
    side_flights(medium, at, companions, key, tally);
    const float3 arriving = kept_vector(&at->ray.direction);
    const Densities own = densities_in(medium, at->particle, arriving, kept_vector(&at->new_direction), companions);
    tally->own_share = share_beside_side_flights(own);
    branch_off(medium, at, companions, own, key, tally);
}

#include "walk/path.h"

#endif
