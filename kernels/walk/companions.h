/* What starts where a path scatters, beside the path itself, in directions around the sun: side flights (radiance.h)
 * and, with CLOUDTOMO_BRANCHES, branches (branches.h). They replace the rare, huge local estimates that a forward peak
 * gives. All are combined by the balance heuristic (Veach and Guibas 1995), so that no weight exceeds 1. */
#ifndef CLOUDTOMO_COMPANIONS_H
#define CLOUDTOMO_COMPANIONS_H

#include "walk/event.h"
#include "walk/medium.h"

/* Side flights: expected number per unit of throughput x phase function (sr), and its bounds. Branches: expected number
 * at the first event, and after how many events it has halved, for branches of deep clouds cost more than they bring.
 * Found by measurement: docs/decisions/forward-peak.md. */
#define SIDE_FLIGHT_LEAST 0.05f
#ifdef CLOUDTOMO_BRANCHES
#define SIDE_FLIGHT_RATE 12.0f
#define SIDE_FLIGHT_MOST 12.0f
#define BRANCH_RATE 0.2f
#define BRANCH_EVENTS 5.0f

inline float expected_branches(const KEPT Interaction *at, const Tally *tally)
{
    const Branches *branches = &tally->branches;
    if (branches->begun == MOST_BRANCHES)
        return 0.0f;
    return BRANCH_RATE * BRANCH_EVENTS / (BRANCH_EVENTS + (float)(at->event - 1u));
}

/* Density from which branches draw their directions, sr^-1. */
inline float branch_density(const __constant Scene *scene, float3 direction)
{
    return henyey_greenstein(scalar_product(direction, sun_direction(scene)), scene->wide_g);
}
#else
#define SIDE_FLIGHT_RATE 6.0f
#define SIDE_FLIGHT_MOST 6.0f

inline float expected_branches(const KEPT Interaction *at, const Tally *tally) { return 0.0f; }

inline float branch_density(const __constant Scene *scene, float3 direction) { return 0.0f; }
#endif

/* Expected numbers of companions. */
typedef struct {
    float branches, side_flights;
} Companions;

/* Expected numbers in a direction, sr^-1. */
typedef struct {
    float path, branches, side_flights;
} Densities;

inline Companions companions_of(const __constant Scene *scene, const KEPT Interaction *at, const Tally *tally)
{
    const float3 arriving = kept_vector(&at->ray.direction);
    const float wide = henyey_greenstein(scalar_product(arriving, sun_direction(scene)), scene->wide_g);
    Companions companions;
    companions.branches = expected_branches(at, tally);
    companions.side_flights = within(SIDE_FLIGHT_RATE * at->throughput * wide, SIDE_FLIGHT_LEAST, SIDE_FLIGHT_MOST);
    return companions;
}

inline Densities densities_in(const Medium *medium, Particle particle, float3 arriving, float3 direction,
                              Companions companions)
{
    Densities densities;
    densities.path = scatter_density(medium, particle, arriving, direction);
    densities.branches = companions.branches * branch_density(medium->scene, direction);
    densities.side_flights = companions.side_flights * sun_density(medium, direction);
    return densities;
}

/* The share of a side flight in the local estimate at its end. */
inline float share_of_side_flight(Densities densities)
{
    return densities.path / (densities.path + densities.branches + densities.side_flights);
}

/* The share of what is walked, path or branch, in the local estimate at its next collision. */
inline float share_beside_side_flights(Densities densities)
{
    const float walked = densities.path + densities.branches;
    return walked / (walked + densities.side_flights);
}

/* The share of a path, or of a branch, in the light of a direction. */
inline float share_beside_each_other(Densities densities)
{
    return densities.path / (densities.path + densities.branches);
}

#endif
