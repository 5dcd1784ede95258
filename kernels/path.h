/* The random walk: backward Monte Carlo with local estimates.
 *
 * One piece of code serves rendering and replay. Compiled with CLOUDTOMO_REPLAY, the same
 * path is walked again with the same random numbers, its total radiance known, and every
 * crossing and collision deposits its share of the gradient: a crossing of voxel v over l km
 * on the way to radiance R adds -l R, a collision with a droplet there adds R / extinction
 * (the supplement's Eqs. 13, 17, 18 with sums swapped; path replay, Vicini et al. 2021).
 *
 * Radiances inside a path are for a sun of irradiance 1; the host scales them.
 */
#ifndef CLOUDTOMO_PATH_H
#define CLOUDTOMO_PATH_H

#include "rng.h"
#include "grid.h"
#include "phase.h"
#include "camera.h"
#include "accumulate.h"

/* A voxel's faces that one flight may cross before the path is given up as lost: only a ray
 * that is horizontal, or all but, in a periodic and empty layer gets there. */
#define CROSSINGS_LIMIT (1 << 18)
/* Paths lighter than this are continued with probability weight / PATH_ROULETTE_WEIGHT. */
#define PATH_ROULETTE_WEIGHT 0.1f
/* Side flights aimed at the sun: expected number per unit of weight x phase function (sr),
 * its bounds, and the threshold of the roulette on local estimates (sr^-1). Found by
 * measurement: docs/estimators.md. */
#define SIDE_FLIGHT_RATE 6.0f
#define SIDE_FLIGHT_LEAST 0.05f
#define SIDE_FLIGHT_MOST 6.0f
#define LOCAL_ESTIMATE_ROULETTE 0.03f

typedef enum { PARTICLE_DROPLET, PARTICLE_MOLECULE, PARTICLE_SURFACE } Particle;

typedef struct {
    const __constant Scene *scene;
    const __global float *extinction; /* droplets, km^-1, [x][y][z] */
    const __global float *air;        /* molecules, km^-1, [z] */
} Medium;

/* What a path has gathered, and in a replay what it is to deposit. */
typedef struct {
    float radiance; /* local estimates so far, sr^-1 */
    bool lost;
#ifdef CLOUDTOMO_REPLAY
    float total;    /* the whole path's radiance, sr^-1 */
    float adjoint;  /* derivative of the cost with respect to this path's radiance, scaled */
    volatile __global Accumulator *gradient;
#endif
} Record;

/* How a flight ended. */
typedef struct {
    bool collided;
    float depth;    /* optical depth flown through */
    float droplets; /* extinction where it collided, km^-1 */
    float air;
    int index;      /* voxel where it collided */
} Flight;

#ifdef CLOUDTOMO_REPLAY
/* Radiance that this path has still to gather; rounding counts as nothing. */
inline float remaining(const Record *record)
{
    const float rest = record->total - record->radiance;
    return rest > 4.0f * FLT_EPSILON * record->total ? rest : 0.0f;
}
inline void deposit(Record *record, int index, float value)
{
    accumulate(record->gradient + index, record->adjoint * value);
}
#define DEPOSIT_CROSSING(index, length, carried) \
    if ((carried) != 0.0f) deposit(record, index, -(length) * (carried))
#define DEPOSIT_COLLISION(index, extinction, carried) \
    if ((carried) != 0.0f) deposit(record, index, (carried) / (extinction))
#else
inline float remaining(const Record *record) { return 0.0f; }
#define DEPOSIT_CROSSING(index, length, carried)
#define DEPOSIT_COLLISION(index, extinction, carried)
#endif

/* Flies along the ray until it has crossed the optical depth `reach` (a collision) or left
 * the domain; moves the ray to the collision. `carried` is the radiance that depends on this
 * flight, sr^-1. */
inline Flight fly(const Medium *medium, Ray *ray, float reach, float carried, Record *record)
{
    const __constant Scene *scene = medium->scene;
    Flight flight = {false, 0.0f, 0.0f, 0.0f, 0};
    if (!enter_domain(scene, ray))
        return flight;
    VoxelWalk walk = walk_begin(scene, ray);
    for (int crossing = 0; crossing < CROSSINGS_LIMIT; ++crossing) {
        const float exit = walk_exit(&walk);
        const float length = exit - walk.distance;
        const float droplets = medium->extinction[walk.index];
        const float air = medium->air[walk.voxel.z];
        const float extinction = droplets + air;
        const float depth = flight.depth + extinction * length;
        if (depth >= reach) {
            const float part = fmin((reach - flight.depth) / extinction, length);
            DEPOSIT_CROSSING(walk.index, part, carried);
            move_to_walk(scene, ray, &walk, walk.distance + part);
            flight.collided = true;
            flight.depth = reach;
            flight.droplets = droplets;
            flight.air = air;
            flight.index = walk.index;
            return flight;
        }
        DEPOSIT_CROSSING(walk.index, length, carried);
        flight.depth = depth;
        if (!walk_advance(scene, &walk, exit)) {
            ray->position += exit * ray->direction / grid_spacing(scene);
            ray->inside = false;
            return flight;
        }
    }
    record->lost = true;
    ray->inside = false;
    return flight;
}

/* The density (sr^-1) of scattering from direction `from` into `to`; for a Lambertian
 * surface, the density of its reflection. */
inline float scatter_density(const __constant Scene *scene, Particle particle, float3 from, float3 to)
{
    switch (particle) {
    case PARTICLE_DROPLET: return henyey_greenstein(dot(from, to), scene->asymmetry);
    case PARTICLE_MOLECULE: return rayleigh(dot(from, to));
    default: return fmax(to.z, 0.0f) * ONE_OVER_PI;
    }
}

inline float3 sample_scatter(const __constant Scene *scene, Particle particle, float3 from, float2 u)
{
    switch (particle) {
    case PARTICLE_DROPLET:
        return direction_around(from, sample_henyey_greenstein(u.x, scene->asymmetry), u.y);
    case PARTICLE_MOLECULE: return direction_around(from, sample_rayleigh(u.x), u.y);
    default: return direction_around((float3)(0.0f, 0.0f, 1.0f), sqrt(u.x), u.y);
    }
}

inline float3 sun_direction(const __constant Scene *scene)
{
    return (float3)(scene->sun[0], scene->sun[1], scene->sun[2]);
}

/* Which particle a flight met, and its single-scattering albedo. */
inline Particle choose_particle(const __constant Scene *scene, const Flight *flight, float u, float *albedo)
{
    const bool droplet = u * (flight->droplets + flight->air) < flight->droplets;
    *albedo = droplet ? scene->droplet_albedo : scene->air_albedo;
    return droplet ? PARTICLE_DROPLET : PARTICLE_MOLECULE;
}

/* Radiance of the sunlight that reaches the ray's position: weight (sr^-1) times the
 * transmittance to the sun. A threshold above 0 (sr^-1) plays a roulette that ends walks
 * which would bring less; the mean is kept. */
inline float local_estimate(const Medium *medium, const Ray *at, float weight, float threshold, float u,
                            Record *record)
{
    const float least = u * threshold;
    if (weight <= least)
        return 0.0f;
    Ray ray = *at;
    ray.direction = sun_direction(medium->scene);
    const float reach = threshold > 0.0f ? log(weight / least) : INFINITY;
    const Flight flight = fly(medium, &ray, reach, 0.0f, record);
    return flight.collided ? 0.0f : fmax(weight * exp(-flight.depth), threshold);
}

/* In a replay: deposits the crossings of the way to the sun. */
inline void deposit_local_estimate(const Medium *medium, const Ray *at, float radiance, Record *record)
{
#ifdef CLOUDTOMO_REPLAY
    if (radiance == 0.0f)
        return;
    Ray ray = *at;
    ray.direction = sun_direction(medium->scene);
    fly(medium, &ray, INFINITY, radiance, record);
#endif
}

/* Side flights: from a collision, flights in directions drawn around the sun estimate the
 * next order's sunlight, combined with the path's own next collision by the balance heuristic
 * (Veach and Guibas 1995); they take the load of the rare, huge local estimates that a
 * forward peak gives. `count` is their expected number. */
inline void side_flights(const Medium *medium, const Ray *at, Particle particle, float weight, float count,
                         const SampleKey *key, uint event, float u, Record *record)
{
    const __constant Scene *scene = medium->scene;
    const float3 sun = sun_direction(scene);
    const uint flights = (uint)(count + u);
    for (uint n = 0; n < flights; ++n) {
        const uint block = event * BLOCKS_PER_EVENT + BLOCK_SIDE + 2u * n;
        const float4 v = uniforms(key, block);
        const float roulette = uniforms(key, block + 1u).x;
        Ray ray = *at;
        ray.direction = direction_around(sun, sample_henyey_greenstein(v.z, scene->asymmetry), v.w);
        const float density = scatter_density(scene, particle, at->direction, ray.direction);
        const float sun_density = henyey_greenstein(dot(ray.direction, sun), scene->asymmetry);
        if (!(density > 0.0f))
            continue;
        const Ray start = ray;
        const float reach = -log(v.x);
        const Flight flight = fly(medium, &ray, reach, 0.0f, record);
        if (!flight.collided)
            continue;
        float albedo;
        const Particle target = choose_particle(scene, &flight, v.y, &albedo);
        const float estimate = weight * albedo * density
                               * scatter_density(scene, target, ray.direction, sun)
                               / (density + count * sun_density);
        const float radiance = local_estimate(medium, &ray, estimate, LOCAL_ESTIMATE_ROULETTE, roulette, record);
#ifdef CLOUDTOMO_REPLAY
        if (radiance > 0.0f) {
            Ray again = start;
            fly(medium, &again, reach, radiance, record);
            if (target == PARTICLE_DROPLET)
                DEPOSIT_COLLISION(flight.index, flight.droplets, radiance);
            deposit_local_estimate(medium, &ray, radiance, record);
        }
#endif
        record->radiance += radiance;
    }
}

/* If the ray, outside of the domain, goes down to the surface: moves it there. */
inline bool reach_surface(const __constant Scene *scene, Ray *ray)
{
    if (scene->surface_albedo <= 0.0f || !(ray->direction.z < 0.0f) || ray->inside)
        return false;
    const float3 spacing = grid_spacing(scene);
    const float height = ray->position.z * spacing.z + scene->base_height; /* km above ground */
    ray->position += fmax(height, 0.0f) / -ray->direction.z * ray->direction / spacing;
    ray->position.z = -scene->base_height / spacing.z;
    return true;
}

/* Walks the whole path from its camera ray; record->radiance ends as its total. */
inline void trace_path(const Medium *medium, Ray ray, const SampleKey *key, Record *record)
{
    const __constant Scene *scene = medium->scene;
    const float3 sun = sun_direction(scene);
    float weight = 1.0f;      /* product of single-scattering albedos, over survival */
    float own_share = 1.0f;   /* the path's part in its next collision's estimate */
    for (uint event = 1u;; ++event) {
        const float4 u = uniforms(key, event * BLOCKS_PER_EVENT + BLOCK_EVENT);
        const float4 v = uniforms(key, event * BLOCKS_PER_EVENT + BLOCK_ROULETTE);
        const float carried = remaining(record);
        const Flight flight = fly(medium, &ray, -log(u.x), carried, record);
        Particle particle;
        float albedo;
        if (flight.collided) {
            particle = choose_particle(scene, &flight, u.y, &albedo);
            if (particle == PARTICLE_DROPLET)
                DEPOSIT_COLLISION(flight.index, flight.droplets, carried);
        } else if (!record->lost && reach_surface(scene, &ray)) {
            particle = PARTICLE_SURFACE;
            albedo = scene->surface_albedo;
            own_share = 1.0f;
        } else {
            return;
        }
        weight *= albedo;

        const float towards_sun = scatter_density(scene, particle, ray.direction, sun);
        /* What a camera sees directly, and the ground, stay free of the roulette's noise. */
        const bool roulette = scene->side_flights && event > 1u && particle != PARTICLE_SURFACE;
        const float radiance = local_estimate(medium, &ray, own_share * weight * towards_sun,
                                              roulette ? LOCAL_ESTIMATE_ROULETTE : 0.0f, v.x, record);
        deposit_local_estimate(medium, &ray, radiance, record);
        record->radiance += radiance;

        if (weight < PATH_ROULETTE_WEIGHT) {
            if (v.y * PATH_ROULETTE_WEIGHT >= weight)
                return;
            weight = PATH_ROULETTE_WEIGHT;
        }
        float count = 0.0f;
        if (scene->side_flights) {
            const float wide = henyey_greenstein(dot(ray.direction, sun), scene->asymmetry * scene->asymmetry);
            count = clamp(SIDE_FLIGHT_RATE * weight * wide, SIDE_FLIGHT_LEAST, SIDE_FLIGHT_MOST);
            side_flights(medium, &ray, particle, weight, count, key, event, v.z, record);
        }
        const float3 onward = sample_scatter(scene, particle, ray.direction, u.zw);
        if (scene->side_flights) {
            const float density = scatter_density(scene, particle, ray.direction, onward);
            own_share = density / (density + count * henyey_greenstein(dot(onward, sun), scene->asymmetry));
        }
        ray.direction = onward;
    }
}

#endif
