/* Radiances: paths are walked, each by one work item; then every pixel sums its paths in order. */
#include "walk/brought.h"
#include "walk/budget.h"
#include "walk/event.h"
#include "walk/turns.h"

typedef struct {
    float radiance, own_share; /* of radiance.h */
    KEPT Budget *budget;
    BudgetSums sums; /* sums of all paths' budgets */
    Branches branches;
    Brought brought;
} Tally;

#include "walk/untallied.h"

inline void tally_shadow_ray(const Medium *medium, const Ray *from, const LocalEstimate *estimate, Tally *tally)
{
    tally->budget->truncated += estimate->removed;
}

inline void on_absorption(const Medium *medium, const KEPT Interaction *at, float weight, Tally *tally)
{
    budget_absorption(tally->budget, at->particle == PARTICLE_SURFACE, weight);
}

inline void tally_new_branch(uint number, Tally *tally) { await_branch(&tally->brought, number); }

inline void tally_next_branch(uint number, Tally *tally)
{
    const uint waiting = tally->branches.count;
    end_branches(&tally->brought, &tally->branches, waiting + 1u, tally->radiance);
    open_branch(&tally->brought, number, waiting, tally->radiance);
}

inline void store_branches(Tally *tally, __global float *brought, uint path_count)
{
    end_branches(&tally->brought, &tally->branches, 0u, tally->radiance);
    for (uint n = 0u; n < tally->branches.begun; ++n)
        brought[(size_t)n * path_count] = tally->brought.radiance[n];
}

#include "walk/budgeted.h"
#include "walk/radiance.h"

/* The radiance of path number `sample_in_launch * pixel_count + pixel`, for a sun of irradiance 1. */
__kernel void render_paths(RENDER_PATHS_PARAMETERS)
{
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    TURNS(turn, path_count);
    GROUP_BUDGET(group_budget, budget);
    uint path = 0u;
    KEPT_TOGETHER(SampleKey, key, Interaction, at, Budget, own_budget);
    Tally tally;
    tally.budget = own_budget;
    tally.sums = group_budget;
    BRANCHES(tally);
    for (bool walks = false; walks || next_turn(&turn);) {
        if (!walks) {
            path = path_of_item(turn.item, pixel_count, path_count);
            const uint2 pixel = pixels[path % pixel_count];
            const SampleKey own = sample_key(seed, stream, pixel, first_sample + path / pixel_count);
            tally.radiance = 0.0f;
            tally.own_share = 1.0f;
            clear_branches(&tally.branches);
            clear_budget(own_budget);
            keep_key(key, &own);
            start_path(at, camera_ray(scene, views + pixel.x, rays, &own));
        }
        walks = walk_turn(&medium, at, key, &tally) || next_branch(at, key, &tally);
        if (!walks) {
            path_radiance[path] = tally.radiance;
            if (stores_branches)
                store_branches(&tally, path_radiance + path_count + path, path_count);
            budget_path(own_budget, tally.sums);
        }
    }
    close_group_budget(group_budget, budget);
}

/* Adds paths of a launch, samples `begin` to `end` of it, to the pixels' sums, even and odd samples
 * separately. One work item sums each pixel in the order of its samples: the result has the same
 * bits however launches are divided. */
__kernel void sum_paths(SUM_PATHS_PARAMETERS)
{
    const size_t pixel = get_global_id(0);
    if (pixel >= pixel_count)
        return;
    PixelSums s = sums[pixel];
    for (uint n = begin; n < end; ++n) {
        const float radiance = path_radiance[(size_t)n * pixel_count + pixel];
        const uint half_index = (first_sample + n) & 1u;
        add_compensated(&s.half_sum[half_index], &s.half_low[half_index], radiance);
        add_compensated(&s.square_sum, &s.square_low, radiance * radiance);
    }
    sums[pixel] = s;
}
