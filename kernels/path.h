/* The random walk.
 *
 * One piece of code serves rendering, replay and fluxes. Rendered, a path starts in a camera and
 * every interaction adds a local estimate of the sunlight (backward Monte Carlo). Compiled with
 * CLOUDTOMO_REPLAY, the same path is walked again with the same random numbers, its total
 * radiance known, and every crossing and collision deposits its share of the gradient: a crossing
 * of voxel v over l km on the way to radiance R adds -l R, a collision with a droplet there adds
 * R / extinction (the supplement's Eqs. 13, 17, 18 with sums swapped; path replay, Vicini et al.
 * 2021). CLOUDTOMO_FIELD does so in another way: field.cl. Compiled with CLOUDTOMO_FLUX, the path is a photon that starts in the sun; no local
 * estimates are made, and what it leaves behind is tallied by column.
 *
 * Radiances inside a path are for a sun of irradiance 1; the host scales them.
 */
#ifndef CLOUDTOMO_PATH_H
#define CLOUDTOMO_PATH_H

#include "rng.h"
#include "camera.h"
#ifdef CLOUDTOMO_FIELD
#include "phase.h"
#include "directions.h"
#endif
#include "flight.h"

/* The path that a work item walks: neighbours in a work group walk paths of the same pixel, which go through
 * the same voxels, and end early all together where there is no cloud. */
inline uint path_of_item(uint item, uint pixel_count, uint path_count)
{
    const uint samples = path_count / pixel_count;
    return item % samples * pixel_count + item / samples;
}

/* Paths lighter than this are continued with probability weight / PATH_ROULETTE_WEIGHT. */
#define PATH_ROULETTE_WEIGHT 0.1f
/* Share of its radiance by which a path walked again may differ: rounding. */
#define REPLAY_TOLERANCE 1e-4f
/* Side flights aimed at the sun: expected number per unit of weight x phase function (sr),
 * its bounds, and the threshold of the roulette on local estimates (sr^-1). Found by
 * measurement: docs/explanation/radiance.md. */
#define SIDE_FLIGHT_RATE 6.0f
#define SIDE_FLIGHT_LEAST 0.05f
#define SIDE_FLIGHT_MOST 6.0f
#define LOCAL_ESTIMATE_ROULETTE 0.03f

#ifndef CLOUDTOMO_FLUX
/* Radiance of the sunlight that reaches the ray's position: weight (sr^-1) times the
 * transmittance to the sun. A threshold above 0 (sr^-1) plays a roulette that ends walks
 * which would bring less; the mean is kept. Beyond the scene's truncation it is cut. */
static float local_estimate(const Medium *medium, const Ray *at, float weight, float threshold, float u,
                            Record *record)
{
    const float least = u * threshold;
    if (weight <= least)
        return 0.0f;
    Ray ray = *at;
    ray.direction = sun_direction(medium->scene);
    const float reach = threshold > 0.0f ? logarithm(weight / least) : INFINITY;
    const Flight flight = fly(medium, &ray, reach, nothing_carried(), record);
    const float radiance = flight.collided ? 0.0f : greater(weight * exponential(-flight.depth), threshold);
    const float kept = lesser(radiance, medium->scene->truncation);
    record->removed += radiance - kept;
    return kept;
}

/* Where derivatives are wanted: deposits the crossings of the way to the sun. A truncated radiance
 * does not depend on them. */
inline void deposit_local_estimate(const Medium *medium, const Ray *at, float radiance, Record *record)
{
#if defined(CLOUDTOMO_REPLAY) || defined(CLOUDTOMO_FIELD)
    if (radiance == 0.0f || radiance >= medium->scene->truncation)
        return;
    Ray ray = *at;
    ray.direction = sun_direction(medium->scene);
    fly(medium, &ray, INFINITY, carried_to_sun(radiance), record);
#endif
}

/* Side flights: from a collision, flights in directions drawn around the sun estimate the
 * next order's sunlight, combined with the path's own next collision by the balance heuristic
 * (Veach and Guibas 1995); they take the load of the rare, huge local estimates that a
 * forward peak gives. `count` is their expected number. */
static void side_flights(const Medium *medium, const Ray *at, Particle particle, float weight, float count,
                         const SampleKey *key, uint event, float u, Record *record)
{
    const float3 sun = sun_direction(medium->scene);
    const uint flights = (uint)(count + u);
    for (uint n = 0; n < flights; ++n) {
        const uint block = event * BLOCKS_PER_EVENT + BLOCK_SIDE + 2u * n;
        const float4 v = uniforms(key, block);
        const float2 w = uniforms(key, block + 1u).xy;
        Ray ray = *at;
        ray.direction = sample_around_sun(medium, v.zw);
        const float density = scatter_density(medium, particle, at->direction, ray.direction);
        if (!(density > 0.0f))
            continue;
        const Ray start = ray;
        const float reach = -logarithm(v.x);
        const float share = density / (density + count * sun_density(medium, ray.direction));
#ifdef CLOUDTOMO_FIELD
        Ray crossing = start;
        Carried carried = nothing_carried();
        carried.importance = weight * share;
        carried.sun_density = sun_density(medium, ray.direction);
        carried.bin = direction_bin(ray.direction);
        fly(medium, &crossing, reach, carried, record);
#endif
        const Flight flight = fly(medium, &ray, reach, nothing_carried(), record);
        if (!flight.collided)
            continue;
        float albedo;
        const Particle target = choose_particle(medium, flight.droplets, flight.air, flight.index, v.y, w.y, &albedo);
        const float estimate = weight * albedo * share * scatter_density(medium, target, ray.direction, sun);
        const float radiance = local_estimate(medium, &ray, estimate, LOCAL_ESTIMATE_ROULETTE, w.x, record);
#ifdef CLOUDTOMO_REPLAY
        if (radiance > 0.0f) {
            Ray again = start;
            fly(medium, &again, reach, radiance, record);
            if (target >= 0)
                deposit_collision(record, flight.index, flight.droplets, radiance);
        }
#endif
        deposit_local_estimate(medium, &ray, radiance, record);
        record->radiance += radiance;
    }
}
#endif

/* If the ray, outside of the domain, goes down to the surface: moves it there. */
inline bool reach_surface(const __constant Scene *scene, Ray *ray)
{
    if (scene->surface_albedo <= 0.0f || !(ray->direction.z < 0.0f) || ray->inside)
        return false;
    const float3 spacing = grid_spacing(scene);
    const float height = ray->position.z * spacing.z + scene->base_height; /* km above ground */
    ray->position += greater(height, 0.0f) / -ray->direction.z * ray->direction / spacing;
    ray->position.z = -scene->base_height / spacing.z;
    return true;
}

/* How a path ended that met nothing any more. */
inline Fate fate_of(const __constant Scene *scene, const Record *record, const Ray *ray, const Flight *flight)
{
    if (record->lost)
        return FATE_LOST;
    if (!scene->periodic && (flight->through_side || !flight->met_grid))
        return flight->met_grid ? FATE_SIDES : FATE_MISSED;
    return ray->direction.z > 0.0f ? FATE_TOP : FATE_BOTTOM;
}

#if defined(CLOUDTOMO_REPLAY) || defined(CLOUDTOMO_FIELD)
/* A path that is walked again brings what it brought. If not, what it deposited is wrong: the device
 * computes wrongly, or has ended a loop before its time. */
inline void check_replay(const Record *record, volatile __global uint *astray)
{
    if (!(magnitude(record->radiance - record->total) <= REPLAY_TOLERANCE * record->total))
        atomic_inc(astray);
}
#endif

/* Walks the whole path from its first ray; record->radiance ends as its total. */
inline void trace_path(const Medium *medium, Ray ray, const SampleKey *key, Record *record)
{
    const __constant Scene *scene = medium->scene;
    const float3 sun = sun_direction(scene);
    float weight = 1.0f;      /* product of single-scattering albedos, over survival */
    float own_share = 1.0f;   /* the path's part in its next collision's estimate */
    for (uint event = 1u;; ++event) {
        count_event(record, event);
        const float4 u = uniforms(key, event * BLOCKS_PER_EVENT + BLOCK_EVENT);
        const float4 v = uniforms(key, event * BLOCKS_PER_EVENT + BLOCK_ROULETTE);
        const float reach = -logarithm(u.x);
#ifdef CLOUDTOMO_FIELD
        /* What a flight brings is known at its end: it is flown again, to deposit. */
        Ray start = ray;
        Carried carried = nothing_carried();
        const Flight flight = fly(medium, &ray, reach, carried, record);
        carried.importance = own_share * weight;
        carried.sun_density = sun_density(medium, start.direction);
        carried.bin = direction_bin(start.direction);
        carried.weight = weight;
        carried.is_first = event == 1u;
#else
        const Carried carried = remaining(record);
        const Flight flight = fly(medium, &ray, reach, carried, record);
#endif
        Particle particle;
        float albedo;
        if (flight.collided) {
            particle = choose_particle(medium, flight.droplets, flight.air, flight.index, u.y, v.w, &albedo);
            if (particle >= 0)
                deposit_collision(record, flight.index, flight.droplets, carried);
            account_absorbed(record, weight * (1.0f - albedo));
            tally_column(scene, record, FLUX_ABSORBED, ray.position, weight * (1.0f - albedo));
        } else {
            const Fate fate = fate_of(scene, record, &ray, &flight);
            if (fate == FATE_TOP)
                tally_column(scene, record, FLUX_REFLECTED, ray.position, weight);
            if (fate == FATE_BOTTOM)
                tally_column(scene, record, event == 1u ? FLUX_DIRECT : FLUX_DIFFUSE, ray.position, weight);
            if (fate == FATE_LOST || !reach_surface(scene, &ray)) {
#ifdef CLOUDTOMO_FIELD
                fly(medium, &start, reach, carried, record);
#endif
                account_end(record, fate, weight);
                return;
            }
            particle = PARTICLE_SURFACE;
            albedo = scene->surface_albedo;
            own_share = 1.0f;
            account_surface(record, weight * (1.0f - albedo));
        }
        weight *= albedo;

#ifndef CLOUDTOMO_FLUX
        const float towards_sun = scatter_density(medium, particle, ray.direction, sun);
        /* What a camera sees directly, and the ground, stay free of the roulette's noise. */
        const bool roulette = scene->side_flights && event > 1u && particle != PARTICLE_SURFACE;
        const float radiance = local_estimate(medium, &ray, own_share * weight * towards_sun,
                                              roulette ? LOCAL_ESTIMATE_ROULETTE : 0.0f, v.x, record);
        deposit_local_estimate(medium, &ray, radiance, record);
        record->radiance += radiance;
#endif
#ifdef CLOUDTOMO_FIELD
        carried.arriving = radiance / own_share + remaining(record);
        fly(medium, &start, reach, carried, record);
#endif

        if (weight < PATH_ROULETTE_WEIGHT) {
            const bool survives = v.y * PATH_ROULETTE_WEIGHT < weight;
            account_roulette(record, weight, PATH_ROULETTE_WEIGHT, survives);
            if (!survives) {
                account_end(record, FATE_KILLED, weight);
                return;
            }
            weight = PATH_ROULETTE_WEIGHT;
        }
        const float3 onward = sample_scatter(medium, particle, ray.direction, u.zw);
#ifndef CLOUDTOMO_FLUX
        if (scene->side_flights) {
            const float wide = henyey_greenstein(scalar_product(ray.direction, sun), scene->wide_g);
            const float count = within(SIDE_FLIGHT_RATE * weight * wide, SIDE_FLIGHT_LEAST, SIDE_FLIGHT_MOST);
            side_flights(medium, &ray, particle, weight, count, key, event, v.z, record);
            const float density = scatter_density(medium, particle, ray.direction, onward);
            own_share = density / (density + count * sun_density(medium, onward));
        }
#endif
        ray.direction = onward;
    }
}

#endif
