/* Light that enters an open domain from its surroundings, where surface and air go on without end: the weights of
 * photons of the radiance table that start on the domain's faces (photons.cl). */
#include "box.h"
#include "walk/camera.h"

typedef struct {
    float radiance, own_share; /* of walk/radiance.h */
} Tally;

#include "walk/untallied.h"

inline void tally_shadow_ray(const Medium *medium, const Ray *from, const LocalEstimate *estimate, Tally *tally) {}

#include "walk/unbudgeted.h"
#include "walk/radiance.h"

/* Diffuse radiance along rays into a box, by one path in the opposite direction for each ray; times `unit`. */
__kernel void arriving_diffuse(ARRIVING_DIFFUSE_PARAMETERS)
{
    KEPT_FOR_ITEM(SampleKey, key);
    KEPT_FOR_ITEM(Interaction, at);
    const size_t item = get_global_id(0);
    if (item >= count)
        return;
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    const SampleKey own = sample_key(seed, stream, (uint2)(ARRIVING_VIEW, 0u), first_sample + (uint)item);
    Ray ray = ray_into_box(scene, box, &own);
    ray.direction = -ray.direction;
    keep_key(key, &own);
    Tally tally = {0.0f, 1.0f};
    walk_path(&medium, at, ray, key, &tally);
    weights[item] = unit * tally.radiance;
}

/* Direct sunlight along the rays of the sun's view where they enter the domain: the transmittance of the air before. */
__kernel void arriving_sunlight(ARRIVING_SUNLIGHT_PARAMETERS)
{
    const size_t item = get_global_id(0);
    if (item >= count)
        return;
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    const uint sample = first_sample + (uint)item / pixel_count;
    const SampleKey key = sample_key(seed, stream, (uint2)(TABLE_PHOTONS_VIEW, (uint)item % pixel_count), sample);
    Ray ray = camera_ray(scene, sun_view, 0, &key);
    float distance, weight = 0.0f;
    if (enter_domain(scene, &ray, &distance)) {
        ray = shadow_ray(&medium, &ray);
        ray.inside = false;
        weight = exponential(-fly(&medium, &ray, INFINITY).depth);
    }
    weights[item] = weight;
}
