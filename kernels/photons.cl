/* The radiance table, filled by photons from the sun: what they bring to every cell that they cross.
 *
 * The lengths of a photon's flights through a cell, times its weight, are an estimate of the radiance there without a
 * denominator that is sampled: of N photons that stand for the power P together,
 *
 *     radiance of a bin = P / N sum of weight x length / (the cell's volume x the bin's solid angle)
 *
 * (Spanier and Gelbard 1969, "Monte Carlo principles and neutron transport problems": the track-length estimator).
 * It is unbiased wherever light goes. Flights before the first event are direct sunlight, which the table has apart. */
#include "radiance_table.h"
#include "walk/accumulate.h"
#include "walk/camera.h"
#include "walk/event.h"
#include "walk/turns.h"

typedef struct {
    const __global int *column;
    const __global uint4 *cells;
    volatile __global Accumulator *sums; /* [cell][bin], units of 1 / unit km */
    float unit;
} Tally;

/* Where a point is in the voxel that holds another one, from 0 to 1 along each axis. */
inline float3 within_voxel(float3 point, float3 middle) { return clamp(point - floor(middle), 0.0f, 1.0f); }

/* Adds `length` km of a crossing of a voxel, from `begin` km along the ray on, to the cells of the voxel. */
inline void deposit_parts(const __constant Scene *scene, const Ray *ray, uint4 cells, float begin, float length,
                          float weight, volatile __global Accumulator *sums)
{
    const float3 parts = convert_float3(cells.yzw), per_km = ray->direction / grid_spacing(scene);
    const float3 middle = ray->position + (begin + 0.5f * length) * per_km;
    const float3 start = within_voxel(ray->position + begin * per_km, middle) * parts, slope = per_km * parts;
    int3 part = clamp(convert_int3(start), (int3)(0), convert_int3(parts) - 1);
    const int3 step = (int3)(slope.x > 0.0f ? 1 : -1, slope.y > 0.0f ? 1 : -1, slope.z > 0.0f ? 1 : -1);
    const float3 face = convert_float3(part) + (float3)(slope.x > 0.0f, slope.y > 0.0f, slope.z > 0.0f);
    float3 next = (float3)(slope.x != 0.0f ? (face.x - start.x) / slope.x : INFINITY,
                           slope.y != 0.0f ? (face.y - start.y) / slope.y : INFINITY,
                           slope.z != 0.0f ? (face.z - start.z) / slope.z : INFINITY);
    const float3 per_part = 1.0f / fabs(slope);
    const int3 last = convert_int3(parts) - 1;
    for (float from = 0.0f; from < length;) {
        const float nearest = lesser(next.z, lesser(next.x, next.y));
        const uint cell = cells.x + (uint)((part.x * (last.y + 1) + part.y) * (last.z + 1) + part.z);
        bool ends = false;
        float to = nearest;
        /* The last part of the voxel has what rounding leaves. */
        if (next.z == nearest) {
            ends = part.z + step.z < 0 || part.z + step.z > last.z;
            part.z += ends ? 0 : step.z;
            next.z += per_part.z;
        } else if (next.x == nearest) {
            ends = part.x + step.x < 0 || part.x + step.x > last.x;
            part.x += ends ? 0 : step.x;
            next.x += per_part.x;
        } else {
            ends = part.y + step.y < 0 || part.y + step.y > last.y;
            part.y += ends ? 0 : step.y;
            next.y += per_part.y;
        }
        to = ends ? length : within(to, from, length);
        accumulate(sums + cell * DIRECTION_BINS, weight * (to - from));
        from = to;
    }
}

inline void deposit_light(const __constant Scene *scene, const Ray *ray, const VoxelWalk *walk, float length, int bin,
                          float weight, Tally *tally)
{
    const int column = tally->column[walk->index];
    if (column < 0)
        return;
    const uint4 cells = tally->cells[column];
    volatile __global Accumulator *sums = tally->sums + bin;
    if (cells.y * cells.z * cells.w == 1u)
        accumulate(sums + cells.x * DIRECTION_BINS, weight * length);
    else
        deposit_parts(scene, ray, cells, walk->distance, length, weight, sums);
}

#define TRAVERSAL fly_and_deposit
#define TRAVERSAL_CONTEXT , int bin, float weight, Tally *tally
#define CROSSES(index, length) deposit_light(scene, ray, &walk, length, bin, weight, tally)
#define SKIPS()
#include "walk/traversal.h"

inline Flight on_flight(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    if (segment->event == 1u)
        return fly(medium, ray, segment->optical_depth);
    /* The table's directions are those of paths from cameras: against the light. */
    const int bin = direction_bin(-ray->direction);
    return fly_and_deposit(medium, ray, segment->optical_depth, bin, tally->unit * segment->throughput, tally);
}

inline void on_leaving(const Medium *medium, const Segment *segment, const Flight *flight, const Ray *ray,
                       Termination termination, bool ends, Tally *tally)
{
}

inline void on_interaction(const Medium *medium, const Segment *segment, const Flight *flight, const Interaction *at,
                           Tally *tally)
{
}

inline void on_scattering(const Medium *medium, const Interaction *at, float3 new_direction, const SampleKey *key,
                          Tally *tally)
{
}

#include "walk/unbudgeted.h"
#include "walk/path.h"

/* Photon `sample_in_launch * pixel_count + pixel` starts in a pixel of the sun's view, as those of fluxes. */
__kernel void fill_table(FILL_TABLE_PARAMETERS)
{
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    TURNS(turn, photon_count);
    SampleKey key;
    Interaction at;
    Tally tally = {column, cells, table_sums, unit};
    for (bool walks = false;;) {
        if (!walks) {
            if (!next_turn(&turn))
                break;
            const uint sample = first_sample + turn.item / pixel_count;
            key = sample_key(seed, stream, (uint2)(TABLE_PHOTONS_VIEW, turn.item % pixel_count), sample);
            at = path_start(camera_ray(scene, sun_view, 0, &key));
        }
        do
            walks = walk_event(&medium, &at, &key, &tally);
        while (walks && !REGENERATES);
    }
}

/* From the sums to what derivatives are made of, scattered light less radiance: a work item for every cell and bin. */
__kernel void tabulate(TABULATE_PARAMETERS)
{
    const size_t place = get_global_id(0);
    const uint cell = (uint)(place / DIRECTION_BINS), bin = (uint)(place % DIRECTION_BINS);
    if (cell >= count)
        return;
    const __global Accumulator *sums = table_sums + (size_t)cell * DIRECTION_BINS;
    float source = 0.0f;
    for (uint from = 0; from < DIRECTION_BINS; ++from)
        source += (float)sums[from] * scattering[from * DIRECTION_BINS + bin];
    if (has_overflowed(sums[bin]))
        atomic_inc(overflown);
    const uint3 parts = cells[cell_column[cell]].yzw;
    scattered[place] = unit * (float)(parts.x * parts.y * parts.z) * source;
}
