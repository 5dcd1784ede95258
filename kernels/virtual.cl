/* Paths from virtual collisions (replay.cl): their radiance is added to the gradient in the voxel where they begin.
 * Such a path goes on as the replayed path would have if the droplet were real, but with other random numbers. */
#include "walk/accumulate.h"
#include "walk/estimate.h"
#include "walk/replayed.h"

typedef struct {
    float radiance, own_share; /* of radiance.h */
    uint first_event;          /* number of the flight with the virtual collision */
    int index;                 /* index of the collision's voxel */
} Tally;

/* The path begins at the end of its first segment, in a droplet. */
inline Flight tally_fly(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    if (segment->event > tally->first_event)
        return fly(medium, ray, segment->optical_depth);
    const Flight flight = {true, true, false, false, 0.0f, 1.0f, 0.0f, tally->index};
    return flight;
}

inline void tally_segment(const Medium *medium, const Segment *segment, const Flight *flight, Particle end, float share,
                          float local_radiance, Tally *tally)
{
}

inline void tally_side_flight(const Medium *medium, const Segment *segment, const Flight *flight, Particle end,
                              float share, float local_radiance, Tally *tally)
{
}

inline void tally_shadow_ray(const Medium *medium, const Ray *from, const LocalEstimate *estimate, Tally *tally) {}

#include "walk/unbudgeted.h"
#include "walk/radiance.h"

/* The local estimate of a side flight that ends in a droplet there. */
static float side_radiance(const Medium *medium, const KEPT Interaction *at, float share, int index,
                           const KEPT SampleKey *key)
{
    const float4 v = event_uniforms(key, at->event, BLOCK_ROULETTE);
    float albedo;
    const Particle droplet = choose_droplet(medium, index, v.w, &albedo);
    const float weight =
        at->throughput * albedo * share
        * scatter_density(medium, droplet, kept_vector(&at->ray.direction), sun_direction(medium->scene));
    RAY_OF(ray, &at->ray);
    return local_estimate(medium, ray, weight, LOCAL_ESTIMATE_ROULETTE, v.x).radiance;
}

__kernel void virtual_paths(VIRTUAL_PATHS_PARAMETERS)
{
    KEPT_FOR_ITEM(SampleKey, key);
    KEPT_FOR_ITEM(Interaction, at);
    const size_t item = get_global_id(0);
    if (item >= count)
        return;
    const __global VirtualCollision *from = virtual_collisions + item;
    const uint sample = first_sample + from->path / pixel_count;
    const uint pixel_in_list = from->path % pixel_count;
    const uint2 pixel = pixels[pixel_in_list];
    const SampleKey own = {seed, stream, pixel.y, pixel.x + VIRTUAL_PATHS_VIEW, sample};
    keep_key(key, &own);
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    const Ray ray = {vload3(0, from->position), vload3(0, from->direction), vload3(0, from->voxel), true};
    start_path(at, ray);
    at->throughput = from->throughput;
    at->event = from->event;
    const int index = voxel_index(scene, ray.voxel);
    float radiance;
    if (from->aside) {
        radiance = side_radiance(&medium, at, from->share, index, key);
    } else {
        Tally tally = {0.0f, from->share, from->event, index};
        walk_on(&medium, at, key, &tally);
        radiance = tally.radiance;
    }
    const float droplets = extinction[index] + virtual_extinction[index];
    const float each = (float)from->of / droplets; /* it stands for all virtual collisions of its path */
    if (radiance != 0.0f)
        accumulate(gradient + index, adjoint_of(adjoint, pixel_in_list, sample) * (radiance * each));
}
