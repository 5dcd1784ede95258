/* Fluxes: follows photons from the sun, and adds up their weights in the columns of the grid. */
#include "walk/budget.h"
#include "walk/camera.h"
#include "walk/event.h"
#include "walk/turns.h"

typedef struct {
    KEPT Budget *budget;
    BudgetSums sums;                        /* sums of all photons' budgets */
    volatile __global Accumulator *columns; /* weights, [Flux][x][y] */
} Tally;

/* Adds a weight to the column that holds a position (in voxel units). */
inline void tally_column(const __constant Scene *scene, Flux flux, float3 position, float weight, const Tally *tally)
{
    const int2 last = (int2)(scene->shape[0], scene->shape[1]) - 1;
    const int2 column = clamp(convert_int2(wrapped(scene, position).xy), (int2)(0), last);
    const int index = ((int)flux * scene->shape[0] + column.x) * scene->shape[1] + column.y;
    accumulate(tally->columns + index, weight * WEIGHT_UNIT);
}

inline Flight on_flight(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    return fly(medium, ray, segment->optical_depth);
}

inline void on_leaving(const Medium *medium, const Segment *segment, const Flight *flight, const Ray *ray,
                       Termination termination, bool ends, Tally *tally)
{
    const Flux downward = segment->event == 1u ? FLUX_DIRECT : FLUX_DIFFUSE;
    if (termination == TERMINATION_TOP)
        tally_column(medium->scene, FLUX_REFLECTED, ray->position, segment->throughput, tally);
    if (termination == TERMINATION_BOTTOM)
        tally_column(medium->scene, downward, ray->position, segment->throughput, tally);
}

inline void on_absorption(const Medium *medium, const KEPT Interaction *at, float weight, Tally *tally)
{
    const bool by_surface = at->particle == PARTICLE_SURFACE;
    budget_absorption(tally->budget, by_surface, weight);
    if (!by_surface)
        tally_column(medium->scene, FLUX_ABSORBED, kept_vector(&at->ray.position), weight, tally);
}

inline void on_interaction(const Medium *medium, const Segment *segment, const Flight *flight,
                           const KEPT Interaction *at, Tally *tally)
{
}

inline void on_scattering(const Medium *medium, KEPT Interaction *at, const KEPT SampleKey *key, Tally *tally) {}

#include "walk/budgeted.h"
#include "walk/path.h"

/* Photon `sample_in_launch * pixel_count + pixel` starts in a pixel of the sun's view of the
 * domain: on its top, or that of the atmosphere. */
__kernel void trace_photons(TRACE_PHOTONS_PARAMETERS)
{
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    TURNS(turn, photon_count);
    GROUP_BUDGET(group_budget, budget);
    KEPT_TOGETHER(SampleKey, key, Interaction, at, Budget, own_budget);
    Tally tally;
    tally.budget = own_budget;
    tally.sums = group_budget;
    tally.columns = columns;
    for (bool walks = false; walks || next_turn(&turn);) {
        if (!walks) {
            const uint sample = first_sample + turn.item / pixel_count;
            const SampleKey own = sample_key(seed, 0u, (uint2)(SUN_VIEW, turn.item % pixel_count), sample);
            clear_budget(own_budget);
            keep_key(key, &own);
            start_path(at, camera_ray(scene, sun_view, 0, &own));
        }
        walks = walk_turn(&medium, at, key, &tally);
        if (!walks)
            budget_path(own_budget, tally.sums);
    }
    close_group_budget(group_budget, budget);
}
