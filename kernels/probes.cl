/* The radiance table where the cameras' paths hardly come: paths that start in its cells, in directions of all the
 * sphere, bring it what arrives there. */
#include "walk/estimate.h"

typedef struct {
    float radiance, own_share; /* of walk/radiance.h */
} Tally;

inline Flight tally_fly(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    return fly(medium, ray, segment->optical_depth);
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
#include "radiance_table.h"

/* `samples` paths from every voxel listed; each counts as a crossing of `length`. */
__kernel void probe_paths(PROBE_PATHS_PARAMETERS)
{
    KEPT_FOR_ITEM(SampleKey, key);
    KEPT_FOR_ITEM(Interaction, at);
    const size_t item = get_global_id(0);
    if (item >= (size_t)count * samples)
        return;
    const int index = listed[item / samples];
    const uint sample = (uint)(item % samples);
    const int layers = scene->shape[2], rows = scene->shape[1];
    const SampleKey own = {seed, stream, (uint)index, PROBES_VIEW, sample};
    const float4 u = uniforms(&own, 0u), v = uniforms(&own, 1u);
    const float z = 1.0f - 2.0f * ((float)sample + u.w) / (float)samples;
    const float across = sqrt(greater(1.0f - z * z, 0.0f)), azimuth = 2.0f * v.x;
    keep_key(key, &own);
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    Ray ray;
    ray.voxel = (int3)(index / (layers * rows), index / layers % rows, index % layers);
    ray.position = convert_float3(ray.voxel) + u.xyz;
    ray.direction = (float3)(across * cospi(azimuth), across * sinpi(azimuth), z);
    ray.inside = true;
    const RadianceTable table = make_table(TABLE_ARGUMENTS);
    const uint cell = cell_at(&table, column[index], ray.position);
    volatile __global Accumulator *sums = table_sums + 2u * (cell * DIRECTION_BINS + direction_bin(ray.direction));
    Tally tally = {0.0f, 1.0f};
    walk_path(&medium, at, ray, key, &tally);
    accumulate(sums, TABLE_UNIT * length);
    accumulate(sums + 1, TABLE_UNIT * length * tally.radiance);
}
