/* The random walk: flights, collisions and surfaces, one after the other.
 *
 * The walk does not depend on the quantity that is computed. The including file defines, before it includes this, the
 * struct `Tally` and what happens at every step, as inline functions:
 *
 *   Flight on_flight(medium, Ray *ray, const Segment *segment, tally)
 *       samples a free flight: moves the ray as `fly` does (flight.h), by that or another traversal (traversal.h)
 *   void on_leaving(medium, const Segment *segment, const Flight *flight, const Ray *ray, Termination termination,
 *                   bool ends, tally)
 *       the path has left everything that scatters, at `ray`; it ends there, or goes on to the surface
 *   void on_interaction(medium, const Segment *segment, const Flight *flight, const Interaction *at, tally)
 *       the segment ends in a collision, or at the surface
 *   void on_scattering(medium, Interaction *at, const SampleKey *key, tally)
 *       the path goes on from there, in at->new_direction; at->throughput may be lowered by what branches take
 *   void on_absorption(medium, const Interaction *at, float weight, tally)
 *       the path's throughput is reduced by `weight`
 *   void on_roulette(float throughput, float raised, bool survives, tally)
 *       a roulette has raised the throughput to `raised`, or ends the path
 *   void on_termination(Termination termination, float throughput, tally)
 *       the path ends with the given throughput
 *
 * radiance.h defines the first four for paths from cameras; budgeted.h has the last two for the audit, unbudgeted.h
 * empty ones of the last three. Radiances inside a path are for a sun of irradiance 1; the host scales them.
 */
#ifndef CLOUDTOMO_PATH_H
#define CLOUDTOMO_PATH_H

#include "walk/event.h"
#include "walk/roulette.h"
#include "walk/turns.h"

/* Whether a ray that has left everything that scatters goes down to a surface that reflects. */
inline bool meets_surface(const __constant Scene *scene, const Ray *ray)
{
    return scene->surface_albedo > 0.0f && ray->direction.z < 0.0f && !ray->inside;
}

inline void move_to_surface(const __constant Scene *scene, Ray *ray)
{
    const float3 spacing = grid_spacing(scene);
    const float height = ray->position.z * spacing.z + scene->base_height; /* km above ground */
    ray->position += greater(height, 0.0f) / -ray->direction.z * ray->direction / spacing;
    ray->position.z = -scene->base_height / spacing.z;
}

/* How a path ends whose flight has ended without a collision. */
inline Termination termination_of(const __constant Scene *scene, const Ray *ray, const Flight *flight)
{
    if (flight->lost)
        return TERMINATION_LOST;
    if (!scene->periodic && (flight->through_side || !flight->met_grid))
        return flight->met_grid ? TERMINATION_SIDES : TERMINATION_MISSED;
    return ray->direction.z > 0.0f ? TERMINATION_TOP : TERMINATION_BOTTOM;
}

/* Walks a path from `at`, its last interaction, to the next; returns false if the path has ended. Of `at` it reads the
 * ray along which the path goes on, the throughput, and the number of the segment that begins there. */
inline bool walk_event(const Medium *medium, KEPT Interaction *at, const KEPT SampleKey *key, Tally *tally)
{
    const __constant Scene *scene = medium->scene;
    const float4 u = event_uniforms(key, at->event, BLOCK_EVENT);
    RAY_OF(ray, &at->ray);
    const Segment segment = {*ray, -logarithm(u.x), at->throughput, at->event};
    const Flight flight = on_flight(medium, ray, &segment, tally);
    keep_ray(&at->ray, ray);
    const float4 v = event_uniforms(key, at->event, BLOCK_ROULETTE);
    if (flight.collided) {
        float albedo;
        at->particle = choose_particle(medium, flight.droplets, flight.air, flight.index, u.y, v.w, &albedo);
        at->albedo = albedo;
    } else {
        const Termination termination = termination_of(scene, ray, &flight);
        const bool ends = termination == TERMINATION_LOST || !meets_surface(scene, ray);
        on_leaving(medium, &segment, &flight, ray, termination, ends, tally);
        if (ends) {
            on_termination(termination, at->throughput, tally);
            return false;
        }
        move_to_surface(scene, ray);
        keep_ray(&at->ray, ray);
        at->particle = PARTICLE_SURFACE;
        at->albedo = scene->surface_albedo;
    }
    at->u_estimate = v.x;
    at->u_companions = v.z;
    on_absorption(medium, at, at->throughput * (1.0f - at->albedo), tally);
    at->throughput *= at->albedo;
    on_interaction(medium, &segment, &flight, at, tally);
    at->throughput = after_roulette(at->throughput, v.y, tally);
    if (at->throughput == 0.0f)
        return false;
    keep_vector(&at->new_direction, sample_scatter(medium, at->particle, kept_vector(&at->ray.direction), u.zw));
    on_scattering(medium, at, key, tally);
    keep_vector(&at->ray.direction, kept_vector(&at->new_direction));
    ++at->event;
    return true;
}

/* Walks a path from an interaction as far as a work item does before it looks for another path (turns.h): to its end,
 * or to the next interaction. Returns false if the path has ended. */
inline bool walk_turn(const Medium *medium, KEPT Interaction *at, const KEPT SampleKey *key, Tally *tally)
{
    bool walks;
    do
        walks = walk_event(medium, at, key, tally);
    while (walks && !REGENERATES);
    return walks;
}

/* Walks a path from an interaction to its end. */
inline void walk_on(const Medium *medium, KEPT Interaction *at, const KEPT SampleKey *key, Tally *tally)
{
    while (walk_event(medium, at, key, tally)) {
    }
}

/* Makes `at` the start of a whole path, with its first ray. */
inline void start_path(KEPT Interaction *at, Ray first_ray)
{
    keep_ray(&at->ray, &first_ray);
    at->throughput = 1.0f;
    at->event = 1u;
}

/* Walks a whole path from its first ray. */
inline void walk_path(const Medium *medium, KEPT Interaction *at, Ray first_ray, const KEPT SampleKey *key,
                      Tally *tally)
{
    start_path(at, first_ray);
    walk_on(medium, at, key, tally);
}

#endif
